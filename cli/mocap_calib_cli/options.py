"""The options that commands share, said once."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

Command = TypeVar("Command", bound=Callable[..., Any])
Option = Callable[[Command], Command]

STDIO = "-"

keypoints = click.argument("keypoints", nargs=-1, required=True, metavar="KEYPOINTS...")
cameras = click.option(
    "--cameras",
    required=True,
    metavar="INTRINSICS",
    help="File or folder with the cameras' intrinsics, in any format of docs/formats.md; - reads stdin.",
)
rig = click.option(
    "--rig",
    required=True,
    metavar="CAMERAS",
    help="File or folder with cameras and where they stand (docs/formats.md); - reads stdin.",
)
matches = click.option(
    "--matches",
    required=True,
    metavar="MATCHES",
    help="File of the command `match`; - reads stdin.",
)
skeleton = click.option(
    "--skeleton",
    type=click.Path(path_type=Path),
    metavar="FILE.yaml",
    help="Your names of joints: a mapping `aliases`, own name: joint.",
)
model = click.option(
    "--model",
    metavar="NAME|FILE|none",
    help="Network: shipped (see `models`) or one of your own; none: geometry alone. [default: by joint names]",
)
solver = click.option(
    "--solver",
    type=click.Choice(["search", "paper", "five-point"]),
    default="search",
    help="Of pairs: ours, the paper's gradient descent (slow), or its five-point baseline.",
)
seed = click.option(
    "--seed", type=click.IntRange(min=0), default=0, help="The same seed gives the same results."
)
device = click.option(
    "--device", type=click.Choice(["cpu", "cuda"]), default="cpu", help="Where the network runs."
)
scheduler = click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Dask scheduler whose workers do the work (tcp://HOST:PORT); same results.",
)
quiet = click.option("--quiet", "-q", is_flag=True, help="Say nothing on stderr but errors.")


def output_text(what: str) -> Callable[[Command], Command]:
    """`-o FILE` of a command whose result is text: stdout unless a file is given."""
    return click.option(
        "-o",
        "--output",
        default=STDIO,
        metavar="FILE",
        help=f"Where to write the {what}; - is stdout.",
    )


def output_file(what: str) -> Callable[[Command], Command]:
    """`-o FILE` of a command whose result is a file."""
    return click.option(
        "-o", "--output", type=click.Path(path_type=Path), required=True, metavar="FILE", help=what
    )


def as_json(what: str) -> Callable[[Command], Command]:
    """`--json`."""
    return click.option("--json", "as_json", is_flag=True, help=what)


_READING = {
    "format": (
        "--format",
        "NAME",
        False,
        "Format of the keypoint files, where their content does not show it (docs/formats.md).",
    ),
    "layout": (
        "--layout",
        "NAME",
        False,
        "Names of the keypoints in files that do not name them: body_25, body_25b, coco_17, ... or a,b,c.",
    ),
    "image_size": (
        "--image-size",
        "WxH",
        False,
        "Size of the images in pixels, where the files do not say it; positions from 0 to 1 are multiplied by it.",
    ),
    "camera_regex": (
        "--camera-regex",
        "REGEX",
        False,
        "Finds the camera's name in a path: its group `camera`, its first, or all of it.",
    ),
    "frame_offset": (
        "--frame-offset",
        "CAM:N",
        True,
        "Added to the frame numbers of a camera; may be given for each.",
    ),
    "crop_offset": (
        "--crop-offset",
        "CAM:X,Y",
        True,
        "Corner of the part of the image in which a camera's keypoints were found.",
    ),
    "views": (
        "--views",
        "A,B",
        False,
        "Views in one file: endings of keypoint names (paw_A, paw_B), each a camera.",
    ),
}


def reading(command: Command) -> Command:
    """The options that say how keypoint files are to be read, given to the command as one dictionary `reading`."""
    return _reading(command, tuple(_READING))


def reading_but_format(command: Command) -> Command:
    """The same, of a command that has its own option for the format."""
    return _reading(command, tuple(name for name in _READING if name != "format"))


def _reading(command: Command, names: tuple[str, ...]) -> Command:
    @functools.wraps(command)
    def collected(**values: Any) -> Any:
        return command(reading={name: values.pop(name) for name in names}, **values)

    for name in reversed(names):
        flag, metavar, multiple, text = _READING[name]
        collected = click.option(flag, name, metavar=metavar, multiple=multiple, help=text)(
            collected
        )
    return collected  # type: ignore[return-value]  # click keeps the kind of what it decorates
