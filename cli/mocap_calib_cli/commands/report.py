"""mocap-calib report: the page of results, made again."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from mocap_calib_cli import options, values

if TYPE_CHECKING:
    from mocap_calib.html_report.source import Reference


@click.command(name="report")
@click.argument("results", type=values.ANY_PATH, metavar="OUT")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="The page. [default: report.html in OUT, and in the folder of each further group]",
)
@click.option(
    "--reference",
    type=values.RIG,
    metavar="CAMERAS",
    help="File or folder with another rig of these cameras, to be laid over this one.",
)
@options.shared_options(
    "keypoints",
    *options.READING,
    "skeleton",
    "quiet",
    keypoints=click.argument(
        "keypoints", nargs=-1, type=values.KEYPOINTS, metavar="[KEYPOINTS]..."
    ),
)
def command(
    shared: options.SharedOptions, results: str, output: Path | None, reference: str | None
) -> None:
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
    """
    from mocap_calib.io.results.group import PAGE
    from mocap_calib.job.reports import open_results
    from mocap_calib_cli import outputs
    from mocap_calib_cli.progress import Reporter
    from mocap_calib_cli.results_page import draw_results

    first = open_results(Path(results))
    whole = output is None and first.number == 0
    folders = [first, *(map(open_results, first.group_paths[1:]) if whole else ())]
    for folder in folders:
        outputs.check_file(output or folder.path / PAGE)
    other = _read_reference(reference)
    reporter = Reporter(quiet=shared.quiet)
    for folder in folders:
        reporter.say(*draw_results(folder, shared, output, other))


def _read_reference(path: str | None) -> "Reference | None":
    """Return the rig that is laid over that of the results. Raises FormatError."""
    from mocap_calib.html_report.source import Reference
    from mocap_calib_cli import inputs

    if path is None:
        return None
    rig, _ = inputs.read_rig(path, "--reference")
    return Reference(path, rig)
