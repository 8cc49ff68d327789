"""The bytes of files, the names and zeros in them, limits of numbers, and files of another kind."""

import codecs
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from mocap_calib.errors import FormatError, one_line
from mocap_calib.io.atomic import finish_replacing
from mocap_calib.recording.names import compose_name
from mocap_calib.types import Floats

MOST_POINTS = 100_000_000  # in a camera: 2.4 GB
LARGEST_FRAME = 2**62  # so that the difference of two frame numbers is an int64 as well
LARGEST_EXACT_FLOAT = 2**53  # whole numbers beyond it are not exact in a float
_VIDEOS = (".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm", ".wmv", ".mpg", ".mpeg", ".mts", ".flv")
_IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".gif", ".webp")
_ESTIMATORS = "DeepLabCut, SLEAP, Lightning Pose, OpenPose, AlphaPose, MMPose, Ultralytics, ..."
_LISTED = 3  # names of files in a message


def are_whole(numbers: Floats) -> bool:
    """Return whether all are whole numbers that floats hold exactly; infinity and NaN are not."""
    exact = np.abs(numbers) < LARGEST_EXACT_FLOAT
    return bool((exact & (np.rint(numbers) == numbers)).all())


def plain_path(argument: str | Path) -> Path:
    """Return the path of a file, a folder or a `name=path` pair."""
    path = Path(argument)
    _, equals, rest = str(argument).partition("=")
    return Path(rest) if equals and not path.exists() else path


def read_bytes(path: Path) -> bytes:
    """Read a whole file at once, so that a pipe can be recognised by its content as well.

    UTF-16, which PowerShell's `>` writes, becomes UTF-8. Raises FormatError.
    """
    with opened(path) as file:
        content = file.read()
    if not is_utf16(content):
        return content
    try:
        return content.decode("utf-16").encode()
    except UnicodeError:
        return content


def is_utf16(content: bytes) -> bool:
    """Return whether content begins with the mark of UTF-16."""
    return content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))


@contextmanager
def opened(path: Path) -> Iterator[BinaryIO]:
    """Open a file whose bytes are read. Raises FormatError where it cannot be."""
    try:
        finish_replacing(path.parent)
        with path.open("rb") as file:
            yield file
    except FileNotFoundError:
        raise FormatError(str(path), "a file or folder", "none", "check the path") from None
    except IsADirectoryError:
        raise FormatError(str(path), "a file", "a folder", "give a file in it") from None
    except (OSError, ValueError) as error:
        found = getattr(error, "strerror", None) or error
        raise FormatError(str(path), "a readable file", found, "check the path") from None


def decode(content: bytes, source: str) -> str:
    """Return UTF-8 text without its byte order mark. Raises FormatError."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        found = f"byte {content[error.start]:#04x} at {error.start}"
        raise FormatError(source, "UTF-8 text", found, "save it as UTF-8") from None


def find_repeated(names: Iterable[str]) -> list[str]:
    """Return the names that occur more than once, sorted."""
    return sorted(name for name, count in Counter(names).items() if count > 1)


@dataclass(frozen=True)
class Origin:
    """Where detections come from: the camera's name, and the file as complaints name it."""

    camera: str
    source: str


def readable_name(name: str, source: str, owner: str = "camera") -> str:
    """Return the name of a camera or a keypoint as names are compared, see `compose_name`.

    source: the file that it is of. owner: of the name.

    Raises FormatError where it is no text, as that of a file whose name is not UTF-8, or holds a
    NUL: no file that is written could hold it.
    """
    try:
        name.encode()
        is_text = "\0" not in name
    except UnicodeEncodeError:
        is_text = False
    if not is_text:
        own = owner == "camera"  # whose name may be that of the file
        remedy = "rename the file or the camera, or use name=path" if own else f"rename the {owner}"
        raise FormatError(source, f"a {owner} name in UTF-8 without NUL", name, remedy)
    return compose_name(name)


def unsigned_zeros(value: Any) -> Any:
    """Return nested mappings, lists and numbers in which -0.0 is 0.0; arrays become lists.

    The sign of a zero is left over from a product or a rounding, and says nothing.
    """
    if isinstance(value, np.ndarray):
        return (value + 0.0).tolist()
    if isinstance(value, Mapping):
        return {key: unsigned_zeros(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [unsigned_zeros(each) for each in value]
    return value + 0.0 if isinstance(value, float) else value


def name_media(path: Path) -> str:
    """Return "a video" or "an image" where the ending of a path says so, else "".

    Videos are too large to be opened for it.
    """
    ending = path.suffix.lower()
    if ending in _VIDEOS:
        return "a video"
    return "an image" if ending in _IMAGES else ""


def check_no_media(path: Path, endings: Sequence[str]) -> None:
    """Raise FormatError for a video, an image, or a folder with some: no keypoints were found yet.

    endings: of files of keypoints.
    """
    files = sorted([*path.glob("*"), *path.glob("*/*")]) if path.is_dir() else [path]
    media = {file.name: name_media(file) for file in files if name_media(file)}
    if media:
        found = media.get(path.name, "")
        if path.is_dir():
            kinds = " and ".join(sorted({f"{kind.split()[1]}s" for kind in media.values()}))
            more = ", ..." if len(media) > _LISTED else ""
            found = f"{kinds} ({', '.join(sorted(media)[:_LISTED])}{more})"
        run = f"run a 2D pose estimator first ({_ESTIMATORS}), and give the files that it writes"
        remedy = f"{run}: {', '.join(endings)} (docs/formats.md)"
        raise FormatError(one_line(path, 300), "files of 2D keypoints", found, remedy)
