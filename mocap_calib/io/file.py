"""The bytes of files, the names in them, and limits of numbers that formats share."""

import codecs
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mocap_calib.errors import FormatError

MOST_POINTS = 100_000_000  # in a camera: 2.4 GB
LARGEST_FRAME = 2**62  # so that the difference of two frame numbers is an int64 as well
LARGEST_EXACT_FLOAT = 2**53  # whole numbers beyond it are not exact in a float


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
