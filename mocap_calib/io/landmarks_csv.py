"""Landmarks in CSV: points of a scene whose places are known, and where cameras see them.

A line per observation: name, x, y, z (metres), camera, u, v (pixels; integers are their middles).
The columns may be in any order; others are passed over.
"""

import csv
import io
import math
from collections.abc import Mapping
from pathlib import Path

from mocap_calib.config import Landmark
from mocap_calib.errors import FormatError
from mocap_calib.io.file import decode, read_bytes

_NUMBERS = ("x", "y", "z", "u", "v")
_COLUMNS = ("name", "x", "y", "z", "camera", "u", "v")


def read_landmarks(path: Path) -> tuple[Landmark, ...]:
    """Read the observations of a file of landmarks.

    Raises FormatError, also where two lines place one landmark differently, or a camera sees it
    twice.
    """
    rows = csv.DictReader(io.StringIO(decode(read_bytes(path), str(path))), skipinitialspace=True)
    lacking = [name for name in _COLUMNS if name not in (rows.fieldnames or ())]
    if lacking:
        raise FormatError(
            str(path),
            f"columns {','.join(_COLUMNS)}",
            f"none called {', '.join(lacking)}",
            "write this header",
        )
    try:
        found = tuple(_parse_row(row, f"{path}: line {rows.line_num}") for row in rows)
    except csv.Error as error:
        raise FormatError(str(path), "a table of landmarks", str(error), "write it anew") from None
    if not found:
        raise FormatError(str(path), "landmarks", "a header alone", "add a line per observation")
    _check_each_once(found, str(path))
    return found


def _parse_row(row: Mapping[str, str | None], where: str) -> Landmark:
    """Return the observation of a line. Raises FormatError."""
    numbers = {}
    for column in _NUMBERS:
        text = row[column] or ""
        try:
            numbers[column] = float(text)
        except ValueError:
            numbers[column] = math.nan
        if not math.isfinite(numbers[column]):
            raise FormatError(where, f"a number {column}", repr(text), "correct it")
    name, camera = (row["name"] or "").strip(), (row["camera"] or "").strip()
    if not name or not camera:
        raise FormatError(where, "names of a landmark and of a camera", "none", "add them")
    position = (numbers["x"], numbers["y"], numbers["z"])
    return Landmark(name, position, camera, (numbers["u"], numbers["v"]))


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
