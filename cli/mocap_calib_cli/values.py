"""The types of arguments: what is typed, as the value that the library takes, or a refusal.

`Written` values have a form of their own (`cam1:-3`), an `Input` says what it is where it is
missing; each offers to the shell what it may become. Readers are imported when a value needs them,
so that --help is quick; torch never is.
"""

import os
import re
import unicodedata
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from mocap_calib.config import CueKind, ScaleCue
from mocap_calib.errors import one_line
from mocap_calib_cli.outputs import STDIO, check_file, check_folder

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

Value = TypeVar("Value")
_LARGEST = 2**53  # whole numbers beyond it are not exact in a float


class Written(click.ParamType[Any]):
    """A value that is written in a form of its own, or a name of those that are offered.

    metavar: its form, for the help. form: the same in words, with an example.
    read: makes a value of the text; raises ValueError where the text has another form.
    offers: returns the values that there are, with a word on each. files: a file is one, too.
    """

    def __init__(
        self,
        metavar: str,
        form: str = "",
        read: Callable[[str], Any] = str,
        *,
        offers: Callable[[], Mapping[str, str]] = dict,
        files: bool = False,
    ) -> None:
        self.name = metavar.lower()
        self.metavar, self.form, self.read = metavar, form, read
        self.offers, self.files = offers, files

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the value of a text. Raises click's BadParameter."""
        try:
            return self.read(value)
        except ValueError:
            found = one_line(value, width=200)
            self.fail(f"expected {self.form}, found {found}", param, ctx)

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        """Return the form of the value."""
        return self.metavar

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> "list[CompletionItem]":
        """Return the values that begin as what was typed."""
        from click.shell_completion import CompletionItem

        offered = [
            CompletionItem(value, help=text)
            for value, text in self.offers().items()
            if value.startswith(incomplete)
        ]
        return [*offered, CompletionItem(incomplete, type="file")] if self.files else offered


# --- files and folders


class File(click.Path):
    """A file or folder, whose name may come from an option file, or from results."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path; no name of a file has a NUL."""
        if "\0" in os.fsdecode(value):
            self.fail(f"expected the name of a file, found {value!r}, with a NUL", param, ctx)
        return super().convert(value, param, ctx)


class Input(File):
    """A file or folder that a command reads."""

    def get_missing_message(
        self, param: click.Parameter, ctx: click.Context | None = None
    ) -> str | None:
        """Return what the help of the parameter says, which follows "Missing option"."""
        about = getattr(ctx and ctx.command, "helps", {}).get(param.name)
        return about and f"Expected: {about[0].lower()}{about[1:]}"


class Intrinsics(Input):
    """The file of the cameras' intrinsics; its message lists the formats that are read."""

    def get_missing_message(
        self, param: click.Parameter, ctx: click.Context | None = None
    ) -> str | None:
        """Return what intrinsics are, where to get them, and the formats that are read."""
        from mocap_calib.io.camera_files import CAMERA_FORMATS

        return (
            "Expected a file with the intrinsics of each camera (focal length, principal point, "
            "lens distortion), found none; film a checkerboard or ChArUco board with each camera, "
            "calibrate with anipose, caliscope, OpenCV, Kalibr or the like, and give the file that "
            f"it writes. Formats: {', '.join(each.name for each in CAMERA_FORMATS)} "
            "(docs/formats.md)."
        )


class NameOrFile(Written):
    """A word that the command knows, or a file, which its ending or its being there tells."""

    endings = (".toml", ".yaml", ".yml", ".json", ".xml", ".csv", ".txt", ".safetensors")

    def is_file(self, path: Path) -> bool:
        """Return whether it is a file rather than a word or the name of a camera."""
        # pathlib complains of names that are too long for a file
        return path.suffix.lower() in self.endings or os.path.isfile(path)


class Output(File):
    """A file or folder that a command writes, which is checked before the work starts."""

    def __init__(self, *, folder: bool = False) -> None:
        super().__init__(path_type=Path)
        self.folder = folder

    def check(self, path: Path | None) -> None:
        """Raise MismatchError or OSError where it could not be written; stdout can, and none."""
        if path is not None and str(path) != STDIO:
            (check_folder if self.folder else check_file)(path)


KEYPOINTS = Input()  # also name=path
INTRINSICS = Intrinsics()
INPUT = Input()
FILE = File(path_type=Path)
OUTPUT = Output()
OUTPUT_FOLDER = Output(folder=True)


# --- what is typed, as values; each reader raises ValueError for a text of another form


def _share(text: str) -> float:
    """Return the share that `5%` or `0.05` is."""
    text = text.strip()
    share = float(text.removesuffix("%")) / (100 if text.endswith("%") else 1)
    return _allowed(share, 0 < share <= 1)


def _allowed(value: Value, is_allowed: bool) -> Value:
    """Return a value that is allowed."""
    if not is_allowed:
        raise ValueError(value)
    return value


def _number(text: str) -> float:
    """Return a number of an exact size."""
    number = float(text)
    return _allowed(number, abs(number) < _LARGEST)


def _whole(text: str) -> int:
    """Return a whole number."""
    number = _number(text)
    return int(_allowed(number, number % 1 == 0))


def _positive(text: str) -> float:
    """Return a number above 0."""
    number = _number(text)
    return _allowed(number, number > 0)


def _degrees(text: str) -> int:
    """Return by how many degrees an image is rotated."""
    degrees = _whole(text)
    return _allowed(degrees, degrees in (90, 180, 270))


def _size(text: str) -> tuple[int, int]:
    """Return the width and the height of `WxH`."""
    width, height = map(_whole, text.lower().split("x"))
    return _allowed((width, height), min(width, height) > 0)


def _scale(text: str) -> tuple[float, ...]:
    """Return the factor of `F`, or those of width and height of `X,Y`."""
    factors = tuple(map(_positive, text.split(",")))
    return _allowed(factors, len(factors) <= 2)


def _corner(text: str) -> tuple[float, float]:
    """Return the x and the y of `X,Y`."""
    x, y = map(_number, text.split(","))
    return x, y


def _name(text: str) -> str:
    """Return the name of a camera in the normal form in which names are compared, NFC."""
    return unicodedata.normalize("NFC", text)


def _of_camera(
    read: Callable[[str], Value], *, of_all: bool = False
) -> Callable[[str], tuple[str, Value]]:
    """Return the reader of the camera and the value of `CAM:VALUE`.

    of_all: a value alone is that of all cameras, whose name is "".
    """

    def read_both(text: str) -> tuple[str, Value]:
        camera, _, value = text.rpartition(":")
        return _allowed(_name(camera), bool(camera) or of_all), read(value)

    return read_both


def _two_cameras(text: str) -> tuple[str, str]:
    """Return the cameras of `A,B`."""
    first, second = _name(text).split(",")
    return _allowed((first, second), bool(first and second) and first != second)


def _length(kind: CueKind, metavar: str, form: str) -> Written:
    """Return the type of a known length, `[OF=]METRES[+-SIGMA]`."""

    def read(text: str) -> ScaleCue:
        of, equals, value = text.rpartition("=")
        _allowed(of, bool(of.strip()) or (kind == "height" and not equals))
        metres, stated, sigma = value.replace("±", "+-").partition("+-")
        return ScaleCue(kind, float(metres), float(sigma if stated else 0), of.strip())

    return Written(metavar, form, read)


def _pattern(text: str) -> str:
    """Return a regular expression that is one. Raises click's BadParameter."""
    try:
        re.compile(text)
    except re.error as error:
        raise click.BadParameter(
            f"expected a regular expression, as 'cam[0-9]+', found {text} ({error})"
        ) from None
    return text


def _frames(text: str) -> list[int]:
    """Return the frame numbers of `100,200-210`, each once."""
    found: set[int] = set()
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        frames = range(_count(first), _count(last if dash else first) + 1)
        found.update(_allowed(frames, len(frames) > 0))
    return sorted(found)


def _count(text: str) -> int:
    """Return a number that is digits alone."""
    return int(_allowed(text, text.isdecimal()))


def _video(text: str) -> tuple[str, Path]:
    """Return the camera and the file of `CAM=FILE`."""
    camera, _, path = text.partition("=")
    return _allowed((camera, Path(path)), bool(camera and path))


PERCENTAGE = Written("SHARE", "a share of up to 100%, as 5% or 0.05", _share)
CAMERA = Written("CAM", read=_name)
IMAGE_SIZE = Written(
    "WxH|CAM:WxH", "a width and a height above 0, as 1280x720", _of_camera(_size, of_all=True)
)
FRAME_OFFSET = Written("CAM:N", "camera:frames with a whole number, as cam1:-3", _of_camera(_whole))
CROP_OFFSET = Written("CAM:X,Y", "camera:x,y, as cam1:640,0", _of_camera(_corner))
ROTATED = Written("CAM:DEG", "camera:degrees with 90, 180 or 270, as cam1:90", _of_camera(_degrees))
RESIZED = Written(
    "CAM:FACTOR|CAM:X,Y",
    "camera:factor above 0, or those of x and y, as cam1:0.5 or cam1:1,0.75",
    _of_camera(_scale),
)
MOVED = Written("CAM:FRAME", "camera:frame with a whole number, as cam1:500", _of_camera(_whole))
EXCHANGED = Written("A,B", "two cameras, as cam1,cam2", _two_cameras)
RATE = Written(
    "FPS|CAM:FPS",
    "frames per second above 0, or camera:frames per second, as cam1:25",
    _of_camera(_positive, of_all=True),
)
HEIGHT = _length(
    "height", "METRES|ID=METRES", "metres above 0, or individual=metres, as 0=1.75+-0.01"
)
LENGTH = _length(
    "length", "A-B=METRES", "two joints and metres above 0, as left_hip-left_knee=0.42+-0.01"
)
CAMERA_DISTANCE = _length(
    "camera distance", "A-B=METRES", "two cameras and metres above 0, as cam1-cam2=3.1+-0.02"
)
PATTERN = Written("REGEX", read=_pattern)
VIEWS = Written("A,B", read=lambda text: tuple(text.split(",")))
FRAMES = Written("N,N-N,...", "frame numbers, as 100,200-210", _frames)
VIDEO = Written("CAM=FILE", "CAM=FILE", _video)
