"""Tables with a row per point, or per detection, whatever their columns are called -> detections. Column by column: rows are many."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_calib.io.file import (
    Origin,
    blank,
    check_cameras,
    fill_missing_scores,
    frame_number,
    make_view,
    malformed,
    unique_names,
)
from mocap_calib.io.keypoints.document import Item
from mocap_calib.types import Floats, Ints, Keypoints2D


@dataclass(frozen=True)
class Cells:
    """The rows below the header. columns: name -> `[row]` text without spaces around it; lines: `[row]` numbers in the file."""

    source: str
    columns: dict[str, tuple[str, ...]]
    lines: Ints

    def __len__(self) -> int:
        return len(self.lines)

    def place(self, row: int) -> str:
        """The row, as complaints name it."""
        return f"{self.source}: row {self.lines[row]}"

    def numbers(self, name: str) -> Floats:
        """`[row]` numbers of a column, NaN where it is empty or not there. Raises FormatError."""
        column = self.columns.get(name, ("",) * len(self))
        try:
            return np.array([float(cell) if cell else np.nan for cell in column], dtype=np.float64)
        except ValueError:
            row = next(k for k, cell in enumerate(column) if cell and not _is_number(cell))
            raise malformed(
                self.place(row),
                "a number with a decimal point",
                column[row],
                "write numbers like 12.5",
            ) from None


@dataclass(frozen=True)
class Points:
    """`[point]` what each point belongs to, and `[point, 3]` x, y, score.

    who: the name of an individual, or the number of an instance. An empty keypoint says only that the frame is there.
    lines: where in the file each is.
    """

    camera: Sequence[str]
    frame: Sequence[str]
    who: Sequence[str]
    keypoint: Sequence[str]
    values: Floats
    lines: Ints


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def cells_of(item: Item) -> Cells:
    """All cells of a table. Raises FormatError, also where there is no row."""
    source, header = item.origin.source, item.document.header
    if len(set(header)) < len(header):
        raise malformed(source, "each column once", ",".join(header), "rename or remove columns")
    reader = csv.reader(io.StringIO(item.document.text, newline=""))
    rows, lines = [], []
    try:
        for cells in reader:
            if any(cells):
                rows.append(cells)
                lines.append(reader.line_num)
    except csv.Error as error:
        raise malformed(source, "comma-separated values", error, "export it again") from None
    rows, lines = rows[1:], lines[1:]
    if not rows:
        raise malformed(source, "rows below the header", "none", "export it again")
    odd = next((k for k, cells in enumerate(rows) if len(cells) != len(header)), None)
    if odd is not None:
        expected = f"{len(header)} cells, as many as the header has"
        raise malformed(
            f"{source}: row {lines[odd]}",
            expected,
            len(rows[odd]),
            "the file is cut, or has commas in its numbers",
        )
    columns = {
        name: tuple(map(str.strip, column))
        for name, column in zip(header, zip(*rows, strict=True), strict=True)
    }
    return Cells(source, columns, np.array(lines))


def views_of(
    points: Points, item: Item, tracked: bool, remarks: tuple[str, ...] = ()
) -> tuple[Keypoints2D, ...]:
    """The cameras in the table, in the order in which they appear. Raises FormatError."""
    source = item.origin.source
    cameras, camera = _coded(points.camera)
    check_cameras(cameras, source)
    columns = [_coded(column) for column in (points.frame, points.who, points.keypoint)]
    return tuple(
        _view(Origin(name, source), columns, np.flatnonzero(camera == k), points, tracked, remarks)
        for k, name in enumerate(cameras)
    )


def _coded(texts: Sequence[str]) -> tuple[list[str], Ints]:
    """The different texts as they appear, and `[row]` which of them each is."""
    unique = list(dict.fromkeys(texts))
    place = {text: k for k, text in enumerate(unique)}
    return unique, np.fromiter(map(place.__getitem__, texts), dtype=np.int64, count=len(texts))


def _view(
    origin: Origin,
    columns: list[tuple[list[str], Ints]],
    rows: Ints,
    points: Points,
    tracked: bool,
    remarks: tuple[str, ...],
) -> Keypoints2D:
    source = origin.source
    (frames, frame), (people, who), (names, keypoint) = [
        _within(texts, codes[rows]) for texts, codes in columns
    ]
    found = np.array([frame_number(text) for text in frames], dtype=np.int64)
    if (found < 0).any():
        raise malformed(
            source,
            "a frame number in each row",
            repr(frames[int(np.argmin(found))]),
            "mend the column of frames",
        )
    numbers = np.unique(found)
    individuals = _individuals(people, tracked, source)
    keypoints = [name for name in names if name]
    unique_names(keypoints, source)
    place = {name: k for k, name in enumerate(keypoints)}
    column = np.array([place.get(name, -1) for name in names], dtype=np.int64)
    content = blank(len(numbers), int(individuals.max()) + 1, len(keypoints), source)
    at = (np.searchsorted(numbers, found)[frame], individuals[who], column[keypoint])
    there = at[2] >= 0
    at, rows = (at[0][there], at[1][there], at[2][there]), rows[there]
    _check_once(at, content.shape[:3], numbers, keypoints, points.lines[rows], source)
    content[at] = points.values[rows]
    content, more = fill_missing_scores(content)
    return make_view(origin, keypoints, numbers, content, tracked=tracked, remarks=remarks + more)


def _within(texts: list[str], codes: Ints) -> tuple[list[str], Ints]:
    """The texts that occur, as they appear, and the codes among them."""
    unique, first, again = np.unique(codes, return_index=True, return_inverse=True)
    order = np.argsort(first)
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    return [texts[unique[k]] for k in order], place[again]


def _individuals(names: list[str], tracked: bool, source: str) -> Ints:
    """`[name]` index: that of instances is their number; individuals come by number where all have one, else as they appear."""
    numbers = np.array(
        [
            int(name) if name.isascii() and name.isdigit() and len(name) < 10 else -1
            for name in names
        ],
        dtype=np.int64,
    )
    if tracked:
        return (
            np.unique(numbers, return_inverse=True)[1]
            if len(set(numbers.tolist()) - {-1}) == len(names)
            else np.arange(len(names))
        )
    if (numbers < 0).any():
        stranger = names[int(np.argmin(numbers))]
        raise malformed(
            source,
            "whole numbers in the column instance",
            repr(stranger),
            "call the column individual, if it names them",
        )
    return numbers


def _check_once(
    at: tuple[Ints, Ints, Ints],
    shape: tuple[int, ...],
    numbers: Ints,
    keypoints: list[str],
    lines: Ints,
    source: str,
) -> None:
    if not len(at[0]):
        return
    place = np.ravel_multi_index(at, shape)
    unique, counts = np.unique(place, return_counts=True)
    if (counts > 1).any():
        twice = place == unique[counts > 1][0]
        frame, individual, keypoint = (axis[twice][0] for axis in at)
        rows = ", ".join(map(str, lines[twice][:3]))
        found = f"frame {numbers[frame]}, individual {individual}, {keypoints[keypoint]} {twice.sum()} times, in rows {rows}"
        raise malformed(
            source, "each point once", found, "remove the double rows, or tell individuals apart"
        )
