"""mocap-calib smooth: best estimates of 3D poses."""

from mocap_calib_cli import options


@options.command(
    "smooth",
    options.output_poses(),
    "rig",
    "matches",
    "skeleton",
    "smooth",
    *options.KEYPOINTS,
    "quiet",
)
def command(typed: options.Typed) -> None:
    """Triangulate the 3D poses of all individuals, and fit them to motion and bones.

    How strongly, held-out detections say. Short gaps are bridged, and joints that a single camera
    saw are completed; docs/poses.md has how, and which. `run` does the same.

    \b
    Example, in the folder examples/three_people:
      mocap-calib smooth keypoints/ --rig out/cameras.yaml --matches out/matches.csv -o p.h5
      mocap-calib smooth keypoints/ --rig rig.toml --matches matches.csv --smooth bones -o p.h5
    """
    from mocap_calib.config import Config, PosesConfig
    from mocap_calib.stages import smooth
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.screen import Reporter

    outputs.check_poses(typed.output)
    config = Config(poses=PosesConfig(smooth=typed.smooth))
    with Reporter(quiet=typed.quiet) as reporter:
        rig, loaded, matches, _ = inputs.read_matched_recording(typed, reporter)
        outputs.check_individuals(typed.output, matches.individuals)
        poses = smooth(loaded.recording, rig, matches, config, progress=reporter)
    outputs.write_poses(typed.output, poses, loaded.recording, "smooth")
