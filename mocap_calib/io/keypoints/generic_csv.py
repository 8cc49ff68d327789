"""The plain table that anything can write: a row per point, `camera,frame,individual,keypoint,x,y,score` (docs/formats.md).

`individual` names the same body in all frames; a table of detections that nobody follows calls the column `instance`.
"""

import re

import numpy as np

from mocap_calib.io.file import malformed
from mocap_calib.io.keypoints.document import Document, Item, ReadOptions
from mocap_calib.io.keypoints.long_table import Points, cells_of, views_of
from mocap_calib.types import Keypoints2D

_NEEDED = {"frame", "keypoint", "x", "y"}
_KNOWN = (*("camera", "frame", "individual", "instance"), *("keypoint", "x", "y", "score"))


def sniff(document: Document) -> bool:
    """A header with the columns that are needed; the wrong separator is recognised too, to be refused in words."""
    return set(_cells(document)) >= _NEEDED


def _cells(document: Document) -> list[str]:
    """The header's cells, whatever separates them."""
    return [cell.strip() for cell in re.split(r"[,;\t]", ",".join(document.header))]


def read(item: Item, options: ReadOptions) -> tuple[Keypoints2D, ...]:  # noqa: ARG001 - a reader's signature
    """The detections of each camera in the table; of the file's camera where there is no column `camera`. Raises FormatError."""
    header, source = item.document.header, item.origin.source
    if tuple(_cells(item.document)) != header:
        raise malformed(
            source, "commas between cells and points in numbers", header[0], "export it so"
        )
    if not _NEEDED <= set(header) <= set(_KNOWN) or {"individual", "instance"} <= set(header):
        expected = f"the columns {','.join(_KNOWN)} (individual or instance; camera, they and score may be absent)"
        raise malformed(source, expected, ",".join(header), "rename or remove columns")
    cells = cells_of(item)
    cameras = cells.columns.get("camera", (item.camera,) * len(cells))
    if "camera" in header and not all(cameras):
        raise malformed(
            cells.place(cameras.index("")),
            "the camera's name",
            "an empty cell",
            "fill it, or remove the column",
        )
    who = cells.columns.get("individual", cells.columns.get("instance", ("0",) * len(cells)))
    values = np.column_stack([cells.numbers(name) for name in ("x", "y", "score")])
    points = Points(
        cameras, cells.columns["frame"], who, cells.columns["keypoint"], values, cells.lines
    )
    return views_of(points, item, tracked="instance" not in header)


def write(views: tuple[Keypoints2D, ...]) -> dict[str, bytes]:
    """All cameras in one table. The first frame has all individuals and keypoints, the others what there is; an empty frame one empty row."""
    who = "individual" if all(view.tracked for view in views) else "instance"
    lines = [f"camera,frame,{who},keypoint,x,y,score"]
    for view in views:
        for k, frame in enumerate(view.frames):
            seen = np.isfinite(view.positions[k, ..., 0])
            listed = np.argwhere(seen | (k == 0))
            lines += [_line(view, k, i, j) for i, j in listed] or [
                f"{_cell(view.camera)},{frame},0,,,,"
            ]
    return {"keypoints.csv": ("\n".join(lines) + "\n").encode()}


def _line(view: Keypoints2D, frame: int, individual: int, keypoint: int) -> str:
    x, y = map(float, view.positions[frame, individual, keypoint])
    point = (
        f"{x!r},{y!r},{float(view.confidence[frame, individual, keypoint])!r}"
        if np.isfinite(x)
        else ",,"
    )
    return f"{_cell(view.camera)},{view.frames[frame]},{individual},{_cell(view.keypoints[keypoint])},{point}"


def _cell(text: str) -> str:
    return '"' + text.replace('"', '""') + '"' if any(mark in text for mark in ',"\n\r') else text
