"""mocap-calib report: the page of results, made again."""

from pathlib import Path
from typing import TYPE_CHECKING

from mocap_calib_cli import options, values
from mocap_calib_cli.options import argument, option
from mocap_calib_cli.typed import Typed, as_command

if TYPE_CHECKING:
    from mocap_calib.html_report.source import Reference
    from mocap_calib.job.reports import ResultsFolder


@as_command(
    "report",
    argument("results", values.INPUT, "OUT"),
    option("-o --output", values.FILE, metavar="FILE"),
    option("--reference", values.INPUT, metavar="CAMERAS"),
    argument("keypoints", values.KEYPOINTS, "[KEYPOINTS]...", several=True, required=False),
    *options.READING,
    "skeleton",
    "quiet",
)
def command(typed: Typed) -> None:
    """Show the results of `run` in the folder OUT: one HTML file, which needs no network.

    `run` writes the same. KEYPOINTS: those of the run, where they are no longer where it read
    them; it kept how they are to be read. Without keypoints the page does not show what the
    cameras saw. Ellipsoids are spheres here: the folder says how far a camera may be off, and not
    which way.

    \b
    Example:
      mocap-calib report out
      mocap-calib report out --reference board.toml -o compared.html
      mocap-calib report out keypoints/

    output: The page. [default: report.html in OUT, and in the folder of each further group]
    reference: File or folder with another rig of these cameras, to be laid over this one.
    """
    from mocap_calib.html_report.source import Reference
    from mocap_calib.io.results.group import PAGE
    from mocap_calib.job.reports import open_results
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.screen import Reporter

    first = open_results(Path(typed.results))
    whole = typed.output is None and first.number == 0
    folders = [first, *(map(open_results, first.group_paths[1:]) if whole else ())]
    for folder in folders:
        outputs.check_file(typed.output or folder.path / PAGE)
    path = typed.reference
    reference = Reference(path, inputs.read_rig(path, "--reference")[0]) if path else None
    reporter = Reporter(quiet=typed.quiet)
    for folder in folders:
        reporter.say(*draw_results(folder, typed, typed.output, reference))


def draw_results(
    folder: "ResultsFolder",
    typed: Typed,
    output: Path | None = None,
    reference: "Reference | None" = None,
) -> tuple[str, ...]:
    """Write the page of results; return what it says of itself, and where it is, a line each.

    typed: how keypoints are read, where that is not as run.json says.
    output: None: report.html in the folder, and its hash in run.json.

    Raises FormatError and MismatchError.
    """
    from mocap_calib.html_report.page import report_page
    from mocap_calib.io.atomic import write_bytes
    from mocap_calib.io.results.group import PAGE
    from mocap_calib.job.reports import note_page, read_source
    from mocap_calib_cli import inputs

    read = inputs.options_of_reading(folder.run.get("reading", {}), typed)
    keypoints = inputs.keypoint_source(read) if read.keypoints else None
    insist = bool(typed.keypoints)
    source = read_source(folder, keypoints, insist=insist, reference=reference)
    path = output or folder.path / PAGE
    write_bytes(path, report_page(source).encode())
    if output is None:
        note_page(folder)
    return (*source.notes, f"report in {path}")
