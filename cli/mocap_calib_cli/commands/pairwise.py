"""mocap-calib pairwise: relative poses of all pairs of cameras."""

from pathlib import Path
from typing import Any

import click

from mocap_calib_cli import options


@click.command(name="pairwise")
@options.keypoints
@options.reading
@options.cameras
@options.output_text("pairs (JSON)")
@options.skeleton
@options.model
@options.solver
@options.seed
@options.device
@options.quiet
def command(
    reading: dict[str, Any],
    keypoints: tuple[str, ...],
    cameras: str,
    output: str,
    skeleton: Path | None,
    model: str | None,
    solver: str,
    seed: int,
    device: str,
    quiet: bool,
) -> None:
    """Finds the relative pose of every pair of cameras, and who matches whom.

    \b
    Example:
      mocap-calib pairwise keypoints/ --cameras intrinsics.toml -o pairs.json
      mocap-calib pairwise keypoints/ --cameras intrinsics.toml --solver paper -o paper.json
    """
    import numpy as np

    from mocap_calib.config import PairwiseConfig
    from mocap_calib.io.results.pairs_json import pairs_to_json
    from mocap_calib.two_view.solve import calibrate_pairs, in_recording
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.progress import Reporter

    outputs.check_text(output)
    with Reporter(quiet=quiet) as reporter:
        recording, network = inputs.read_recording(
            keypoints, inputs.cameras_of(cameras), skeleton, reporter, reading, model=model
        )
        chosen, some, lifted = inputs.lifted_sample(recording, network, device, reporter)
        solve = inputs.pair_solver(solver, recording, network)
        pairs = calibrate_pairs(
            some,
            lifted,
            PairwiseConfig(),
            rng=np.random.default_rng(seed),
            progress=reporter,
            solve=solve,
        )
    outputs.write_text(output, [pairs_to_json(in_recording(pairs, chosen), recording.cameras)])
