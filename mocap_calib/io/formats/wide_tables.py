"""Read tables with a row per frame, whose headings are a keypoint and a coordinate.

Scripts write them (`frame,nose_x,nose_y,nose_likelihood,...`), SimBA (`Nose_x,Nose_y,Nose_p` behind
an index without a heading), and JARVIS (data2D.csv: a row of names over a row `x,y,confidence`; the
names are absent where the skeleton is not one of its own).

Traps: the names of keypoints contain what separates them from the coordinate; the score has many
names; some files have no frame numbers, and their first row is then frame 0; several animals are
keypoints of one body (`Nose_1`, `Nose_2`).
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from mocap_calib.io.detections import frame_number, make_view
from mocap_calib.io.document import Document
from mocap_calib.io.file import Origin
from mocap_calib.io.format import Format
from mocap_calib.io.read_options import ReadOptions, choose_layout
from mocap_calib.io.table import ROW_NUMBERS, Table, read_rows, read_table
from mocap_calib.types import Ints, Keypoints2D

_SCORES = "likelihood|confidence|conf|score|probability|prob|visibility|p|c|v"
_PART = re.compile(rf"(?i)(?P<x>x)|(?P<y>y)|(?P<z>z)|(?P<score>{_SCORES})")
_LABEL = re.compile(rf"(?i)(?P<name>.+)[_. :/-](?P<part>{_PART.pattern.removeprefix('(?i)')})")
_FRAME = re.compile(r"(?i)(video|image|img)?[_ ]?frames?[_ ]?(idx|index|number|num|nr|no|id)?")
NO_FRAMES = "no frame numbers in the file: its first row is frame 0"

# (camera, keypoint) -> x, y or score -> column
Columns = Mapping[tuple[str, str], Mapping[str, int]]


@dataclass(frozen=True)
class Header:
    """The header of a table.

    labels: `[column]` keypoint and coordinate, or what else heads the column. rows: of the header.
    """

    labels: Sequence[str]
    rows: int = 1


def part_of(text: str) -> str:
    """Return which of x, y, z and score a heading is, "" for another."""
    found = _PART.fullmatch(text.strip())
    return str(found.lastgroup) if found else ""


def _header(document: Document, layout: Sequence[str] = ()) -> Header:
    """Return the header of one row, or of JARVIS' two; without names those of the layout."""
    first = list(document.header)
    if all(map(part_of, first)):
        count = sum(part_of(cell) == "x" for cell in first)
        names = choose_layout(count, layout, document.source)
        order = np.cumsum([part_of(cell) == "x" for cell in first]) - 1
        return Header([f"{names[max(k, 0)]}_{cell}" for k, cell in zip(order, first, strict=True)])
    (_, second), *_ = [*islice(read_rows(document), 1, 2), (0, [""])]
    if len(second) == len(first) and all(map(part_of, second)):
        return Header([f"{name}_{part}" for name, part in zip(first, second, strict=True)], 2)
    return Header(first)


def _columns(labels: Sequence[str], camera: str) -> Columns:
    """Return the columns of keypoints."""
    columns: dict[tuple[str, str], dict[str, int]] = {}
    for place, label in enumerate(labels):
        found = _LABEL.fullmatch(label)
        if found:
            columns.setdefault((camera, found["name"]), {})[part_of(found["part"])] = place
    return {key: parts for key, parts in columns.items() if {"x", "y"} <= parts.keys()}


def sniff(document: Document) -> bool:
    """Return whether two keypoints have columns x and y, none has z, and there are no tracks."""
    header = document.header
    if any(label.endswith("track") for label in header):  # of SLEAP
        return False
    if len(header) > 2 and all(map(part_of, header)):
        return "z" not in map(part_of, header)
    columns = _columns(_header(document).labels, "") if len(header) > 3 else {}
    return len(columns) > 1 and not any("z" in parts for parts in columns.values())


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read the camera. Raises FormatError."""
    header = _header(document, options.layout)
    return views_of_columns(document, header, _columns(header.labels, document.camera))


def views_of_columns(
    document: Document, header: Header, columns: Columns
) -> tuple[Keypoints2D, ...]:
    """Return the cameras of a table with a row per frame, of one individual. Raises FormatError."""
    used = {place for parts in columns.values() for place in parts.values()}
    others = [place for place in range(len(header.labels)) if place not in used]
    named = [place for place in others if _FRAME.fullmatch(header.labels[place].strip())]
    unnamed = [
        place for place in others if ROW_NUMBERS.fullmatch(header.labels[place].strip().casefold())
    ]
    frames_at = (named or unnamed)[:1]
    order = [parts.get(part, -1) for parts in columns.values() for part in ("x", "y", "score")]
    table = read_table(document, texts=frames_at, numbers=order, header_rows=header.rows)
    values = table.numbers.reshape(len(table.lines), 1, -1, 3)
    remarks = () if frames_at else (NO_FRAMES,)
    cameras, names = (np.array(each, dtype=object) for each in zip(*columns, strict=True))
    return tuple(
        make_view(
            Origin(camera, document.source),
            names[cameras == camera].tolist(),
            _frames(table, frames_at),
            values[:, :, cameras == camera],
            tracked=True,
            row_name=lambda row: f"row {table.lines[row]}",
            remarks=remarks,
        )
        for camera in dict.fromkeys(cameras.tolist())
    )


def _frames(table: Table, frames_at: Sequence[int]) -> Ints:
    """Return the `[row]` frame numbers. Raises FormatError."""
    if not frames_at:
        return np.arange(len(table.lines))
    cells = table.text(frames_at[0])
    numbers = [frame_number(cell) for cell in cells]
    if -1 in numbers:
        row = numbers.index(-1)
        raise table.refuse(row, "a frame number", repr(cells[row]), "correct the column")
    return np.array(numbers, dtype=np.int64)


FORMAT = Format(
    name="csv-wide",
    title="csv with a row per frame (frame,nose_x,nose_y,nose_likelihood)",
    sniff=sniff,
    read=read,
)
