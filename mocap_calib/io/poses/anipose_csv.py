"""Anipose's pose-3d CSV: one individual a file, six columns a keypoint, then the change of axes and the frame number."""

import csv
import io

import numpy as np

from mocap_calib.io.file import decode, malformed
from mocap_calib.io.poses.common import PoseFile, WrittenPoses, lost_names
from mocap_calib.io.results.poses_csv import poses_csv
from mocap_calib.io.units import ARBITRARY
from mocap_calib.types import Floats, Poses3D

_FIELDS = ("x", "y", "z", "error", "ncams", "score")


def sniff(content: bytes) -> bool:
    """By the names of the columns."""
    head = content[:1_000_000].split(b"\n", 1)[0]
    return b"_ncams" in head and b"_x" in head and b"fnum" in head


def parse(content: bytes, source: str) -> PoseFile:
    """The points in the axes of the file; M and center say how they came from the cameras'. Raises FormatError."""
    try:
        header, *rows = [
            row for row in csv.reader(io.StringIO(decode(content, source), newline="")) if row
        ]
    except (csv.Error, ValueError) as error:
        raise malformed(source, "comma-separated values", error, "export them again") from None
    columns = {name: k for k, name in enumerate(header)}
    names = [name.removesuffix("_ncams") for name in header if name.endswith("_ncams")]
    missing = [
        f"{name}_{field}" for name in names for field in _FIELDS if f"{name}_{field}" not in columns
    ]
    if missing or not names or "fnum" not in columns or len(columns) < len(header):
        expected = f"columns {', '.join(_FIELDS)} of each keypoint, and fnum, each once"
        raise malformed(
            f"{source}: line 1",
            expected,
            f"no {', '.join(missing) or 'such names'}",
            "export them again",
        )
    table = _table(rows, len(header), source)
    frames = table[:, columns["fnum"]]
    if not (np.isfinite(frames) & (frames == np.round(frames)) & (np.abs(frames) < 2**53)).all():
        raise malformed(source, "a whole number fnum in each row", "others", "export them again")
    values = table[:, [columns[f"{name}_{field}"] for name in names for field in _FIELDS]].reshape(
        len(table), 1, len(names), 6
    )
    positions = np.where(
        np.isfinite(values[..., :3]).all(-1, keepdims=True), values[..., :3], np.nan
    )
    views = (
        np.nan_to_num(values[..., 4], nan=0.0, posinf=0.0, neginf=0.0).clip(0, 1e6).astype(np.int64)
    )
    return PoseFile(
        Poses3D(
            tuple(names),
            frames.astype(np.int64),
            positions,
            values[..., 3],
            views,
            values[..., 5],
            ARBITRARY,
        )
    )


def _table(rows: list[list[str]], width: int, source: str) -> Floats:
    """`[row, column]`, NaN where a cell is empty. Raises FormatError."""
    table = np.full((len(rows), width), np.nan)
    for k, row in enumerate(rows):
        try:
            if len(row) != width:
                raise ValueError(f"{len(row)} cells")
            table[k] = [float(cell) if cell.strip() else np.nan for cell in row]
        except ValueError as error:
            raise malformed(
                f"{source}: row {k + 2}", f"{width} numbers or empty cells", error, "mend the row"
            ) from None
    return table


def write(file: PoseFile, title: str) -> WrittenPoses:  # noqa: ARG001 - the writers' signature
    """The one individual."""
    said = () if file.poses.unit == ARBITRARY else (f"the unit ({file.poses.unit})",)
    return WrittenPoses("".join(poses_csv(file.poses, 0)).encode(), (*said, *lost_names(file)))
