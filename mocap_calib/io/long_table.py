"""Tables with a row per point, or per detection, whatever their columns are called -> detections."""

import csv
import io
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mocap_calib.io.document import Item
from mocap_calib.io.reading import Origin, blank, frame_number, make_view, malformed, scored
from mocap_calib.types import Ints, Keypoints2D


class Row(NamedTuple):
    """A point; who: the name of an individual, or the number of an instance. An empty keypoint says only that the frame is there."""

    camera: str
    frame: str
    who: str
    keypoint: str
    x: float
    y: float
    score: float


def cells_of(item: Item) -> Iterator[tuple[str, dict[str, str]]]:
    """Place and cells by column of each row below the header. Raises FormatError."""
    source, header = item.origin.source, item.document.header
    if len(set(header)) < len(header):
        raise malformed(source, "each column once", ",".join(header), "rename or remove columns")
    reader = csv.reader(io.StringIO(item.document.text, newline=""))
    started = False
    try:
        for cells in reader:
            place = f"{source}: row {reader.line_num}"
            if started and any(cells):
                if len(cells) != len(header):
                    raise malformed(place, f"{len(header)} cells, as many as the header has", len(cells), "the file is cut, or has commas in its numbers")
                yield place, dict(zip(header, (cell.strip() for cell in cells), strict=True))
            started = started or any(cell.strip() for cell in cells)
    except csv.Error as error:
        raise malformed(source, "comma-separated values", error, "export it again") from None


def number(cell: str, place: str) -> float:
    """A number; NaN for an empty cell. Raises FormatError."""
    try:
        return float(cell) if cell else np.nan
    except ValueError:
        raise malformed(place, "a number with a decimal point", cell, "write numbers like 12.5") from None


def views_of(rows: list[Row], item: Item, tracked: bool, remarks: tuple[str, ...] = ()) -> tuple[Keypoints2D, ...]:
    """The cameras in the table, in the order in which they appear. Raises FormatError."""
    if not rows:
        raise malformed(item.origin.source, "rows below the header", "none", "export it again")
    cameras: dict[str, list[Row]] = {}
    for row in rows:
        cameras.setdefault(row.camera, []).append(row)
    return tuple(_view(Origin(camera, item.origin.source), own, tracked, remarks) for camera, own in cameras.items())


def _view(origin: Origin, rows: list[Row], tracked: bool, remarks: tuple[str, ...]) -> Keypoints2D:
    source = origin.source
    frames = {text: frame_number(text) for text in dict.fromkeys(row.frame for row in rows)}
    bad = next((text for text, found in frames.items() if found < 0), None)
    if bad is not None:
        raise malformed(source, "a frame number in each row", repr(bad), "mend the column of frames")
    numbers = sorted(set(frames.values()))
    keypoints = tuple(dict.fromkeys(row.keypoint for row in rows if row.keypoint))
    individuals = _individuals([row.who for row in rows], tracked, source)
    values = blank(len(numbers), max(individuals.values()) + 1, len(keypoints), source)
    place = {found: k for k, found in enumerate(numbers)}
    column = {name: k for k, name in enumerate(keypoints)}
    points = [row for row in rows if row.keypoint]
    at = np.array([(place[frames[r.frame]], individuals[r.who], column[r.keypoint]) for r in points], dtype=np.int64).reshape(-1, 3)
    _check_once(at, numbers, keypoints, source)
    if points:
        values[tuple(at.T)] = [(r.x, r.y, r.score) for r in points]
    values, more = scored(values)
    return make_view(origin, keypoints, numbers, values, tracked=tracked, remarks=remarks + more)


def _individuals(names: list[str], tracked: bool, source: str) -> dict[str, int]:
    """Name -> index: that of instances is their number; individuals come by number where all have one, else as they appear."""
    unique = list(dict.fromkeys(names))
    numbers = {name: int(name) for name in unique if name.isascii() and name.isdigit() and len(name) < 10}
    if tracked:
        order = sorted(unique, key=lambda name: numbers[name]) if len(numbers) == len(unique) else unique
        return {name: k for k, name in enumerate(order)}
    if len(numbers) < len(unique):
        stranger = next(name for name in unique if name not in numbers)
        raise malformed(source, "whole numbers in the column instance", repr(stranger), "call the column individual, if it names them")
    return numbers


def _check_once(at: Ints, numbers: list[int], keypoints: tuple[str, ...], source: str) -> None:
    unique, counts = np.unique(at, axis=0, return_counts=True)
    if (counts > 1).any():
        frame, individual, keypoint = unique[counts > 1][0]
        found = f"frame {numbers[frame]}, individual {individual}, {keypoints[keypoint]} {counts.max()} times"
        raise malformed(source, "each point once", found, "remove the double rows, or tell individuals apart")
