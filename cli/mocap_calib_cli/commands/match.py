"""mocap-calib match: who is who in all cameras."""

from pathlib import Path
from typing import Any

import click

from mocap_calib_cli import options


@click.command(name="match")
@options.keypoints
@options.reading
@options.rig
@options.output_text("matches (CSV)")
@options.skeleton
@options.device
@options.quiet
def command(reading: dict[str, Any], keypoints: tuple[str, ...], rig: str, output: str, skeleton: Path | None, device: str, quiet: bool) -> None:
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
        recording, model = inputs.read_recording(keypoints, cameras.cameras, skeleton, reporter, reading, placed=True)
        lifted = inputs.lifted_poses(recording, model, device, reporter)
        found = match(recording, lifted, inputs.placed(recording, cameras), MatchingConfig(), PairwiseConfig(), progress=reporter)
    outputs.write_text(output, format_matches_csv(recording, found))
