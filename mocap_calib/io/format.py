"""The record of a file format, what it loses, and what is asked of a table of formats."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

from mocap_calib.errors import FormatError, MismatchError, suggest
from mocap_calib.io.document import Document

Kind = Literal["keypoints", "cameras", "poses"]


@dataclass(frozen=True)
class Loss:
    """What a format has no place for.

    what: words that follow "does not hold"; `{0}` stands for the records.
    has: whether records of its kind have it.
    """

    what: str
    has: Callable[[Any], bool]


@dataclass(frozen=True, kw_only=True)  # `frozen` makes no class of keywords alone
class Format:
    """A file format: how it is recognised, read and written, and what it cannot hold.

    name: how users call it (`--format`, `--from`, `--to`).
    title: the program and the ending of its files, for sentences.
    sniff: whether a document is meant for this format, which its reader may still refuse; None
        where the format is only written.
    read: the records of a document: `(document, options)` of keypoints, else `(document)`; None
        where the format is only written.
    write: records as `Written` files: `(views)` of keypoints, `(rig, provenance)` of cameras, with
        points where the format has them; the content of a file for `(file, title)` of poses; None
        where it is only read.
    endings: of the names of files that are written in this format unless another is named.
    per_frame: a file holds one frame, a folder one camera (keypoints).
    folder: the format is several files, by names of its own (cameras).
    single: a file holds one individual (poses).
    timed: writing needs the number of frames per second (poses).
    unit: of its lengths, "" where the format leaves that open (cameras, poses).
    up: the axis that points up for its readers, y or z; "" = none, the axes stay (poses).
    result: what a run calls its file, where that is not poses3d and the ending (poses).
    rig: it shows the cameras too, where they are known (poses).
    points: it holds observed points as well, and `write` takes them (cameras).
    packages, extra: the modules that write the format where those are not always there, and the
        extra of mocap-calib that brings them.
    followed: its individuals are followed by definition: several detections that nobody follows
        are refused (keypoints).
    loses: what the format has no place for (keypoints, poses; writers of cameras return it).
    passed_over: names of fields, columns and data sets that say nothing of what is read: numbers
        under any other name that its reader does not ask for are reported (`Account`).
    """

    name: str
    title: str
    sniff: Callable[[Document], bool] | None = None
    read: Callable[..., Any] | None = None
    write: Callable[..., Any] | None = None
    endings: tuple[str, ...] = ()
    per_frame: bool = False
    folder: bool = False
    single: bool = False
    timed: bool = False
    followed: bool = False
    unit: str = ""
    up: str = ""
    result: str = ""
    rig: bool = False
    packages: tuple[str, ...] = ()
    extra: str = ""
    points: bool = False
    loses: tuple[Loss, ...] = ()
    passed_over: tuple[str, ...] = ()

    def lost(self, records: Any) -> tuple[str, ...]:
        """Return what of the records the format has no place for, in words."""
        return tuple(loss.what.format(records) for loss in self.loses if loss.has(records))

    def reader(self) -> Callable[..., Any]:
        """Return what reads the format. Raises MismatchError where it is only written."""
        if self.read is None:
            remedy = "give the file that it was made of, or leave the name of the format out"
            raise MismatchError(
                self.name, "a format that is read", "one that is only written", remedy
            )
        return self.read

    def read_noted(self, document: Document, *options: Any) -> tuple[Any, tuple[str, ...]]:
        """Return the records of a document, and a remark on its numbers that were not used.

        Raises what its reader raises.
        """
        document.account.asked.clear()  # by those that looked for its format
        records = self.reader()(document, *options)
        return records, document.account.describe(self.passed_over)

    def writer(self) -> Callable[..., Any]:
        """Return what writes the format.

        Raises MismatchError where it is only read, and where the packages for it are not there.
        """
        if self.write is None:
            remedy = "choose one that is (docs/formats.md)"
            raise MismatchError(
                self.name, "a format that is written", "one that is only read", remedy
            )
        missing = [name for name in self.packages if find_spec(name) is None]
        if missing:
            expected = f"the Python package {' and '.join(missing)}"
            remedy = f"pip install 'mocap-calib[{self.extra}]'"
            raise MismatchError(self.name, expected, "none", remedy)
        return self.write


@dataclass(frozen=True)
class Written:
    """Files to write: relative path -> content, and what of the records they do not carry."""

    files: Mapping[str, bytes]
    lost: tuple[str, ...] = ()


@dataclass(frozen=True)
class FormatTable:
    """The formats of one kind of files, in the order in which they are tried."""

    kind: Kind
    formats: tuple[Format, ...]

    def __iter__(self) -> Iterator[Format]:
        return iter(self.formats)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all formats."""
        return tuple(each.name for each in self)

    @property
    def read(self) -> tuple[str, ...]:
        """The names of the formats that are read."""
        return tuple(each.name for each in self if each.read is not None)

    @property
    def written(self) -> tuple[str, ...]:
        """The names of the formats that are written."""
        return tuple(each.name for each in self if each.write is not None)

    @property
    def by_ending(self) -> dict[str, tuple[str, ...]]:
        """Names of the formats that are written to files with an ending: ending -> names."""
        found: dict[str, tuple[str, ...]] = {}
        for each in self:
            for ending in each.endings:
                found[ending] = (*found.get(ending, ()), each.name)
        return found

    @property
    def expected(self) -> str:
        """The formats that are read, for refusals."""
        return f"{self.kind}, one of: {', '.join(self.read)}"

    def find(self, name: str) -> Format:
        """Return the format of that name. Raises MismatchError, which lists the names."""
        for each in self:
            if each.name == name:
                return each
        expected = f"one of the {self.kind.removesuffix('s')} formats {', '.join(self.names)}"
        raise MismatchError("", expected, f"{name!r}", suggest(name, self.names))

    def sniff(self, document: Document, name: str | None = None) -> str:
        """Return the name of the format that the content shows, "" where it shows none.

        Only the format of that name is tried where one is given. Raises FormatError.
        """
        tried = (each for each in self if name in (None, each.name))
        return next((each.name for each in tried if each.sniff and each.sniff(document)), "")

    def require(self, document: Document, name: str | None, remedy: str) -> Format:
        """Return the format of a document: what it is known to have, else what its content shows.

        name: of the only format to try; None: all of them. remedy: for content of no format.

        Raises FormatError where the content is of no format, or not of the one that is named.
        """
        shown = self.sniff(document, name) if document.format is None else document.format
        if shown:
            return self.find(shown)
        found, own_remedy = document.describe()
        expected = self.expected
        if name is not None:
            expected, remedy = self.find(name).title, "name another format, or none"
        raise FormatError(document.source, expected, found, own_remedy or remedy)


def ending_of(path: Path | str) -> str:
    """Return the ending of a file's name as `Format.endings` spells it."""
    return Path(path).suffix.lower()
