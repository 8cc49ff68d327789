"""Files and folders that are written whole or not at all."""

import errno
import os
import shutil
import tempfile
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from mocap_calib.errors import MismatchError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A file to write: it takes the place of `path` in one step when the block ends well; the folder is made when missing."""
    _not_a_folder(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    os.close(handle)
    try:
        yield Path(name)
        with open(name, "rb+") as file:
            os.fsync(file.fileno())
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(name, 0o666 & ~umask)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def replace_text(path: Path, pieces: Iterable[str]) -> None:
    """Replaces `path` by text that comes in pieces, in one step."""
    with replacing(path) as work, work.open("w", encoding="utf-8", newline="") as file:
        file.writelines(pieces)


def write_bytes(path: Path, content: bytes) -> None:
    """Replaces `path` by `content` in one step; the folder is made when missing."""
    with replacing(path) as work:
        work.write_bytes(content)


@contextmanager
def folder(path: Path) -> Iterator[Path]:
    """A folder to fill: its files appear in `path` together when the block ends well, none when it fails.

    Files of the same names in `path` and its subfolders are replaced; others are left alone.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    work = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}."))
    old = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}.old."))
    try:
        yield work
        path.mkdir(exist_ok=True)
        _move(
            [file.relative_to(work) for file in sorted(work.rglob("*")) if file.is_file()],
            work,
            path,
            old,
        )
    finally:
        shutil.rmtree(work, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


def check_alone(path: Path, names: Collection[str], suffixes: Collection[str]) -> None:
    """Raises MismatchError where the folder has other files than `names` that would be read along with them: those with these suffixes.

    Folders in it count where the names lie in such.
    """
    nested = any("/" in name for name in names)
    files = (
        file.relative_to(path)
        for file in (path.rglob("*") if nested else path.glob("*"))
        if file.suffix.lower() in suffixes and file.is_file()
    )
    strangers = sorted(
        file.as_posix() for file in files if not any(part.startswith(".") for part in file.parts)
    )
    stranger = next((name for name in strangers if name not in names), None)
    if stranger is not None:
        raise MismatchError(
            f"{path}: expected a new folder or one with the same files, found {stranger}: choose another or remove it"
        )


def of_individual(path: Path, individual: int) -> Path:
    """The file of an individual where each has its own: the first has the plain name, the next NAME_1, NAME_2, ..."""
    return path if individual == 0 else path.with_name(f"{path.stem}_{individual}{path.suffix}")


def _not_a_folder(path: Path) -> None:
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))


def _move(names: list[Path], work: Path, path: Path, old: Path) -> None:
    """Moves files into place; what they replace is kept aside until all are there, and put back if one cannot be."""
    for name in names:
        _not_a_folder(path / name)
    moved: list[Path] = []
    try:
        for name in names:
            (path / name).parent.mkdir(parents=True, exist_ok=True)
            if (path / name).exists():
                (old / name).parent.mkdir(parents=True, exist_ok=True)
                os.replace(path / name, old / name)
            moved.append(name)
            os.replace(work / name, path / name)
    except BaseException:
        for name in moved:
            (path / name).unlink(missing_ok=True)
            if (old / name).exists():
                os.replace(old / name, path / name)
        raise
