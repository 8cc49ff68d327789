"""Where results go: stdout, a file, or a folder.

Places are checked before the work starts; files are written whole or not at all.
"""

import tempfile
from collections.abc import Iterable
from pathlib import Path

import click

from mocap_calib.errors import MismatchError
from mocap_calib.io.atomic import replace_text
from mocap_calib_cli.options import STDIO


def write_text(output: str, pieces: Iterable[str]) -> None:
    """Write text that comes in pieces to stdout or to a file."""
    if output == STDIO:
        for piece in pieces:
            click.echo(piece, nl=False)
    else:
        replace_text(Path(output), pieces)


def check_text(output: str | None) -> None:
    """Raise MismatchError or OSError where `write_text` could not write a file."""
    if output not in (None, STDIO):
        check_file(Path(str(output)))


def check_file(path: Path) -> None:
    """Raise MismatchError or OSError where a file could not be written."""
    if path.is_dir():
        raise MismatchError(
            f"{path}: expected a file to write, found a folder; give a name within it"
        )
    _check_writable(path.absolute().parent)


def check_folder(path: Path) -> None:
    """Raise MismatchError or OSError where a folder could not be made and filled."""
    if path.exists() and not path.is_dir():
        raise MismatchError(
            f"{path}: expected a folder to write, or a new name, found a file; choose another"
        )
    _check_writable(path.absolute().parent)
    if path.exists():
        _check_writable(path)


def check_place(path: Path) -> None:
    """Raise MismatchError or OSError where neither a file nor a folder could be written."""
    _check_writable(path.absolute().parent)


def _check_writable(folder: Path) -> None:
    """Raise MismatchError where nothing can be written in the nearest folder that exists.

    It is tried, which is the only way to know.
    """
    while not folder.exists():
        folder = folder.parent
    if not folder.is_dir():
        raise MismatchError(f"{folder}: expected a folder, found a file; choose another path")
    try:
        with tempfile.TemporaryDirectory(dir=folder, prefix=".mocap-calib."):
            pass
    except OSError as error:
        raise MismatchError(
            f"{folder}: expected a folder that can be written to, found: {error.strerror}; "
            "choose another"
        ) from None
