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
@click.option(
    "--matches-out",
    metavar="FILE",
    help="Where to write the matches that the adjusted cameras imply.",
)
@options.skeleton
@options.model
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
    model: str | None,
    device: str,
    quiet: bool,
) -> None:
    """Bundle adjustment, matched and adjusted again until no match changes.

    \b
    Example:
      mocap-calib adjust keypoints/ --rig rig.yaml --matches matches.csv -o cameras.yaml --matches-out adjusted.csv
    """
    from mocap_calib.config import Config
    from mocap_calib.io.cameras.own import format_cameras_yaml
    from mocap_calib.io.results.matches_csv import matches_csv
    from mocap_calib.multi_view.association import body_scale, label_all_frames
    from mocap_calib.multi_view.refinement import adjust_until_stable
    from mocap_calib.multi_view.tracking import finalise_identities
    from mocap_calib.types import Matches
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.progress import Reporter

    outputs.check_text(output)
    outputs.check_text(matches_out)
    with Reporter(quiet=quiet) as reporter:
        cameras = inputs.rig_of(rig)
        recording, network = inputs.read_recording(
            keypoints, cameras.cameras, skeleton, reporter, reading, model=model, placed=True
        )
        start, labels = inputs.placed(recording, cameras), inputs.matches_of(matches, recording)
        chosen, some, lifted = inputs.lifted_sample(recording, network, device, reporter)
        found = adjust_until_stable(
            some, lifted, start, Matches(labels.labels[:, chosen]), Config(), progress=reporter
        )
        if matches_out is not None:
            everyone = label_all_frames(
                recording,
                chosen,
                found.matches,
                found.rig,
                Config(),
                scale=body_scale(some, lifted, found.rig, Config().pairwise),
                progress=reporter,
            )
            outputs.write_text(
                matches_out,
                matches_csv(
                    recording,
                    finalise_identities(recording, found.rig, everyone, Config().matching),
                ),
            )
    outputs.write_text(output, [format_cameras_yaml(found.rig, outputs.provenance("adjust"))])
