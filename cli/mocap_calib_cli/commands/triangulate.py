"""mocap-calib triangulate: 3D poses."""

from mocap_calib_cli import options


@options.command(
    "triangulate", options.output_poses(), "rig", "matches", "skeleton", *options.KEYPOINTS, "quiet"
)
def command(typed: options.Typed) -> None:
    """Triangulate the 3D poses of all individuals in all frames.

    \b
    Example, in the folder examples/three_people:
      mocap-calib triangulate keypoints/ --rig out/cameras.yaml --matches out/matches.csv -o p.h5
    """
    from mocap_calib.rig.triangulate import triangulate
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.screen import Reporter

    outputs.check_poses(typed.output)
    with Reporter(quiet=typed.quiet) as reporter:
        rig, loaded, matches, _ = inputs.read_matched_recording(typed, reporter)
        outputs.check_individuals(typed.output, matches.individuals)
        poses = triangulate(loaded.recording, rig, matches, progress=reporter)
    outputs.write_poses(typed.output, poses, loaded.recording, "triangulate")
