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
@options.model
@options.device
@options.quiet
def command(
    reading: dict[str, Any],
    keypoints: tuple[str, ...],
    rig: str,
    output: str,
    skeleton: Path | None,
    model: str | None,
    device: str,
    quiet: bool,
) -> None:
    """Labels every detection with its individual, given the cameras.

    \b
    Example:
      mocap-calib match keypoints/ --rig rig.yaml -o matches.csv
    """
    from mocap_calib.config import Config
    from mocap_calib.io.results.matches_csv import matches_csv
    from mocap_calib.multi_view.association import associate, body_scale, label_all_frames
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.progress import Reporter

    outputs.check_text(output)
    with Reporter(quiet=quiet) as reporter:
        cameras = inputs.rig_of(rig)
        recording, network = inputs.read_recording(
            keypoints, cameras.cameras, skeleton, reporter, reading, model=model, placed=True
        )
        chosen, some, lifted = inputs.lifted_sample(recording, network, device, reporter)
        start = inputs.placed(recording, cameras)
        within = associate(some, lifted, start, Config(), progress=reporter)
        found = label_all_frames(
            recording,
            chosen,
            within,
            start,
            Config(),
            scale=body_scale(some, lifted, start, Config().pairwise),
            progress=reporter,
        )
    outputs.write_text(output, matches_csv(recording, found))
