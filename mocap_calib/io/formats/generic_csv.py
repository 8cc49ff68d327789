"""Read and write the plain table that anything can write (docs/formats.md).

A row per point: `camera,frame,individual,keypoint,x,y,score`. `individual` names the same body in
all frames; a table of detections that nobody follows calls the column `instance`. The columns
camera, individual (or instance) and score may be absent.
"""

import re

import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.keypoints.long_table import Points, views_from_points
from mocap_calib.io.keypoints.losses import MIXED, SCORES, SIZES
from mocap_calib.io.keypoints.options import ReadOptions
from mocap_calib.io.keypoints.table_cells import Cells, read_cells
from mocap_calib.types import Keypoints2D

_NEEDED = {"frame", "keypoint", "x", "y"}
_KNOWN = ("camera", "frame", "individual", "instance", "keypoint", "x", "y", "score")


def sniff(document: Document) -> bool:
    """Return whether the header has the columns that are needed, whatever separates them.

    The wrong separator is recognised so that `read` can refuse it in words.
    """
    return set(_header_cells(document)) >= _NEEDED


def _header_cells(document: Document) -> list[str]:
    """Return the header's cells, whatever separates them."""
    return [cell.strip() for cell in re.split(r"[,;\t]", ",".join(document.header))]


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read each camera in the table; the file's camera where there is no column `camera`.

    Raises FormatError.
    """
    _check_header(document)
    cells = read_cells(document)
    constant = ("0",) * len(cells)
    points = Points(
        camera=_cameras(cells, document),
        frame=cells.columns["frame"],
        identity=cells.columns.get("individual", cells.columns.get("instance", constant)),
        keypoint=cells.columns["keypoint"],
        values=np.column_stack([cells.numbers(name) for name in ("x", "y", "score")]),
        lines=cells.lines,
    )
    return views_from_points(points, document, tracked="instance" not in cells.columns)


def _check_header(document: Document) -> None:
    """Raise FormatError for another separator, and for columns that are not known or missing."""
    header, source = document.header, document.source
    if tuple(_header_cells(document)) != header:
        raise FormatError(
            source, "commas between cells and points in numbers", header[0], "export it so"
        )
    names = set(header)
    if not _NEEDED <= names <= set(_KNOWN) or {"individual", "instance"} <= names:
        raise FormatError(
            source,
            f"the columns {','.join(_KNOWN)} "
            "(individual or instance; camera, they and score may be absent)",
            ",".join(header),
            "rename or remove columns",
        )


def _cameras(cells: Cells, document: Document) -> tuple[str, ...]:
    """Return the `[row]` camera. Raises FormatError where the column has an empty cell."""
    if "camera" not in cells.columns:
        return (document.camera,) * len(cells)
    cameras = cells.columns["camera"]
    if not all(cameras):
        raise FormatError(
            cells.place(cameras.index("")),
            "the camera's name",
            "an empty cell",
            "fill it, or remove the column",
        )
    return cameras


def write(views: tuple[Keypoints2D, ...]) -> dict[str, bytes]:
    """Write all cameras into one table.

    The first frame has all individuals and keypoints, the others what there is; a frame without
    any point has one empty row.
    """
    identity = "individual" if all(view.tracked for view in views) else "instance"
    lines = [f"camera,frame,{identity},keypoint,x,y,score"]
    for view in views:
        for frame in range(len(view.frames)):
            lines += _lines_of_frame(view, frame)
    return {"keypoints.csv": ("\n".join(lines) + "\n").encode()}


def _lines_of_frame(view: Keypoints2D, frame: int) -> list[str]:
    """Return the rows of one frame (an index)."""
    seen = np.isfinite(view.positions[frame, ..., 0])
    listed = np.argwhere(seen | (frame == 0))
    if not len(listed):
        return [f"{_quote(view.camera)},{view.frames[frame]},0,,,,"]
    return [_line(view, frame, individual, keypoint) for individual, keypoint in listed]


def _line(view: Keypoints2D, frame: int, individual: int, keypoint: int) -> str:
    """Return the row of one point (indices), with empty cells where it is missing."""
    x, y = map(float, view.positions[frame, individual, keypoint])
    score = float(view.confidence[frame, individual, keypoint])
    numbers = f"{x!r},{y!r},{score!r}" if np.isfinite(x) else ",,"
    camera, name = _quote(view.camera), _quote(view.keypoints[keypoint])
    return f"{camera},{view.frames[frame]},{individual},{name},{numbers}"


def _quote(text: str) -> str:
    """Return a cell, in quotes where its text needs them."""
    if any(mark in text for mark in ',"\n\r'):
        return '"' + text.replace('"', '""') + '"'
    return text


FORMAT = Format(
    kind="keypoints",
    name="csv",
    title="csv with a row per point (camera,frame,individual,keypoint,x,y,score)",
    sniff=sniff,
    read=read,
    write=write,
    endings=(".csv",),
    loses=(MIXED, SIZES, SCORES),
)
