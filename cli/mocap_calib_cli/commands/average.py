"""mocap-calib average: pairs to one rig."""

import click

from mocap_calib_cli import options


@click.command(name="average")
@click.argument("pairs", metavar="PAIRS")
@options.output_text("cameras (YAML)")
@options.quiet
def command(pairs: str, output: str, quiet: bool) -> None:
    """One rig from the pairs of `pairwise`; - reads stdin.

    Of rival answers for a pair the one is taken that the cameras between speak for. Cameras that no pair holds are left out and named.

    \b
    Example:
      mocap-calib average pairs.json -o rig.yaml
      mocap-calib pairwise keypoints/ --cameras intrinsics.toml | mocap-calib average -
    """
    from pathlib import Path

    from mocap_calib.config import AveragingConfig
    from mocap_calib.io.cameras.own import format_cameras_yaml
    from mocap_calib.io.file import decode, read_bytes
    from mocap_calib.io.results.pairs_json import pairs_from_json
    from mocap_calib.multi_view.averaging import average
    from mocap_calib.multi_view.view_graph import pairs_among, select_hypotheses, usable_cameras
    from mocap_calib_cli import inputs, outputs

    outputs.check_text(output)
    text = (
        inputs.read_stdin("PAIRS")
        if pairs == options.STDIO
        else decode(read_bytes(Path(pairs)), pairs)
    )
    found, cameras = pairs_from_json(text, "stdin" if pairs == options.STDIO else pairs)
    found = select_hypotheses(found, AveragingConfig())
    kept = usable_cameras(cameras, found, AveragingConfig())
    left_out = [camera.name for k, camera in enumerate(cameras) if k not in kept]
    if left_out and not quiet:
        click.echo(
            f"left out, no other camera confirms what they see: {', '.join(left_out)}", err=True
        )
    averaged = average(tuple(cameras[k] for k in kept), pairs_among(found, kept), AveragingConfig())
    outputs.write_text(output, [format_cameras_yaml(averaged.rig, outputs.provenance("average"))])
