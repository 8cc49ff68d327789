"""mocap-calib average: pairs to one rig."""

import click

from mocap_calib_cli import options, values


@click.command(name="average")
@click.argument("pairs", type=values.PAIRS, metavar="PAIRS")
@options.output_text("cameras (YAML)")
@options.shared_options("quiet")
def command(shared: options.SharedOptions, pairs: str, output: str) -> None:
    """Find where all cameras stand (the rig) from PAIRS, the file of `pairwise`; - reads stdin.

    Cameras that are in no pair are left out and named.

    \b
    Example, in the folder examples/three_people:
      mocap-calib average pairs.json -o rig.yaml
      mocap-calib pairwise keypoints/ --cameras intrinsics.toml | mocap-calib average -
    """
    from mocap_calib.config import AveragingConfig
    from mocap_calib.io.cameras.own import format_cameras_yaml
    from mocap_calib.io.provenance import provenance
    from mocap_calib.io.results.pairs_json import pairs_from_json
    from mocap_calib.rig import pairs_among
    from mocap_calib.rig.averaging import average
    from mocap_calib.rig.view_graph import usable_cameras
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.describe import describe_unused_cameras
    from mocap_calib_cli.progress import Reporter

    outputs.check_text(output)
    config = AveragingConfig()
    text = inputs.read_text(pairs, "PAIRS")
    found, cameras = pairs_from_json(text, "stdin" if pairs == options.STDIO else pairs)
    views = usable_cameras(cameras, found, config)
    left_out = [camera.name for view, camera in enumerate(cameras) if view not in views]
    Reporter(quiet=shared.quiet).say(*describe_unused_cameras(left_out))
    kept = tuple(cameras[view] for view in views)
    rig = average(kept, pairs_among(found, views), config).rig
    outputs.write_text(output, [format_cameras_yaml(rig, provenance("average")).encode()])
