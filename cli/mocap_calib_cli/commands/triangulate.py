"""mocap-calib triangulate: 3D poses."""

from pathlib import Path

import click

from mocap_calib_cli import options


@click.command(name="triangulate")
@options.output_file(
    "Poses: a .h5 file, or a .csv file (several individuals go to NAME_0.csv, NAME_1.csv, ...)."
)
@options.shared_options("rig", "matches", "skeleton", *options.KEYPOINTS, "quiet")
def command(shared: options.SharedOptions, output: Path) -> None:
    """Triangulate the 3D poses of all individuals in all frames.

    \b
    Example, in the folder examples/three_people:
      mocap-calib triangulate keypoints/ --rig out/cameras.yaml --matches out/matches.csv -o p.h5
    """
    from mocap_calib.rig.triangulate import triangulate
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.progress import Reporter

    outputs.check_poses(output)
    with Reporter(quiet=shared.quiet) as reporter:
        rig, loaded, matches, _ = inputs.read_matched_recording(shared, reporter)
        outputs.check_individuals(output, matches.individuals)
        poses = triangulate(loaded.recording, rig, matches, progress=reporter)
    outputs.write_poses(output, poses, loaded.recording, "triangulate")
