"""The plain table that anything can write: a row per point, `camera,frame,individual,keypoint,x,y,score` (docs/formats.md).

`individual` names the same body in all frames; a table of detections that nobody follows calls the column `instance`.
"""

import csv
import io
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mocap_calib.io.document import Document, Item, ReadOptions
from mocap_calib.io.reading import NO_SCORE, Origin, blank, frame_number, make_view, malformed
from mocap_calib.types import Ints, Keypoints2D

_NEEDED = {"frame", "keypoint", "x", "y"}
_KNOWN = (*("camera", "frame", "individual", "instance"), *("keypoint", "x", "y", "score"))


class _Row(NamedTuple):
    camera: str
    frame: str
    who: str
    keypoint: str
    x: float
    y: float
    score: float


def sniff(document: Document) -> bool:
    """A header with the columns that are needed."""
    return set(document.header) >= _NEEDED


def read(item: Item, options: ReadOptions) -> tuple[Keypoints2D, ...]:  # noqa: ARG001 - a reader's signature
    """The detections of each camera in the table; of the file's camera where there is no column `camera`. Raises FormatError."""
    header = item.document.header
    rows = list(_rows(item.document.text, header, item))
    if not rows:
        raise malformed(item.origin.source, "rows below the header", "none", "export it again")
    cameras: dict[str, list[_Row]] = {}
    for row in rows:
        cameras.setdefault(row.camera, []).append(row)
    remarks = () if "score" in header else (NO_SCORE,)
    return tuple(_view(Origin(camera, item.origin.source), own, "instance" not in header, remarks) for camera, own in cameras.items())


def _rows(text: str, header: tuple[str, ...], item: Item) -> Iterator[_Row]:
    source = item.origin.source
    unknown = [name for name in header if name not in _KNOWN]
    if unknown or len(set(header)) < len(header) or {"individual", "instance"} <= set(header):
        raise malformed(source, f"the columns {','.join(_KNOWN)} (individual or instance), each once", ",".join(header), "rename or remove columns")
    reader = csv.reader(io.StringIO(text, newline=""))
    started = False
    try:
        for cells in reader:
            if any(cells) and started:
                yield _row(dict(zip(header, cells, strict=False)) if len(cells) == len(header) else {}, item, f"{source}: row {reader.line_num}", len(cells))
            started = started or any(cells)
    except csv.Error as error:
        raise malformed(source, "comma-separated values", error, "export it again") from None


def _row(cells: dict[str, str], item: Item, source: str, found: int) -> _Row:
    if not cells:
        raise malformed(source, "as many cells as the header has", found, "the file is cut, or has commas in its numbers")
    x, y, score = (_number(cells.get(name, "1"), source) for name in ("x", "y", "score"))
    who = cells.get("individual", cells.get("instance", "0")).strip()
    return _Row(cells.get("camera", item.camera).strip(), cells["frame"], who, cells["keypoint"].strip(), x, y, score)


def _number(cell: str, source: str) -> float:
    try:
        return float(cell) if cell.strip() else np.nan
    except ValueError:
        raise malformed(source, "a number with a decimal point", cell, "write numbers like 12.5") from None


def _view(origin: Origin, rows: list[_Row], tracked: bool, remarks: tuple[str, ...]) -> Keypoints2D:
    source = origin.source
    frames = {text: frame_number(text) for text in dict.fromkeys(row.frame for row in rows)}
    bad = [text for text, number in frames.items() if number < 0]
    if bad or not origin.camera:
        raise malformed(source, "a camera and a frame number in each row", repr(bad[0] if bad else ""), "mend the columns camera and frame")
    numbers = sorted(set(frames.values()))
    keypoints = tuple(dict.fromkeys(row.keypoint for row in rows if row.keypoint))
    individuals = _individuals([row.who for row in rows], tracked, source)
    values = blank(len(numbers), max(individuals.values()) + 1, len(keypoints), source)
    place = {number: k for k, number in enumerate(numbers)}
    column = {name: k for k, name in enumerate(keypoints)}
    at = np.array([(place[frames[r.frame]], individuals[r.who], column[r.keypoint]) for r in rows if r.keypoint], dtype=np.int64).reshape(-1, 3)
    _check_once(at, numbers, keypoints, source)
    values[tuple(at.T)] = [(r.x, r.y, r.score) for r in rows if r.keypoint]
    return make_view(origin, keypoints, numbers, values, tracked=tracked, remarks=remarks)


def _individuals(names: list[str], tracked: bool, source: str) -> dict[str, int]:
    """Name -> index: that of instances is their number; individuals come by number where all have one, else as they appear."""
    unique = list(dict.fromkeys(names))
    numbers = {name: int(name) for name in unique if name.isascii() and name.isdigit() and len(name) < 10}
    if tracked:
        order = sorted(unique, key=lambda name: numbers[name]) if len(numbers) == len(unique) else unique
        return {name: k for k, name in enumerate(order)}
    if len(numbers) < len(unique):
        raise malformed(source, "whole numbers in the column instance", next(name for name in unique if name not in numbers), "call the column individual")
    return numbers


def _check_once(at: Ints, numbers: list[int], keypoints: tuple[str, ...], source: str) -> None:
    unique, counts = np.unique(at, axis=0, return_counts=True)
    if (counts > 1).any():
        frame, individual, keypoint = unique[counts > 1][0]
        found = f"frame {numbers[frame]}, individual {individual}, {keypoints[keypoint]} {counts.max()} times"
        raise malformed(source, "each point once", found, "remove the double rows, or tell individuals apart")


def write(views: tuple[Keypoints2D, ...]) -> dict[str, bytes]:
    """All cameras in one table. The first frame has all individuals and keypoints, the others what there is; an empty frame one empty row."""
    who = "individual" if all(view.tracked for view in views) else "instance"
    lines = [f"camera,frame,{who},keypoint,x,y,score"]
    for view in views:
        for k, frame in enumerate(view.frames):
            seen = np.isfinite(view.positions[k, ..., 0])
            listed = np.argwhere(seen | (k == 0))
            lines += [_line(view, k, i, j) for i, j in listed] or [f"{_cell(view.camera)},{frame},0,,,,"]
    return {"keypoints.csv": ("\n".join(lines) + "\n").encode()}


def _line(view: Keypoints2D, frame: int, individual: int, keypoint: int) -> str:
    x, y = view.positions[frame, individual, keypoint]
    point = f"{x!r},{y!r},{view.confidence[frame, individual, keypoint]!r}" if np.isfinite(x) else ",,"
    return f"{_cell(view.camera)},{view.frames[frame]},{individual},{_cell(view.keypoints[keypoint])},{point}"


def _cell(text: str) -> str:
    return '"' + text.replace('"', '""') + '"' if any(mark in text for mark in ',"\n\r') else text
