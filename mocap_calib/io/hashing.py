"""Hashes of files: what results follow from, and whether they are still what was written."""

import hashlib
import os
from collections.abc import Iterable
from pathlib import Path

from mocap_calib.compute.parallel import map_in_threads


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file, as hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def hash_files(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of every file below a folder, by its path relative to the folder."""
    files = [file for file in sorted(folder.rglob("*")) if file.is_file()]
    names = (file.relative_to(folder).as_posix() for file in files)
    return dict(zip(names, map_in_threads(hash_file, files), strict=True))


def hash_inputs(paths: Iterable[str | Path]) -> dict[str, str]:
    """Return the SHA-256 of each file, and of each entry of each folder, by its path.

    A folder within a folder, such as that of a camera's frames, has one hash for all its files
    and their names. What is neither file nor folder (a pipe has been read already) is left out.
    Bytes of a path that are not UTF-8 are escaped, as files say these paths.
    """
    entries = (entry for path in map(Path, paths) for entry in _entries(path))
    found = [entry for entry in entries if os.path.isfile(entry) or os.path.isdir(entry)]
    names = (str(entry).encode(errors="backslashreplace").decode() for entry in found)
    return dict(zip(names, map_in_threads(_hash_entry, found), strict=True))


def _entries(path: Path) -> list[Path]:
    """Return the entries of a folder, or the path itself where it is none."""
    return sorted(path.iterdir()) if os.path.isdir(path) else [path]


def _hash_entry(path: Path) -> str:
    """Return the SHA-256 of a file, or of a folder."""
    return _hash_folder(path) if path.is_dir() else hash_file(path)


def _hash_folder(folder: Path) -> str:
    """Return one SHA-256 for the names and contents of all files below a folder."""
    lines = [f"{name} {content}" for name, content in hash_files(folder).items()]
    return hashlib.sha256("\n".join(lines).encode(errors="backslashreplace")).hexdigest()
