"""mocap-calib match: who is who in all cameras."""

from pathlib import Path

import click

from mocap_calib_cli import options


@click.command(name="match")
@options.keypoints
@options.rig
@options.output_text("matches (CSV)")
@options.skeleton
@options.model
@options.device
@options.quiet
def command(keypoints: tuple[str, ...], rig: str, output: str, skeleton: Path | None, model: str | None, device: str, quiet: bool) -> None:
    """Labels every detection with its individual, given the cameras.

    \b
    Example:
      mocap-calib match keypoints/ --rig rig.yaml -o matches.csv
    """
    from mocap_calib.config import MatchingConfig, PairwiseConfig
    from mocap_calib.io.results import format_matches_csv
    from mocap_calib.matching import match
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.progress import Reporter

    outputs.check_text(output)
    with Reporter(quiet=quiet) as reporter:
        cameras = inputs.rig_of(rig)
        recording, chosen = inputs.read_recording(keypoints, cameras.cameras, skeleton, reporter, model=model, placed=True)
        lifted = inputs.lifted_poses(recording, chosen, device, reporter)
        found = match(recording, lifted, inputs.placed(recording, cameras), MatchingConfig(), PairwiseConfig(), progress=reporter)
    outputs.write_text(output, format_matches_csv(recording, found))
