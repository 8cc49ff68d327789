"""Write files and folders whole or not at all.

What is being written lies hidden beside its place: `.NAME.new` for a file, `.writing` in a folder.
A process holds a lock while it writes, which ends with the process: what a killed one left is
removed by the next that writes there, and what is being written by another is waited for.
"""

import errno
import os
import shutil
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from mocap_calib.errors import NO_ROOM, MismatchError
from mocap_calib.recording.names import compose_name

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

# in a folder: the files being written, all of them written and being moved, and those replaced
_WRITING, _WRITTEN, _REPLACED = ".writing", ".written", ".replaced"


@contextmanager
def replace_file(path: Path) -> Iterator[Path]:
    """Give a file to make that takes the place of `path` in one step when the block ends well.

    The folder is made when missing.
    """
    _check_no_folder(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    work = path.with_name(f".{path.name}.new")
    with _naming_full_disk(path), _locked(path.with_name(f".{path.name}.lock")):
        try:
            work.unlink(missing_ok=True)  # of a process that was killed
            yield work
            with work.open("rb+") as file:
                os.fsync(file.fileno())
            os.replace(work, path)
        except BaseException:
            work.unlink(missing_ok=True)
            raise


def write_pieces(path: Path, pieces: Iterable[bytes]) -> None:
    """Replace `path` by what comes in pieces, in one step; the folder is made when missing."""
    with replace_file(path) as work, work.open("wb") as file:
        file.writelines(pieces)


def write_bytes(path: Path, content: bytes) -> None:
    """Replace `path` by `content` in one step; the folder is made when missing."""
    write_pieces(path, [content])


@contextmanager
def replace_folder(path: Path) -> Iterator[Path]:
    """Give a folder to fill, whose files appear in `path` together when the block ends well.

    Files of the same names in `path` and its subfolders are replaced; others are left alone. No
    file appears when the block fails. Where the process is killed while files are moved, the next
    one that writes or reads there moves the others.
    """
    made = not path.exists()
    path.mkdir(parents=True, exist_ok=True)
    work = path / _WRITING
    try:
        with _naming_full_disk(path), _locked(path / f"{_WRITING}.lock"):
            _move_written(path)
            shutil.rmtree(work, ignore_errors=True)  # of a process that was killed
            work.mkdir()
            try:
                yield work
                for name in _files_below(work):
                    _check_no_folder(path / name)
                work.rename(path / _WRITTEN)
                _move_written(path)
            finally:
                shutil.rmtree(work, ignore_errors=True)
                shutil.rmtree(path / _WRITTEN, ignore_errors=True)
    except BaseException:
        if made:
            with suppress(OSError):
                path.rmdir()
        raise


def finish_replacing(folder: Path) -> None:
    """Move the files of `replace_folder` that a process which was killed had not moved yet."""
    if (folder / _WRITTEN).is_dir():
        with _locked(folder / f"{_WRITING}.lock"):
            _move_written(folder)


def write_files(path: Path, files: Mapping[str, bytes]) -> None:
    """Write files (relative path -> content) into the folder `path`, all or none."""
    with replace_folder(path) as work:
        for name, content in files.items():
            (work / name).parent.mkdir(parents=True, exist_ok=True)
            (work / name).write_bytes(content)


def check_no_other_files(path: Path, names: Collection[str], suffixes: Collection[str]) -> None:
    """Raise MismatchError where a folder has other files than `names` that would be read with them.

    names: of the files that are written, relative to the folder `path`; folders in it are looked
        at where some of the names lie in such.
    suffixes: of files that would be read.
    """
    nested = any("/" in name for name in names)
    own = {compose_name(name) for name in names}
    for file in sorted(path.rglob("*") if nested else path.glob("*")):
        inside = file.relative_to(path)
        hidden = any(part.startswith(".") for part in inside.parts)
        is_read = file.suffix.lower() in suffixes and file.is_file()
        if is_read and not hidden and compose_name(inside.as_posix()) not in own:
            expected = "a new folder or one with the same files"
            remedy = "choose another or remove that file"
            raise MismatchError(path, expected, inside.as_posix(), remedy)


def numbered_file(path: Path, individual: int) -> Path:
    """Return the file of an individual where each has its own: NAME_0, NAME_1, ..."""
    return path.with_name(f"{path.stem}_{individual}{path.suffix}")


def individual_files(path: Path, individuals: int) -> list[Path]:
    """Return the files of so many individuals: `path` itself for one, else a numbered one each."""
    if individuals == 1:
        return [path]
    return [numbered_file(path, individual) for individual in range(individuals)]


def check_no_further_individual(path: Path, individuals: int) -> None:
    """Raise MismatchError where a file beside those written passes for a further individual.

    It may be a recording of that name, so it is not removed.
    """
    first = numbered_file(path, 0)
    others = [first] if individuals == 1 else [path, numbered_file(path, individuals)]
    for further in others:
        if further.exists():
            beside = path.name if individuals == 1 else first.name
            expected = f"no file of a further individual beside {beside}"
            raise MismatchError(further, expected, "one", "remove it or choose another name")


def _check_no_folder(path: Path) -> None:
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))


def _files_below(folder: Path) -> list[Path]:
    """Return the files in a folder and its subfolders, relative to it."""
    return [file.relative_to(folder) for file in sorted(folder.rglob("*")) if file.is_file()]


def _move_written(path: Path) -> None:
    """Move the files that were written whole to their places in the folder `path`, all or none.

    None of the places is empty meanwhile. Each file that is replaced is kept until all are there,
    and put back if one cannot be.
    """
    written, replaced = path / _WRITTEN, path / _REPLACED
    shutil.rmtree(replaced, ignore_errors=True)
    moved: list[Path] = []
    try:
        for name in _files_below(written):
            (path / name).parent.mkdir(parents=True, exist_ok=True)
            if (path / name).exists():
                (replaced / name).parent.mkdir(parents=True, exist_ok=True)
                _duplicate(path / name, replaced / name)
            moved.append(name)
            os.replace(written / name, path / name)
    except BaseException:
        for name in moved:
            if (replaced / name).exists():
                os.replace(replaced / name, path / name)
            else:
                (path / name).unlink(missing_ok=True)
        raise
    finally:
        shutil.rmtree(replaced, ignore_errors=True)
    shutil.rmtree(written, ignore_errors=True)


def _duplicate(source: Path, target: Path) -> None:
    """Give a file a second name, or copy it where the file system has no links."""
    try:
        os.link(source, target, follow_symlinks=False)
    except OSError:
        shutil.copy2(source, target, follow_symlinks=False)


@contextmanager
def _naming_full_disk(path: Path) -> Iterator[None]:
    """Name the place in the error where nothing more can be written there."""
    try:
        yield
    except OSError as error:
        if error.errno not in NO_ROOM:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold the lock of a file that is there meanwhile; wait for another process that holds it."""
    while True:
        lock = path.open("ab")
        _lock(lock)
        try:
            if os.path.samestat(os.fstat(lock.fileno()), path.stat()):
                break
        except FileNotFoundError:  # the process that held it has removed the file
            pass
        lock.close()
    try:
        yield
    finally:
        with suppress(PermissionError):  # Windows keeps a file that is open
            path.unlink(missing_ok=True)
        lock.close()
        if sys.platform == "win32":
            with suppress(PermissionError):
                path.unlink(missing_ok=True)


def _lock(file: BinaryIO) -> None:
    """Wait for the lock of an open file; file systems without locks have none to wait for."""
    with suppress(OSError):
        if sys.platform == "win32":
            msvcrt.locking(file.fileno(), msvcrt.LK_LOCK, 1)
        else:
            fcntl.flock(file, fcntl.LOCK_EX)
