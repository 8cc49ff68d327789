"""mocap-calib adjust: bundle adjustment."""

import click

from mocap_calib_cli import options, values


@options.command(
    "adjust",
    options.output_text("adjusted cameras (YAML)"),
    click.Option(
        ["--matches-out"],
        type=values.ANY_PATH,
        metavar="FILE",
        help="Where to write the matches that the adjusted cameras imply.",
    ),
    "rig",
    "matches",
    *options.MODEL,
    *options.KEYPOINTS,
    *options.VERDICT,
    "quiet",
)
def command(typed: options.Typed) -> int:
    """Adjust the cameras and match again, in turn, until no match changes (bundle adjustment).

    Errors and verdict are those of the frames that calibration looks at. The exit status is 1
    where the rig is not determined, as that of `run`.

    \b
    Example:
      mocap-calib adjust keypoints/ --rig rig.yaml --matches matches.csv -o cameras.yaml
      mocap-calib adjust keypoints/ --rig rig.yaml --matches matches.csv --matches-out new.csv
    """
    from mocap_calib.io.cameras.write import format_rig
    from mocap_calib.io.provenance import hold_for, provenance
    from mocap_calib.io.results.matches_csv import matches_csv
    from mocap_calib.report import run_report, verdict_of_cameras
    from mocap_calib.stages import bundle_adjust
    from mocap_calib_cli import ending, inputs, outputs
    from mocap_calib_cli.screen import Reporter

    ending.check_demands(typed)
    outputs.check_text(typed.output)
    outputs.check_text(typed.matches_out)
    with Reporter(quiet=typed.quiet) as reporter:
        rig, loaded, matches, frames = inputs.read_matched_recording(typed, reporter)
        result, matches = bundle_adjust(
            loaded.recording, rig, matches, device=typed.device, progress=reporter
        )
    if typed.matches_out is not None:
        table = matches_csv(loaded.recording, matches, loaded.clocks)
        outputs.write_text(typed.matches_out, table)
    (group,) = result.groups
    report = run_report(group, result)
    judged = verdict_of_cameras(report)
    if frames is not None:  # a camera was moved
        judged = hold_for(judged, frames)
    (content,) = format_rig(group.rig, "mocap-calib", provenance("adjust", **judged)).files.values()
    outputs.write_text(typed.output, [content])
    reporter.say("")
    reporter.show(ending.camera_table(report))
    reporter.say(*ending.describe_rig(report))
    place = "adjusted cameras" if typed.output == options.STDIO else typed.output
    ending.conclude(reporter, group.verdict, place, typed, reasons=report["verdict"]["reasons"])
    return ending.exit_status(group.verdict, typed)
