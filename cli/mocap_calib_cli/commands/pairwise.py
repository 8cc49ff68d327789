"""mocap-calib pairwise: relative poses of pairs of cameras."""

import click

from mocap_calib_cli import options


@click.command(name="pairwise")
@options.output_text("pairs (JSON)")
@options.shared_options(
    "cameras", *options.MODEL, "pairs", "solver", "seed", *options.KEYPOINTS, "quiet"
)
def command(shared: options.SharedOptions, output: str) -> None:
    """Find the relative poses of pairs of cameras, and who matches whom.

    This is the first stage of `run`. The file it writes is for `average`.

    \b
    Example, in the folder examples/three_people:
      mocap-calib pairwise keypoints/ --cameras intrinsics.toml -o pairs.json
      mocap-calib pairwise keypoints/ --cameras intrinsics.toml --solver five-point -o b.json
    """
    import numpy as np

    from mocap_calib.config import Config
    from mocap_calib.io.results.pairs_json import pairs_to_json
    from mocap_calib.lift.lifter import load_model
    from mocap_calib.pairs.solve import in_recording
    from mocap_calib.paper import choose_pair_solver
    from mocap_calib.rig.view_graph import calibrate_view_graph
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.progress import Reporter

    outputs.check_text(output)
    config = Config(view_graph=inputs.view_graph_config(shared))
    with Reporter(quiet=shared.quiet) as reporter:
        camera_file = inputs.load_camera_file(shared.cameras, "--cameras")
        loaded = inputs.read_recording(shared, camera_file, reporter)
        sample_frames, sample, lifted = inputs.lift_sample(
            loaded, shared.device, reporter, pair_solver=shared.solver
        )
        lifter = load_model(loaded.recording.model, pair_solver=shared.solver)
        solver = choose_pair_solver(shared.solver, loaded.recording, lifter, config.pairwise)
        pairs = calibrate_view_graph(
            sample,
            lifted,
            config,
            rng=np.random.default_rng(shared.seed),
            progress=reporter,
            solve=solver,
        )
    pairs = in_recording(pairs, sample_frames)
    outputs.write_text(output, [pairs_to_json(pairs, loaded.recording.cameras).encode()])
