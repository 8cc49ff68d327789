"""YAML as cv2.FileStorage writes and reads it, of OpenCV 4 and 5."""

import re
from collections.abc import Iterable

import numpy as np

from mocap_calib.types import Floats

_KEY = r"[A-Za-z_][\w-]*"  # what FileStorage takes for a key


def format_file(lines: Iterable[str]) -> bytes:
    """Return a file of these lines below the header of FileStorage."""
    return "\n".join(["%YAML:1.0", "---", *lines, ""]).encode()


def format_matrix(key: str, matrix: Floats) -> list[str]:
    """Return the lines of a `[row, column]` matrix; every float comes back exactly."""
    assert re.fullmatch(_KEY, key)
    rows, columns = matrix.shape
    data = ", ".join(_format_number(float(value)) for value in np.ravel(matrix))
    return [
        f"{key}: !!opencv-matrix",
        f"   rows: {rows}",
        f"   cols: {columns}",
        "   dt: d",
        f"   data: [ {data} ]",
    ]


def _format_number(value: float) -> str:
    """Return a number with a point, without which YAML 1.1 takes `1e-05` for text."""
    text = repr(value + 0.0)  # which takes the sign from a zero
    if "." in text:
        return text
    return text.replace("e", ".0e") if "e" in text else f"{text}."
