"""The record of a file format, and what is asked of a table of formats.

Each kind of file has its table: `io.keypoints.formats`, `io.cameras.formats`, `io.poses.formats`.
A new format is one file beside the table, one entry in it, and a row in docs/formats.md.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

from mocap_calib.errors import MismatchError, suggest
from mocap_calib.io.keypoints.losses import Loss

Kind = Literal["keypoints", "cameras", "poses"]
Sniff = TypeVar("Sniff", bound=Callable[..., bool])
Read = TypeVar("Read", bound=Callable[..., Any])
Write = TypeVar("Write", bound=Callable[..., Any])


@dataclass(frozen=True, kw_only=True)  # `frozen` makes no class of keywords alone
class Format(Generic[Sniff, Read, Write]):
    """A file format; what its three functions take and return is said by the table of its kind.

    kind: what its files hold.
    name: how users call it (`--format`, `--from`, `--to`).
    title: the program and the ending of its files, for sentences.
    sniff: whether a file is meant for this format, which its reader may still refuse.
    read: the content of a file as records.
    write: records as files; None where the format is only read.
    only_written: `sniff` and `read` refuse all.
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
    loses: what the format has no place for (keypoints; writers of other kinds return it).
    """

    kind: Kind
    name: str
    title: str
    sniff: Sniff
    read: Read
    write: Write | None = None
    only_written: bool = False
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

    def writer(self) -> Write:
        """Return what writes the format.

        Raises MismatchError where it is only read, and where the packages for it are not there.
        """
        if self.write is None:
            raise MismatchError(
                self.name,
                "a format that is written",
                "one that is only read",
                "choose one that is (docs/formats.md)",
            )
        missing = [name for name in self.packages if find_spec(name) is None]
        if missing:
            raise MismatchError(
                self.name,
                f"the Python package {' and '.join(missing)}",
                "none",
                f"pip install 'mocap-calib[{self.extra}]'",
            )
        return self.write


AnyFormat = Format[Any, Any, Any]
OneFormat = TypeVar("OneFormat", bound=AnyFormat)


@dataclass(frozen=True)
class Written:
    """Files to write: relative path -> content, and what of the records they do not carry."""

    files: Mapping[str, bytes]
    lost: tuple[str, ...] = ()


def find_format(formats: Sequence[OneFormat], name: str) -> OneFormat:
    """Return the format of that name. Raises MismatchError, which lists the names."""
    for each in formats:
        if each.name == name:
            return each
    kind = formats[0].kind.removesuffix("s")
    raise MismatchError(
        "",
        f"one of the {kind} formats {', '.join(format_names(formats))}",
        f"{name!r}",
        suggest(name, format_names(formats)),
    )


def format_names(formats: Iterable[AnyFormat]) -> tuple[str, ...]:
    """Return the names of the formats, in the order in which they are tried."""
    return tuple(each.name for each in formats)


def read_names(formats: Iterable[AnyFormat]) -> tuple[str, ...]:
    """Return the names of the formats that are read."""
    return tuple(each.name for each in formats if not each.only_written)


def written_names(formats: Iterable[AnyFormat]) -> tuple[str, ...]:
    """Return the names of the formats that are written."""
    return tuple(each.name for each in formats if each.write is not None)


def names_by_ending(formats: Iterable[AnyFormat]) -> dict[str, tuple[str, ...]]:
    """Return the names of the formats that are written to files with an ending: ending -> names."""
    found: dict[str, tuple[str, ...]] = {}
    for each in formats:
        for ending in each.endings:
            found[ending] = (*found.get(ending, ()), each.name)
    return found


def ending_of(path: Path | str) -> str:
    """Return the ending of a file's name as `Format.endings` spells it."""
    return Path(path).suffix.lower()
