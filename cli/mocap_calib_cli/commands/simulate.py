"""mocap-calib simulate: a synthetic recording with truth."""

from pathlib import Path
from typing import Any

import click

from mocap_calib.config import SimulateConfig
from mocap_calib_cli import options

_DEFAULT = SimulateConfig()
_SHARE = click.FloatRange(0, 1)


@click.command(
    name="simulate",
    epilog="Example: mocap-calib simulate -o scene --cameras 6 --people 2 --distortion brown",
    context_settings={"show_default": True},
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    required=True,
    metavar="OUT",
    help="Folder to write; made when missing.",
)
@click.option(
    "--cameras",
    type=click.IntRange(min=1),
    default=_DEFAULT.cameras,
    help="Number of cameras around the room.",
)
@click.option(
    "--people",
    type=click.IntRange(min=1),
    default=_DEFAULT.people,
    help="Number of people who walk about and gesture.",
)
@click.option(
    "--frames", type=click.IntRange(min=1), default=_DEFAULT.frames, help="Length of the recording."
)
@click.option(
    "--fps",
    type=click.FloatRange(min=0, min_open=True),
    default=_DEFAULT.fps,
    help="Frames a second.",
)
@click.option(
    "--noise",
    "noise_px",
    type=click.FloatRange(min=0),
    default=_DEFAULT.noise_px,
    metavar="PIXELS",
    help="RMS error of a coordinate.",
)
@click.option(
    "--missing", type=_SHARE, default=_DEFAULT.missing, help="Share of joints that are not found."
)
@click.option(
    "--outliers",
    type=_SHARE,
    default=_DEFAULT.outliers,
    help="Share of joints that are found somewhere else.",
)
@click.option(
    "--false-detections",
    type=_SHARE,
    default=_DEFAULT.false_detections,
    help="Share of images with a body too many.",
)
@click.option(
    "--distortion",
    type=click.Choice(["none", "brown", "fisheye"]),
    default=_DEFAULT.distortion,
    help="Lenses.",
)
@click.option(
    "--layout",
    type=click.Choice(["coco17", "all"]),
    default=_DEFAULT.layout,
    help="Joints of the detector.",
)
@click.option(
    "--radius",
    type=click.FloatRange(min=0, min_open=True),
    default=_DEFAULT.radius,
    metavar="METRES",
    help="From the middle to the cameras.",
)
@click.option(
    "--arc",
    "arc_deg",
    type=click.FloatRange(0, 360),
    default=_DEFAULT.arc_deg,
    metavar="DEGREES",
    help="Over which cameras are spread.",
)
@click.option(
    "--shuffle/--no-shuffle",
    default=_DEFAULT.shuffle,
    help="Order of the detections in each image says nothing.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=_DEFAULT.seed,
    help="The same seed gives the same bytes.",
)
@options.quiet
def command(output: Path, quiet: bool, **fields: Any) -> None:
    """Makes a recording of synthetic people with its truth: keypoints (COCO), cameras, who is who, true 3D."""
    from mocap_calib.io.results.scene import write_scene
    from mocap_calib.synthetic import simulate

    config = SimulateConfig(**fields)
    scene = simulate(config)
    write_scene(output, scene, repeat(config))
    if not quiet:
        found = int((scene.identity >= 0).sum())
        click.echo(
            f"{output}: {config.cameras} cameras, {config.frames} frames, {config.people} people, {found} detections of them",
            err=True,
        )


def repeat(config: SimulateConfig) -> str:
    """The command that makes the same scene; options that are as usual are left out."""
    names = {"noise_px": "--noise", "arc_deg": "--arc"}
    changed = {
        key: value
        for key, value in vars(config).items()
        if value != getattr(_DEFAULT, key) and key not in ("size", "shuffle", "seed")
    }
    said = [
        f"{names.get(key, '--' + key.replace('_', '-'))} {value}" for key, value in changed.items()
    ]
    return " ".join(
        [
            "mocap-calib simulate -o OUT",
            *said,
            *([] if config.shuffle else ["--no-shuffle"]),
            f"--seed {config.seed}",
        ]
    )
