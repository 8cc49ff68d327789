"""mocap-calib match: who is who in all cameras."""

from mocap_calib_cli import options


@options.command(
    "match",
    options.output_text("matches (CSV)"),
    "rig",
    *options.MODEL,
    "individuals",
    *options.KEYPOINTS,
    "quiet",
)
def command(typed: options.Typed) -> None:
    """Label every detection with its individual, given where the cameras stand.

    MATCHES has a row for each detection: camera, frame, its number in the frame, and the number of
    the individual (-1 is nobody). It is for `adjust` and `triangulate`.

    \b
    Example, in the folder examples/three_people:
      mocap-calib match keypoints/ --rig out/cameras.yaml -o matches.csv
    """
    from mocap_calib.config import Config, MatchingConfig
    from mocap_calib.io.results.matches_csv import matches_csv
    from mocap_calib.stages import match
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.screen import Reporter

    outputs.check_text(typed.output)
    with Reporter(quiet=typed.quiet) as reporter:
        rig, loaded = inputs.read_recording_of_rig(typed, reporter)
        config = Config(matching=MatchingConfig(individuals=typed.individuals))
        matches = match(
            loaded.recording, rig, config=config, device=typed.device, progress=reporter
        )
    outputs.write_text(typed.output, matches_csv(loaded.recording, matches, loaded.clocks))
