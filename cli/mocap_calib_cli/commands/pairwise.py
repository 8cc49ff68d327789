"""mocap-calib pairwise: relative poses of pairs of cameras."""

from mocap_calib_cli import options


@options.command(
    "pairwise",
    options.output_text("pairs (JSON)"),
    "cameras",
    *options.MODEL,
    "pairs",
    "solver",
    "seed",
    *options.KEYPOINTS,
    "quiet",
)
def command(typed: options.Typed) -> None:
    """Find the relative poses of pairs of cameras, and who matches whom.

    This is the first stage of `run`. The file it writes is for `average`.

    \b
    Example, in the folder examples/three_people:
      mocap-calib pairwise keypoints/ --cameras intrinsics.toml -o pairs.json
      mocap-calib pairwise keypoints/ --cameras intrinsics.toml --solver five-point -o b.json
    """
    from mocap_calib.config import Config, ViewGraphConfig
    from mocap_calib.io.results.pairs_json import pairs_to_json
    from mocap_calib.stages import pairwise
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.screen import Reporter

    outputs.check_text(typed.output)
    with Reporter(quiet=typed.quiet) as reporter:
        camera_file = inputs.load_camera_file(typed.cameras, "--cameras")
        recording = inputs.read_recording(typed, camera_file, reporter).recording
        pairs = pairwise(
            recording,
            config=Config(view_graph=ViewGraphConfig(pairs=typed.pairs)),
            solver=typed.solver,
            seed=typed.seed,
            device=typed.device,
            progress=reporter,
        )
    outputs.write_text(typed.output, [pairs_to_json(pairs, recording.cameras).encode()])
