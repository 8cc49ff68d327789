"""mocap-calib simulate: a synthetic recording with truth."""

from pathlib import Path
from typing import Any

import click

from mocap_calib.config import SimulateConfig
from mocap_calib_cli import options

_DEFAULT = SimulateConfig()
_COUNT = click.IntRange(min=1)
_SHARE = click.FloatRange(0, 1)
_POSITIVE = click.FloatRange(min=0, min_open=True)
_FLAGS = {"noise_px": "--noise", "arc_deg": "--arc"}  # where the field is not called as the option


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
    "--cameras", type=_COUNT, default=_DEFAULT.cameras, help="Number of cameras around the room."
)
@click.option(
    "--people",
    type=_COUNT,
    default=_DEFAULT.people,
    help="Number of people who walk about and gesture.",
)
@click.option("--frames", type=_COUNT, default=_DEFAULT.frames, help="Length of the recording.")
@click.option("--fps", type=_POSITIVE, default=_DEFAULT.fps, help="Frames a second.")
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
    help="Share of images with a detection of nobody.",
)
@click.option(
    "--distortion",
    type=click.Choice(["none", "brown", "fisheye"]),
    default=_DEFAULT.distortion,
    help="Distortion of the lenses.",
)
@click.option(
    "--layout",
    type=click.Choice(["coco17", "all"]),
    default=_DEFAULT.layout,
    help="Joints of the detector.",
)
@click.option(
    "--radius",
    type=_POSITIVE,
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
    help="Put the detections of each image in random order.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=_DEFAULT.seed,
    help="The same seed gives the same bytes.",
)
@options.shared_options("quiet")
def command(shared: options.SharedOptions, output: Path, **fields: Any) -> None:
    """Make a recording of synthetic people with its truth.

    These are keypoints (COCO), cameras, who is who, and the true 3D poses.
    """
    from mocap_calib.io.results.scene import write_scene
    from mocap_calib.synthetic import simulate
    from mocap_calib_cli.progress import Reporter

    config = SimulateConfig(**fields)
    scene = simulate(config)
    write_scene(output, scene, format_command(config))
    detections = int((scene.identity >= 0).sum())
    Reporter(quiet=shared.quiet).say(
        f"{output}: {config.cameras} cameras, {config.frames} frames, {config.people} people, "
        f"{detections} detections of them"
    )


def format_command(config: SimulateConfig) -> str:
    """Return the command that makes the same scene, without options that have their defaults."""
    words = ["mocap-calib simulate -o OUT"]
    for name, value in vars(config).items():
        if name in ("size", "shuffle", "seed") or value == getattr(_DEFAULT, name):
            continue
        words.append(f"{_FLAGS.get(name, '--' + name.replace('_', '-'))} {value}")
    if not config.shuffle:
        words.append("--no-shuffle")
    words.append(f"--seed {config.seed}")
    return " ".join(words)
