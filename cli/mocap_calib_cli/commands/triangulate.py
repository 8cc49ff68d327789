"""mocap-calib triangulate: 3D poses."""

from pathlib import Path
from typing import Any

import click

from mocap_calib_cli import options


@click.command(name="triangulate")
@options.keypoints
@options.reading
@options.rig
@options.matches
@options.output_file(
    "Poses: a .h5 file, or a .csv file (further individuals go to NAME_1.csv, NAME_2.csv, ...)."
)
@options.skeleton
@options.quiet
def command(
    reading: dict[str, Any],
    keypoints: tuple[str, ...],
    rig: str,
    matches: str,
    output: Path,
    skeleton: Path | None,
    quiet: bool,
) -> None:
    """3D poses of all individuals in all frames.

    \b
    Example:
      mocap-calib triangulate keypoints/ --rig cameras.yaml --matches adjusted.csv -o poses3d.h5
    """
    from mocap_calib.config import TriangulateConfig
    from mocap_calib.errors import MismatchError
    from mocap_calib.io.atomic import folder, individual_file, replace_text
    from mocap_calib.io.results.poses_csv import poses_csv
    from mocap_calib.io.results.poses_h5 import write_poses_h5
    from mocap_calib.multi_view.triangulation import triangulate
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.progress import Reporter

    if output.suffix not in (".h5", ".csv"):
        raise MismatchError(
            f"{output}: expected a name that ends in .h5 or .csv, found {output.suffix or 'no ending'}; rename it"
        )
    outputs.check_file(output)
    with Reporter(quiet=quiet) as reporter:
        cameras = inputs.rig_of(rig)
        recording, _ = inputs.read_recording(
            keypoints, cameras.cameras, skeleton, reporter, reading, placed=True
        )
        labels = inputs.matches_of(matches, recording)
        poses = triangulate(
            recording,
            inputs.placed(recording, cameras),
            labels,
            TriangulateConfig(),
            progress=reporter,
        )
    if output.suffix == ".h5":
        write_poses_h5(output, poses, outputs.provenance("triangulate"))
    else:
        with folder(output.absolute().parent) as work:
            for k in range(labels.individuals):
                replace_text(work / individual_file(output, k).name, poses_csv(poses, k))
