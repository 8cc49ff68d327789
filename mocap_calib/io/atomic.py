"""Write files and folders whole or not at all."""

import errno
import os
import shutil
import tempfile
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from mocap_calib.errors import MismatchError
from mocap_calib.recording.names import compose_name


@contextmanager
def replace_file(path: Path) -> Iterator[Path]:
    """Give a file to write that takes the place of `path` in one step when the block ends well.

    The folder is made when missing.
    """
    _check_no_folder(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    os.close(handle)
    work = Path(name)
    try:
        yield work
        with work.open("rb+") as file:
            os.fsync(file.fileno())
        _set_usual_mode(work)
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
    file appears when the block fails.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    work = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}."))
    replaced = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}.old."))
    try:
        yield work
        path.mkdir(exist_ok=True)
        files = [file.relative_to(work) for file in sorted(work.rglob("*")) if file.is_file()]
        _move(files, work, path, replaced)
    finally:
        shutil.rmtree(work, ignore_errors=True)
        shutil.rmtree(replaced, ignore_errors=True)


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


def _set_usual_mode(path: Path) -> None:
    """Give a temporary file, which is its owner's alone, the mode that new files have."""
    umask = os.umask(0)
    os.umask(umask)
    os.chmod(path, 0o666 & ~umask)


def _move(names: list[Path], work: Path, path: Path, replaced: Path) -> None:
    """Move files from the folder `work` to `path`, all or none.

    What they replace is kept in `replaced` until all are there, and put back if one cannot be.
    """
    for name in names:
        _check_no_folder(path / name)
    moved: list[Path] = []
    try:
        for name in names:
            (path / name).parent.mkdir(parents=True, exist_ok=True)
            if (path / name).exists():
                (replaced / name).parent.mkdir(parents=True, exist_ok=True)
                os.replace(path / name, replaced / name)
            moved.append(name)
            os.replace(work / name, path / name)
    except BaseException:
        for name in moved:
            (path / name).unlink(missing_ok=True)
            if (replaced / name).exists():
                os.replace(replaced / name, path / name)
        raise
