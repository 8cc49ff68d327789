"""mocap-calib convert: keypoints, cameras and poses from one format to another."""

import click

from mocap_calib_cli import options


@click.command(name="convert")
@click.argument("inputs", nargs=-1, required=True, metavar="INPUT...")
@click.argument("output", metavar="OUTPUT")
@click.option(
    "--from",
    "source",
    metavar="FORMAT",
    help="Format of INPUT, where its content does not show it; needed for stdin.",
)
@click.option(
    "--to",
    "target",
    metavar="FORMAT",
    help="Format of OUTPUT, where the ending of its name does not say it.",
)
@click.option(
    "--unit",
    type=click.Choice(["m", "cm", "mm"]),
    help="What a length of 1 is in INPUT, where the file does not say.",
)
@click.option(
    "--fps",
    type=click.FloatRange(min=0, min_open=True),
    help="Frames per second of poses, where the file does not say.",
)
@click.option(
    "--up",
    type=click.Choice(["x", "y", "z", "-x", "-y", "-z"]),
    help="The axis of INPUT's world that points up: poses are turned so that it is y.",
)
@options.shared_options(*options.READING[1:], "quiet")
def command(
    shared: options.SharedOptions,
    inputs: tuple[str, ...],
    output: str,
    source: str | None,
    target: str | None,
    unit: str | None,
    fps: float | None,
    up: str | None,
) -> None:
    """Converts INPUT to OUTPUT: between two formats of keypoints, of cameras, or of 3D poses.

    INPUT is a file or a folder (keypoints: any number, also name=path); - is stdin or stdout. What the format of OUTPUT
    cannot hold is said, or refused. docs/formats.md lists the formats.

    \b
    Example:
      mocap-calib convert calibration.toml model --to colmap
      mocap-calib convert poses3d.h5 poses.trc --unit m --fps 60 --up z
      mocap-calib convert openpose/ keypoints --to coco --layout body_25
      mocap-calib convert - - --from anipose --to nerfstudio <calibration.toml >transforms.json
    """
    from mocap_calib_cli import conversion
    from mocap_calib_cli.progress import Reporter

    reading = {name: getattr(shared, name) for name in options.READING[1:]}
    wish = conversion.Wish(inputs, output, source, target, unit, fps, up, reading)
    Reporter(quiet=shared.quiet).say(*conversion.convert(wish))
