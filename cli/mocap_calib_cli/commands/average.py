"""mocap-calib average: pairs to one rig."""

import click

from mocap_calib_cli import options, values


@options.command(
    "average",
    click.Argument(["pairs"], type=values.PAIRS, metavar="PAIRS"),
    options.output_text("cameras (YAML)"),
    "quiet",
)
def command(typed: options.Typed) -> None:
    """Find where all cameras stand (the rig) from PAIRS, the file of `pairwise`; - reads stdin.

    Cameras that are in no pair are left out and named.

    \b
    Example, in the folder examples/three_people:
      mocap-calib average pairs.json -o rig.yaml
      mocap-calib pairwise keypoints/ --cameras intrinsics.toml | mocap-calib average -
    """
    from mocap_calib.io.cameras.own import format_cameras_yaml
    from mocap_calib.io.provenance import provenance
    from mocap_calib.io.results.pairs_json import pairs_from_json
    from mocap_calib.stages import average
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.describe import describe_unused_cameras
    from mocap_calib_cli.screen import Reporter

    outputs.check_text(typed.output)
    text = inputs.read_text(typed.pairs, "PAIRS")
    source = "stdin" if typed.pairs == options.STDIO else typed.pairs
    pairs, cameras = pairs_from_json(text, source)
    rig = average(pairs, cameras)
    left_out = [camera.name for camera in cameras if camera.name not in rig.names]
    Reporter(quiet=typed.quiet).say(*describe_unused_cameras(left_out))
    outputs.write_text(typed.output, [format_cameras_yaml(rig, provenance("average")).encode()])
