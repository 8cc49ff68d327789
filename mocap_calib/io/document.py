"""Hold a file, or the files of a folder, while formats look at it: read once and parsed once.

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
from typing import Any, BinaryIO, TypeVar
from xml.etree import ElementTree

import msgspec

from mocap_calib.errors import FormatError
from mocap_calib.io.account import Account, Fields, record_fields
from mocap_calib.io.file import Origin, decode, is_utf16, opened, read_bytes
from mocap_calib.io.hdf5 import DAMAGE, HDF5, damage_refused, open_noted
from mocap_calib.io.syntax import is_toml, parse

# beginnings of files that hold something else around what is wanted: what they are, what to do
_FOREIGN = {
    b"\x1f\x8b": ("a file that gzip compressed", "gunzip it"),
    b"PK\x03\x04": ("a zip archive", "unpack it"),
    b"MATLAB 7.3": ("a MATLAB 7.3 file", "save it with -v7"),
    b"CDF\x01": ("netCDF 3", "save it as netCDF 4"),
    b"CDF\x02": ("netCDF 3", "save it as netCDF 4"),
}
_BINARY = (b"MATLAB", b"\x89HDF", b"\x00")
_DAMAGED = "the file is cut or damaged: export it again"
_LISTED_TEXT = 40  # characters of a file in a message
_HEAD = 65536  # bytes of a file that formats are told by
_BLOCK = 60_000  # bytes that are read at a time
_SEPARATORS = ",;\t"  # of the cells of tables; a comma where several occur equally often
_TYPES = {
    "array": "a list",
    "float": "a number",
    "int": "a whole number",
    "object": "an object",
    "str": "text",
}
NAMELESS = "stdin"  # the path of content that comes without one
T = TypeVar("T")


@dataclass(frozen=True)
class Document:
    """One file, or the files of a folder; read when they are first looked at.

    A folder shows the content of its first file that is not empty. All properties raise
    FormatError. A large file is read whole only where its `content` is asked for.

    path: names it in messages; its content is there, unless it is `given`.
    members: the files of a folder, by name.
    camera: the name that the path gives, or the user (`named`).
    format: name of the format, "" where the content is of none; None where nobody has looked yet.
    account: of the numbers in its files, which is that of all documents made of this one.
    """

    path: Path
    given: bytes | None = None
    members: tuple[Path, ...] = ()
    camera: str = ""
    named: bool = False
    format: str | None = None
    account: Account = field(default_factory=Account, compare=False, repr=False)

    @property
    def source(self) -> str:
        """The file or folder, as messages name it."""
        return str(self.path)

    @property
    def origin(self) -> Origin:
        """Camera and path."""
        return Origin(self.camera, self.source)

    @property
    def stem(self) -> str:
        """The file's name without its ending."""
        return self.path.stem

    @property
    def is_folder(self) -> bool:
        """Whether it is the files of a folder."""
        return bool(self.members)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of a folder's files."""
        return tuple(member.name for member in self.members)

    def of(self, name: str) -> "Document":
        """Return one file of the folder."""
        return Document(self.path / name, account=self.account)

    def documents(self) -> Iterator["Document"]:
        """Return all files, one in memory at a time."""
        each = (Document(member, account=self.account) for member in self.members)
        return each if self.members else iter((self,))

    def refuse(self, expected: str, found: object, remedy: str = "export it again") -> FormatError:
        """Return the refusal of the file."""
        return FormatError(self.source, expected, found, remedy)

    # --- bytes

    @cached_property
    def file(self) -> Path:
        """The path of the content."""
        documents = [Document(member) for member in self.members]
        filled = (each.path for each in documents if not each.is_empty)
        file = next(filled, self.members[0] if self.members else self.path)
        # the process that reads it may have another working directory
        return file.absolute() if file.exists() else file

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing but blanks, or an empty list of JSON."""
        return self.size <= _HEAD and self.content.strip() in (b"", b"[]")

    @cached_property
    def _read(self) -> tuple[bytes, bool]:
        """The beginning of the content, and whether it is all.

        What is no file, such as a pipe, is read to its end, since it can be read but once.
        """
        if self.given is not None:
            return self.given, True
        if self.file.is_file():
            with opened(self.file) as file:
                start = file.read(_HEAD)
            if not is_utf16(start):
                return start, len(start) < _HEAD
        return read_bytes(self.file), True

    @property
    def start(self) -> bytes:
        """The beginning of the content."""
        return self._read[0][:_HEAD]

    @cached_property
    def content(self) -> bytes:
        """The whole content."""
        start, is_all = self._read
        return start if is_all else read_bytes(self.file)

    @property
    def size(self) -> int:
        """Number of bytes of the content."""
        start, is_all = self._read
        return len(start) if is_all else self.file.stat().st_size

    @contextmanager
    def opened(self) -> Iterator[BinaryIO]:
        """Open the content, which is not kept."""
        start, is_all = self._read
        if is_all:
            yield io.BytesIO(start)
            return
        with opened(self.file) as file:
            yield file

    def blocks(self, first_line: int = 0) -> Iterator[bytes]:
        """Return the content from a line on, in blocks of whole lines, of about 60 kB.

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

    # --- text

    @cached_property
    def text(self) -> str:
        """The content as UTF-8 text."""
        return decode(self.content, self.source)

    @cached_property
    def head(self) -> str:
        """The beginning of the content as text, with marks for what is none."""
        return self.start.decode("utf-8-sig", errors="replace")

    def lines(self, first_line: int = 0) -> Iterator[str]:
        """Return the lines from a line on with their ends, a block of them in memory at a time."""
        encoding = "utf-8-sig"  # of the first block
        for block in self.blocks(first_line):
            try:
                text = block.decode(encoding)
            except UnicodeDecodeError:
                decode(self.content, self.source)  # says where
                raise
            yield from io.StringIO(text, newline="")
            encoding = "utf-8"

    @property
    def _first_line(self) -> str:
        """The first line that is not blank."""
        return next((line for line in self.head.splitlines() if line.strip()), "")

    @cached_property
    def separator(self) -> str:
        """What separates the cells of a table: the separator that its first line has most of."""
        return max(_SEPARATORS, key=self._first_line.count)

    @cached_property
    def header(self) -> tuple[str, ...]:
        """The cells of the first line that is not blank; none where it holds control characters."""
        line = self._first_line
        if not line.isprintable() and "\t" not in line:
            return ()
        cells = next(csv.reader([line], delimiter=self.separator))
        return tuple(cell.strip() for cell in cells)

    # --- trees

    @cached_property
    def syntax(self) -> str:
        """`folder`, `binary`, `json`, `toml` or `yaml` (which is any other text)."""
        if self.is_folder:
            return "folder"
        if self.content.startswith(_BINARY) or b"\x00" in self.content[:512]:
            return "binary"
        if is_toml(self.text):
            return "toml"
        return "json" if re.match(r"\s*[\[{]", self.text) else "yaml"

    @cached_property
    def tree(self) -> Any:
        """The text parsed by its syntax; each key occurs once."""
        if self.syntax in ("folder", "binary"):
            raise self.refuse("text", f"a {self.syntax}", "name another format")
        return self.account.add(parse(self.text, self.syntax, self.source))

    def mapping(self, *keys: str) -> dict[str, Any]:
        """Return the tree, which is a mapping with the keys."""
        expected = "a mapping of names to fields"
        if not isinstance(self.tree, dict):
            raise self.refuse(expected, type(self.tree).__name__, "export the cameras again")
        need(self.tree, keys, self.source)
        return self.tree

    def has(self, syntax: str, keys: Iterable[str] = ()) -> bool:
        """Return whether the file is a mapping of that syntax with all of the keys."""
        return self.syntax == syntax and isinstance(self.tree, dict) and {*keys} <= {*self.tree}

    def has_line(self, pattern: str) -> bool:
        """Return whether the file is YAML with a line that the pattern finds."""
        return self.syntax == "yaml" and re.search(pattern, self.text, re.M) is not None

    def has_entry(self, keys: Iterable[str]) -> bool:
        """Return whether a JSON mapping has an entry with the keys, or a list of such."""
        if not self.has("json"):
            return False
        lists = (each if isinstance(each, list) else [each] for each in self.tree.values())
        return any(isinstance(each, dict) and {*keys} <= {*each} for one in lists for each in one)

    @property
    def is_json(self) -> bool:
        """Whether the content begins as a JSON array or object does; `[word` begins TOML."""
        start = rb"(\xef\xbb\xbf)?\s*(\{|\[(?!\s*\[?\s*[A-Za-z_]))"
        return re.match(start, self.start[:4096]) is not None

    @cached_property
    def json(self) -> Any:
        """The content as JSON, of which a key may occur twice; None where it is none."""
        if not self.is_json:
            return None
        with suppress(msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return msgspec.json.decode(self.content.removeprefix(codecs.BOM_UTF8))
        try:  # which also reads NaN and Infinity, and says what is wrong
            return json.loads(self.text)
        except RecursionError:
            raise self.refuse("JSON of keypoints", "JSON nested too deeply") from None
        except ValueError as error:
            raise self.refuse("complete JSON", f"an error ({error})", _DAMAGED) from None

    def records(self, kind: type[T]) -> T:
        """Return the JSON as records. Raises FormatError with the place in the file."""
        if self.json is None:
            raise self.refuse("JSON", self.describe()[0], "export it again, or remove it")
        self.account.add_numbers(self.json)
        self.account.asked |= record_fields(kind)
        return typed(self.json, kind, self.source)

    @cached_property
    def xml(self) -> ElementTree.Element | None:
        """The root of the content as XML; None where it is none, or declares entities."""
        start = self.start.removeprefix(codecs.BOM_UTF8).lstrip()
        if self.is_folder or not start.startswith(b"<") or b"<!DOCTYPE" in self.content:
            return None
        try:
            return ElementTree.fromstring(self.content)
        except ElementTree.ParseError as error:
            raise self.refuse("complete XML", f"an error ({error})", _DAMAGED) from None

    # --- HDF5

    @property
    def is_hdf5(self) -> bool:
        """Whether the content has HDF5's signature."""
        return self.start.startswith(HDF5)

    @cached_property
    def hdf5(self) -> Any:
        """The content as an open HDF5 file; None where it is none."""
        if not self.is_hdf5:
            return None
        try:
            start, is_all = self._read
            return open_noted(io.BytesIO(start) if is_all else self.file, self.account)
        except DAMAGE as error:
            raise self.refuse("a whole HDF5 file", f"an error ({error})", _DAMAGED) from None

    # --- for refusals

    def describe(self) -> tuple[str, str]:
        """Return what a file of no known format is, and what to do with it ("" where unclear)."""
        for start, description_and_remedy in _FOREIGN.items():
            if self.start.startswith(start):
                return description_and_remedy
        return self._describe_content(), ""

    def _describe_content(self) -> str:
        """Describe JSON, HDF5 or other content."""
        if self.hdf5 is not None:
            with damage_refused(self.source, "a whole HDF5 file", _DAMAGED):
                return f"HDF5 with {describe_names(self.hdf5)}"
        if self.json is not None:
            return _describe_json(self.json)
        if not self.content.strip():
            return "an empty file"
        start = " ".join(self.head[:_LISTED_TEXT].split())
        if start.isprintable():
            return f"text that begins with {start!r}"
        return f"content that begins with {self.content[:16]!r}"


def as_document(source: str | Path | bytes) -> Document:
    """Return a file, or the content of one, as a document."""
    if isinstance(source, bytes):
        return Document(Path(NAMELESS), given=source, camera=NAMELESS)
    return Document(Path(source))


def _describe_json(content: Any) -> str:
    """Describe an object or a list."""
    if isinstance(content, dict):
        return f"a JSON object with {describe_names(content)}"
    if content and isinstance(content[0], dict):
        return f"a JSON list of objects with {', '.join(list(content[0])[:8])}"
    return f"a JSON list of {len(content)}"


def describe_names(value: Any) -> str:
    """Return the first names in a mapping, or the type of what is none."""
    if not isinstance(value, Mapping):
        return type(value).__name__
    return ", ".join(map(str, list(value)[:8])) or "nothing"


def typed(tree: Any, kind: type[T], source: str, expected: str = "") -> T:
    """Return a parsed tree as records. Raises FormatError with the place in the tree.

    expected: what the records are, for a refusal; numbers may be text then, as in YAML.
    """
    if isinstance(tree, Fields):
        tree.asked |= record_fields(kind)
    try:
        return msgspec.convert(tree, kind, strict=not expected)
    except (msgspec.ValidationError, TypeError, OverflowError) as error:
        said, _, place = re.sub("`(.+?)`", _in_words, str(error)).partition(" - at ")
        wanted, _, found = said.removeprefix("Expected ").partition(", got ")
        if said.startswith("Object missing required"):
            wanted, found = said.removeprefix("Object missing required "), "none"
        at = f" at {place}" if place else ""
        if not found:  # such as "Invalid enum value 'x'"
            wanted, found = expected or "another value", said[:1].lower() + said[1:]
        raise FormatError(source, f"{wanted}{at}", found, "export it again") from None


def _in_words(kind: re.Match[str]) -> str:
    """Return a type of JSON as text has it; anything else as it is."""
    return " or ".join(_TYPES.get(each, each) for each in kind[1].split(" | "))


def need(fields: Mapping[str, Any], keys: Iterable[str], source: str) -> None:
    """Raise FormatError where a key is missing."""
    missing = [key for key in keys if key not in fields]
    if missing:
        expected = f"the keys {', '.join(keys)}"
        found = f"none of {', '.join(missing)}"
        raise FormatError(source, expected, found, "export the cameras again")
