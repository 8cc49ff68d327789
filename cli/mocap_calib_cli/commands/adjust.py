"""mocap-calib adjust: bundle adjustment."""

from pathlib import Path
from typing import Any

import click

from mocap_calib_cli import options


@click.command(name="adjust")
@options.keypoints
@options.reading
@options.rig
@options.matches
@options.output_text("adjusted cameras (YAML)")
@click.option("--matches-out", metavar="FILE", help="Where to write the matches that the adjusted cameras imply.")
@options.skeleton
@options.device
@options.quiet
def command(
    reading: dict[str, Any],
    keypoints: tuple[str, ...],
    rig: str,
    matches: str,
    output: str,
    matches_out: str | None,
    skeleton: Path | None,
    device: str,
    quiet: bool,
) -> None:
    """Bundle adjustment, matched and adjusted again until no match changes.

    \b
    Example:
      mocap-calib adjust keypoints/ --rig rig.yaml --matches matches.csv -o cameras.yaml --matches-out adjusted.csv
    """
    from mocap_calib.config import Config
    from mocap_calib.io.camera_files import format_cameras_yaml
    from mocap_calib.io.results import format_matches_csv
    from mocap_calib.pipeline import adjust_to_fixed_point
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.progress import Reporter

    outputs.check_text(output)
    outputs.check_text(matches_out)
    with Reporter(quiet=quiet) as reporter:
        cameras = inputs.rig_of(rig)
        recording, model = inputs.read_recording(keypoints, cameras.cameras, skeleton, reporter, reading, placed=True)
        lifted = inputs.lifted_poses(recording, model, device, reporter)
        start, labels = inputs.placed(recording, cameras), inputs.matches_of(matches, recording)
        found = adjust_to_fixed_point(recording, lifted, start, labels, Config(), progress=reporter)
    if matches_out is not None:
        outputs.write_text(matches_out, format_matches_csv(recording, found.matches))
    outputs.write_text(output, format_cameras_yaml(found.rig, outputs.provenance("adjust")))
