"""Landmarks in CSV: points of a scene whose places are known, and where cameras see them.

A line per observation: name, x, y, z (metres), camera, u, v (pixels; integers are their middles).
The columns may be in any order; others are passed over.
"""

from pathlib import Path

import numpy as np

from mocap_calib.config import Landmark
from mocap_calib.errors import FormatError
from mocap_calib.io.document import as_document
from mocap_calib.io.table import read_table

_COLUMNS = ("name", "x", "y", "z", "camera", "u", "v")
_TEXTS, _NUMBERS = ("name", "camera"), ("x", "y", "z", "u", "v")


def read_landmarks(path: Path) -> tuple[Landmark, ...]:
    """Read the observations of a file of landmarks.

    Raises FormatError, also where two lines place one landmark differently, or a camera sees it
    twice.
    """
    document = as_document(path)
    lacking = ", ".join(name for name in _COLUMNS if name not in document.header)
    if lacking:
        expected = f"columns {','.join(_COLUMNS)}"
        raise document.refuse(expected, f"none called {lacking}", "write this header")
    table = read_table(document, texts=_TEXTS, numbers=_NUMBERS)
    names, cameras = map(table.text, _TEXTS)
    for row, numbers in enumerate(table.numbers):
        if not (names[row] and cameras[row] and np.isfinite(numbers).all()):
            remedy = "fill the cell"
            raise table.refuse(row, "names and finite numbers", "an empty cell or others", remedy)
    rows = zip(names, cameras, table.numbers.tolist(), strict=True)
    found = tuple(
        Landmark(name, (x, y, z), camera, (u, v)) for name, camera, (x, y, z, u, v) in rows
    )
    _check_each_once(found, document.source)
    return found


def _check_each_once(landmarks: tuple[Landmark, ...], source: str) -> None:
    """Raise FormatError where a landmark has two places, or two pixels in one camera."""
    places: dict[str, tuple[float, float, float]] = {}
    seen: set[tuple[str, str]] = set()
    for landmark in landmarks:
        if places.setdefault(landmark.name, landmark.position) != landmark.position:
            raise _contradiction(source, landmark.name, "two places")
        if (landmark.name, landmark.camera) in seen:
            raise _contradiction(source, landmark.name, f"two in camera {landmark.camera}")
        seen.add((landmark.name, landmark.camera))


def _contradiction(source: str, name: str, found: str) -> FormatError:
    expected = f"one place of landmark {name}, and one pixel in a camera"
    return FormatError(source, expected, found, "correct it")
