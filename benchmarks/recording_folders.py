"""Where the recordings are: benchmarks/README.md tells how to come by them, and their layout."""

import argparse
import os
from pathlib import Path

_VARIABLE = "MOCAP_CALIB_RECORDINGS"


def add_recordings(parser: argparse.ArgumentParser, *, needed: bool = True) -> None:
    """Add `--recordings`, the folder of all recordings; an environment variable may name it.

    needed: whether nothing goes without them.
    """
    parser.add_argument(
        "--recordings",
        type=_folder,
        metavar="FOLDER",
        default=os.environ.get(_VARIABLE),
        required=needed and _VARIABLE not in os.environ,
        help=f"folder with a folder for each recording (README.md); or ${_VARIABLE} says it",
    )


def _folder(text: str) -> Path:
    """Return the folder of that name. Raises argparse's complaint."""
    path = Path(text)
    if not path.is_dir():
        raise argparse.ArgumentTypeError(
            f"expected a folder of recordings, found none at {text}; see benchmarks/README.md"
        )
    return path
