"""mocap-calib adjust: bundle adjustment."""

from typing import TYPE_CHECKING

import click

from mocap_calib_cli import options, values

if TYPE_CHECKING:
    from mocap_calib.results import CalibrationResult
    from mocap_calib_cli.progress import Reporter


@click.command(name="adjust")
@options.output_text("adjusted cameras (YAML)")
@click.option(
    "--matches-out",
    type=values.ANY_PATH,
    metavar="FILE",
    help="Where to write the matches that the adjusted cameras imply.",
)
@options.shared_options(
    "rig", "matches", *options.MODEL, *options.KEYPOINTS, *options.VERDICT, "quiet"
)
@click.pass_context
def command(
    context: click.Context,
    shared: options.SharedOptions,
    output: str,
    matches_out: str | None,
) -> None:
    """Adjust the cameras and match again, in turn, until no match changes (bundle adjustment).

    Errors and verdict are those of the frames that calibration looks at. The exit status is 1
    where the rig is not determined, as that of `run`.

    \b
    Example:
      mocap-calib adjust keypoints/ --rig rig.yaml --matches matches.csv -o cameras.yaml
      mocap-calib adjust keypoints/ --rig rig.yaml --matches matches.csv --matches-out new.csv
    """
    from mocap_calib.adjust.refine import adjust_until_stable
    from mocap_calib.config import Config
    from mocap_calib.identities import finalise_identities
    from mocap_calib.io.results.matches_csv import matches_csv
    from mocap_calib.rig.associate import label_all_frames
    from mocap_calib.verdict.verdict import conclude_without_pairs
    from mocap_calib_cli import inputs, outputs, verdicts
    from mocap_calib_cli.progress import Reporter

    verdicts.check_demands(shared)
    outputs.check_text(output)
    outputs.check_text(matches_out)
    config = Config()
    with Reporter(quiet=shared.quiet) as reporter:
        rig, loaded, matches, frames = inputs.read_matched_recording(shared, reporter)
        recording = loaded.recording
        sample_frames, sample, lifted = inputs.lift_sample(loaded, shared.device, reporter)
        instances = sample.positions.shape[2]  # a frame that is not in the sample may have more
        sampled = matches.select(frames=sample_frames, instances=instances)
        adjusted = adjust_until_stable(
            sample,
            rig,
            sampled,
            config,
            lifted=lifted,
            progress=reporter,
        )
        if matches_out is not None:
            matches = label_all_frames(
                recording,
                adjusted.rig,
                config,
                sample_frames=sample_frames,
                matches=adjusted.matches,
                progress=reporter,
            )
            matches = finalise_identities(recording, adjusted.rig, matches, config)
            outputs.write_text(matches_out, matches_csv(recording, matches, loaded.clocks))
        result = conclude_without_pairs(sample, lifted, rig, adjusted, config)
    _write_judged(result, output, shared, reporter, frames=frames)
    context.exit(verdicts.exit_status(result.groups[0].verdict, shared))


def _write_judged(
    result: "CalibrationResult",
    output: str,
    shared: options.SharedOptions,
    reporter: "Reporter",
    *,
    frames: list[int] | None,
) -> None:
    """Write the cameras with the verdict on them, and say the errors and the verdict.

    frames: first and last for which they hold, None = all: a camera was moved.
    """
    from mocap_calib.io.cameras.write import format_rig
    from mocap_calib.io.provenance import hold_for, provenance
    from mocap_calib.report import run_report, verdict_of_cameras
    from mocap_calib_cli import ending, outputs, verdicts

    (group,) = result.groups
    report = run_report(group, result)
    judged = verdict_of_cameras(report)
    if frames is not None:
        judged = hold_for(judged, frames)
    source = provenance("adjust", **judged)
    (content,) = format_rig(group.rig, "mocap-calib", source).files.values()
    outputs.write_text(output, [content])
    reporter.say("")
    reporter.show(ending.camera_table(report))
    reporter.say(*ending.describe_rig(report))
    place = "adjusted cameras" if output == options.STDIO else output
    verdicts.conclude(reporter, group.verdict, place, shared, reasons=report["verdict"]["reasons"])
