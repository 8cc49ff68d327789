"""mocap-calib smooth: best estimates of 3D poses."""

from pathlib import Path

import click

from mocap_calib_cli import options


@click.command(name="smooth")
@options.output_file(
    "Poses: a .h5 file, or a .csv file (several individuals go to NAME_0.csv, NAME_1.csv, ...)."
)
@options.shared_options("rig", "matches", "skeleton", "smooth", *options.KEYPOINTS, "quiet")
def command(shared: options.SharedOptions, output: Path) -> None:
    """Triangulate the 3D poses of all individuals, and fit them to motion and bones.

    How strongly, held-out detections say. Short gaps are bridged, and joints that a single camera
    saw are completed; docs/poses.md has how, and which. `run` does the same.

    \b
    Example, in the folder examples/three_people:
      mocap-calib smooth keypoints/ --rig out/cameras.yaml --matches out/matches.csv -o p.h5
      mocap-calib smooth keypoints/ --rig rig.toml --matches matches.csv --smooth bones -o p.h5
    """
    from typing import cast

    from mocap_calib.config import PosesConfig, SmoothMode
    from mocap_calib.poses.stage import smooth_poses
    from mocap_calib.rig.triangulate import triangulate
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.progress import Reporter

    outputs.check_poses(output)
    with Reporter(quiet=shared.quiet) as reporter:
        rig, loaded, matches, _ = inputs.read_matched_recording(shared, reporter)
        outputs.check_individuals(output, matches.individuals)
        poses = triangulate(loaded.recording, rig, matches, progress=reporter)
        config = PosesConfig(smooth=cast(SmoothMode, shared.smooth))
        poses, _ = smooth_poses(loaded.recording, rig, matches, poses, config, progress=reporter)
    outputs.write_poses(output, poses, loaded.recording, "smooth")
