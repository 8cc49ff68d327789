"""Anipose's pose-3d CSV: one individual a file.

* A keypoint has six columns: NAME_x, NAME_y, NAME_z, NAME_error, NAME_ncams, NAME_score.
* Behind them stand columns M_ij and center_k (how the axes of the file came from those of the
  cameras, which is not undone here) and `fnum`, the frame number.
* An empty cell is missing. There is no unit of length and no rate.
"""

import csv
import io

import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.document import Document
from mocap_calib.io.poses.common import (
    PoseFile,
    WrittenPoses,
    lost_covariance,
    lost_names,
    lost_unit,
    mark_missing,
)
from mocap_calib.io.results.poses_csv import poses_csv
from mocap_calib.io.units import ARBITRARY
from mocap_calib.results import Poses3D
from mocap_calib.types import Floats, Ints

_FIELDS = ("x", "y", "z", "error", "ncams", "score")
_FRAME = "fnum"
_LONGEST_HEADER = 1_000_000  # bytes
_MOST_VIEWS = 1e6  # what no file has
_REMEDY = "export them again"


def sniff(document: Document) -> bool:
    """Return whether the first line has the names of the columns."""
    header = document.start[:_LONGEST_HEADER].split(b"\n", 1)[0]
    return b"_ncams" in header and b"_x" in header and _FRAME.encode() in header


# --- reading


def read(document: Document) -> PoseFile:
    """Read the poses in the axes of the file. Raises FormatError."""
    header, rows = _split_rows(document)
    names = _find_keypoints(header, document.source)
    columns = {name: index for index, name in enumerate(header)}
    table = _parse_table(rows, len(header), document.source)
    frames = _parse_frames(table[:, columns[_FRAME]], document.source)
    wanted = [columns[f"{name}_{field}"] for name in names for field in _FIELDS]
    values = table[:, wanted].reshape(len(table), 1, len(names), len(_FIELDS))
    views = np.nan_to_num(values[..., 4], nan=0.0, posinf=0.0, neginf=0.0).clip(0, _MOST_VIEWS)
    poses = Poses3D(
        keypoints=tuple(names),
        frames=frames,
        positions=mark_missing(values[..., :3]),
        error=values[..., 3],
        views=views.astype(np.int64),
        confidence=values[..., 5],
        unit=ARBITRARY,
    )
    return PoseFile(poses)


def _split_rows(document: Document) -> tuple[list[str], list[list[str]]]:
    """Return the cells of the header and of each row that is not empty. Raises FormatError."""
    text = io.StringIO(document.text, newline="")
    try:
        rows = [row for row in csv.reader(text) if row]
    except (csv.Error, ValueError) as error:
        raise document.refuse("comma-separated values", error, _REMEDY) from None
    if not rows:
        raise document.refuse("comma-separated values", "no row", _REMEDY)
    return rows[0], rows[1:]


def _find_keypoints(header: list[str], source: str) -> list[str]:
    """Return the names of the keypoints, which have all their columns. Raises FormatError."""
    names = [name.removesuffix("_ncams") for name in header if name.endswith("_ncams")]
    wanted = [f"{name}_{field}" for name in names for field in _FIELDS]
    columns = set(header)
    missing = [column for column in wanted if column not in columns]
    if missing or not names or _FRAME not in columns or len(columns) < len(header):
        expected = f"columns {', '.join(_FIELDS)} of each keypoint, and fnum, each once"
        found = f"no {', '.join(missing) or 'such names'}"
        raise FormatError(f"{source}: line 1", expected, found, _REMEDY)
    return names


def _parse_table(rows: list[list[str]], width: int, source: str) -> Floats:
    """Return the numbers `[row, column]`, NaN where a cell is empty. Raises FormatError."""
    table = np.full((len(rows), width), np.nan)
    for index, row in enumerate(rows):
        try:
            if len(row) != width:
                raise ValueError(f"{len(row)} cells")
            table[index] = [float(cell) if cell.strip() else np.nan for cell in row]
        except ValueError as error:
            where = f"{source}: row {index + 2}"
            expected = f"{width} numbers or empty cells"
            raise FormatError(where, expected, error, "mend the row") from None
    return table


def _parse_frames(numbers: Floats, source: str) -> Ints:
    """Return `[frame]` numbers. Raises FormatError."""
    whole = np.isfinite(numbers) & (numbers == np.round(numbers)) & (np.abs(numbers) < 2**53)
    if not whole.all():
        raise FormatError(source, "a whole number fnum in each row", "others", _REMEDY)
    return numbers.astype(np.int64)


# --- writing


def write(file: PoseFile, title: str) -> WrittenPoses:
    """Write the one individual."""
    content = b"".join(poses_csv(file.poses, 0))
    return WrittenPoses(content, (*lost_unit(file), *lost_covariance(file), *lost_names(file)))
