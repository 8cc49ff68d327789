"""Hold what a reader is given: files in memory, parsed once, and what the user says of them.

However many formats look at a file, it is read and parsed once, so that a pipe can be sniffed too.
"""

import codecs
import csv
import io
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import msgspec

from mocap_calib.errors import FormatError
from mocap_calib.io.crash_guard import HDF5
from mocap_calib.io.file import Origin, decode, is_utf16, opened, read_bytes
from mocap_calib.io.hdf5 import HDF5_DAMAGE
from mocap_calib.recording.names import compose_name

# beginnings of files that hold something else around what is wanted: what they are, what to do
_FOREIGN = {
    b"\x1f\x8b": ("a file that gzip compressed", "gunzip it"),
    b"PK\x03\x04": ("a zip archive", "unpack it"),
    b"MATLAB 7.3": ("a MATLAB 7.3 file", "save it with -v7"),
    b"CDF\x01": ("netCDF 3", "save it as netCDF 4"),
    b"CDF\x02": ("netCDF 3", "save it as netCDF 4"),
}
_DAMAGED = "the file is cut or damaged: export it again"
_LISTED_TEXT = 40  # characters of a file in a message
_HEAD = 65536  # bytes of a file that formats are told by
_BLOCK = 250_000  # bytes that are read at a time


@dataclass(frozen=True)
class ReadOptions:
    """What a file does not say itself.

    layout: names of the keypoints, in the file's order.
    image_size: (width, height) in pixels, where the file has none; positions that are shares of
        the image are multiplied by it. image_sizes: camera -> its own.
    camera_pattern: regular expression that finds the camera's name in a path (its group `camera`,
        or its first group, or all of it), and perhaps the frame number (group `frame`).
    frame_offset: camera -> added to its frame numbers.
    crop_offset: camera -> (x, y) in pixels added to its positions.
    views: suffixes of keypoint names that stand for views (`paw_top`, `paw_bot`), each of which
        becomes a camera.
    single_precision: keep float32, a ten-thousandth of a pixel, of each file: long recordings need
        half the memory.
    """

    layout: tuple[str, ...] = ()
    image_size: tuple[int, int] = (0, 0)
    camera_pattern: str = ""
    frame_offset: Mapping[str, int] = field(default_factory=dict)
    crop_offset: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    views: tuple[str, ...] = ()
    single_precision: bool = False
    image_sizes: Mapping[str, tuple[int, int]] = field(default_factory=dict)

    def size_of(self, camera: str) -> tuple[int, int]:
        """Return the size of the images of a camera, (0, 0) where the user does not say."""
        sizes = {compose_name(name): size for name, size in self.image_sizes.items()}
        return sizes.get(compose_name(camera), self.image_size)


@dataclass(frozen=True)
class Document:
    """One file, read when it is first looked at. All its properties raise FormatError.

    A large one is read whole only where its `content` is asked for.
    """

    path: Path

    @property
    def source(self) -> str:
        """The file, as messages name it."""
        return str(self.path)

    @cached_property
    def _read(self) -> tuple[bytes, bool]:
        """The beginning of the content, and whether it is all.

        What is no file, such as a pipe, is read to its end, since it can be read but once.
        """
        if self.path.is_file():
            with opened(self.path) as file:
                start = file.read(_HEAD)
            if not is_utf16(start):
                return start, len(start) < _HEAD
        return read_bytes(self.path), True

    @property
    def start(self) -> bytes:
        """The beginning of the content."""
        return self._read[0][:_HEAD]

    @cached_property
    def content(self) -> bytes:
        """The whole content."""
        start, is_all = self._read
        return start if is_all else read_bytes(self.path)

    @property
    def size(self) -> int:
        """Number of bytes of the content."""
        start, is_all = self._read
        return len(start) if is_all else self.path.stat().st_size

    @contextmanager
    def opened(self) -> Iterator[BinaryIO]:
        """Open the content, which is not kept."""
        start, is_all = self._read
        if is_all:
            yield io.BytesIO(start)
            return
        with opened(self.path) as file:
            yield file

    def blocks(self, first_line: int = 0) -> Iterator[bytes]:
        """Return the content from a line on, in blocks of whole lines, of about 250 kB.

        The file is closed between two blocks: nobody need read it to its end.
        """
        with self.opened() as file:
            for _ in range(first_line):
                file.readline()
            place = file.tell()
        while True:
            with self.opened() as file:
                file.seek(place)
                block = file.read(_BLOCK) + file.readline()
                place = file.tell()
            if not block:
                return
            yield block

    def lines(self) -> Iterator[str]:
        """Return the lines of the text with their ends, a block of them in memory at a time."""
        encoding = "utf-8-sig"  # of the first block
        for block in self.blocks():
            try:
                text = block.decode(encoding)
            except UnicodeDecodeError:
                decode(self.content, self.source)  # says where
                raise
            yield from io.StringIO(text, newline="")
            encoding = "utf-8"

    @cached_property
    def text(self) -> str:
        """The content as UTF-8 text."""
        return decode(self.content, self.source)

    @cached_property
    def head(self) -> str:
        """The beginning of the content as text, with marks for what is none."""
        return self.start.decode("utf-8-sig", errors="replace")

    @property
    def is_json(self) -> bool:
        """Whether the content begins as a JSON array or object does; `[word` begins TOML."""
        start = rb"(\xef\xbb\xbf)?\s*(\{|\[(?!\s*\[?\s*[A-Za-z_]))"
        return re.match(start, self.start[:4096]) is not None

    @property
    def is_hdf5(self) -> bool:
        """Whether the content has HDF5's signature."""
        return self.start.startswith(HDF5)

    @cached_property
    def json(self) -> Any:
        """The content as JSON; None where it does not begin like it."""
        if not self.is_json:
            return None
        with suppress(msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return msgspec.json.decode(self.content.removeprefix(codecs.BOM_UTF8))
        try:  # which also reads NaN and Infinity, and says what is wrong
            return json.loads(self.text)
        except RecursionError:
            raise FormatError(
                self.source, "JSON of keypoints", "JSON nested too deeply", "export it again"
            ) from None
        except ValueError as error:
            raise FormatError(
                self.source, "complete JSON", f"an error ({error})", _DAMAGED
            ) from None

    @cached_property
    def header(self) -> tuple[str, ...]:
        """The cells of the first line that is not blank; none where it holds control characters."""
        lines = (line for line in self.head.splitlines() if line.strip())
        line = next(lines, "")
        if not line.isprintable() and "\t" not in line:
            return ()
        return tuple(cell.strip() for cell in next(csv.reader([line])))

    @cached_property
    def hdf5(self) -> Any:
        """The content as an open HDF5 file; None where it is none."""
        if not self.is_hdf5:
            return None
        try:
            start, is_all = self._read
            return h5py.File(io.BytesIO(start) if is_all else self.path, "r", locking=False)
        except HDF5_DAMAGE as error:
            raise FormatError(
                self.source, "a whole HDF5 file", f"an error ({error})", _DAMAGED
            ) from None


@dataclass(frozen=True)
class Item:
    """What is read in one go: a file, or a folder with a file per frame.

    camera: the name that the path gives, or the user (`named`).
    members: the files of a folder.
    format: name of the format, "" where the content is of none; None where nobody has looked yet.
    """

    camera: str
    path: Path
    members: tuple[Path, ...] = ()
    named: bool = False
    format: str | None = None

    @cached_property
    def document(self) -> Document:
        """The file, or the first file of the folder that is not empty."""
        documents = [Document(path) for path in self.members or (self.path,)]
        for document in documents:
            if document.size > _HEAD or document.content.strip() not in (b"", b"[]"):
                return document
        return documents[0]

    @property
    def origin(self) -> Origin:
        """Camera and path."""
        return Origin(self.camera, str(self.path))

    def documents(self) -> Iterator[Document]:
        """Return all files, one in memory at a time."""
        if not self.members:
            return iter((self.document,))
        return map(Document, self.members)


def describe(document: Document) -> tuple[str, str]:
    """Return what a file of no known format is, and what to do with it ("" where unclear).

    Raises FormatError where the file is damaged.
    """
    for start, description_and_remedy in _FOREIGN.items():
        if document.start.startswith(start):
            return description_and_remedy
    return _describe_content(document), ""


def _describe_content(document: Document) -> str:
    """Describe JSON, HDF5 or other content."""
    content = document.json
    if document.hdf5 is not None:
        return f"HDF5 with {_first_names(document.hdf5)}"
    if isinstance(content, dict):
        return f"a JSON object with {_first_names(content)}"
    if isinstance(content, list):
        first = content[0] if content else None
        if isinstance(first, dict):
            return f"a JSON list of objects with {', '.join(list(first)[:8])}"
        return f"a JSON list of {len(content)}"
    return _describe_bytes(document)


def _describe_bytes(document: Document) -> str:
    """Describe what is neither JSON nor HDF5 by its beginning."""
    if not document.content.strip():
        return "an empty file"
    start = " ".join(document.head[:_LISTED_TEXT].split())
    if start.isprintable():
        return f"text that begins with {start!r}"
    return f"content that begins with {document.content[:16]!r}"


def _first_names(names: Iterable[object]) -> str:
    return ", ".join(map(str, list(names)[:8])) or "nothing"
