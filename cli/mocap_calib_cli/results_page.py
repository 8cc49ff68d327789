"""Draw the page of a folder of results: `report` does, and what changes results.

Imports numpy and the readers: commands import this module when they run, so that --help is quick.
"""

from pathlib import Path

from mocap_calib.html_report.source import Reference
from mocap_calib.io.results.group import PAGE
from mocap_calib.job.reports import ResultsFolder, note_page, read_source, write_page
from mocap_calib_cli.inputs import keypoint_source
from mocap_calib_cli.options import SharedOptions
from mocap_calib_cli.reading import options_of_reading


def draw_results(
    folder: ResultsFolder,
    shared: SharedOptions,
    output: Path | None = None,
    reference: Reference | None = None,
) -> tuple[str, ...]:
    """Write the page of results; return what it says of itself, and where it is, a line each.

    shared: how keypoints are read, where that is not as run.json says.
    output: None: report.html in the folder, and its hash in run.json.

    Raises FormatError and MismatchError.
    """
    read = options_of_reading(folder.run.get("reading", {}), shared)
    source = read_source(
        folder,
        keypoint_source(read) if read.keypoints else None,
        insist=bool(shared.keypoints),
        reference=reference,
    )
    path = output or folder.path / PAGE
    write_page(source, path)
    if output is None:
        note_page(folder)
    return (*source.notes, f"report in {path}")
