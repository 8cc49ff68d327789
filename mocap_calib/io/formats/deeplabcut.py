"""Read and write DeepLabCut's tables of labelled columns, and read SuperAnimal's JSON.

Lightning Pose writes the same tables. Traps of all of them: tables are jagged (an individual may
lack body parts), so columns are found by label and not by position; the pseudo-individual `single`
holds the unique body parts of a scene (corners, levers); SuperAnimal's `animal0`, `animal1`, ...
are detections in any order; labelled frames have no likelihood; tables of 3D poses differ only by
a column `z`.

Traps of the .csv: 3 or 4 header rows; the index takes one column (a frame number or an image path)
or three (folder, video, image), the latter two without a heading; pandas and R put a column of row
numbers before it; the row `scorer` is shorter than the others in some files; Lightning Pose adds a
last column `set`.

Traps of SuperAnimal's JSON, a list of frames with a list of individuals in each: individuals come
in any order; keypoints have no names (the .h5 beside it has them); the frame number is the place
in the list.
"""

import csv
import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice

import msgspec
import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.detections import (
    SCORES,
    SIZES,
    check_size,
    frame_number,
    is_list_of,
    make_view,
    view_of_frames,
)
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.io.table import read_rows, read_table
from mocap_calib.types import Floats, Ints, Keypoints2D

LEVELS = ("scorer", "individuals", "bodyparts", "coords")
LEVELS_OF_ONE = ("scorer", "bodyparts", "coords")  # of a table of one animal
_COORDS = ("x", "y", "likelihood")
_UNIQUE = "single"  # the pseudo-individual of unique body parts
_AGAIN = "export it from DeepLabCut again"
_SCORER = "mocap-calib"
# perhaps behind the empty heading of a column of row numbers
_FIRST_CELL = re.compile(
    rb'(\xef\xbb\xbf)?((""|index)?[,;\t])?"?(scorer|individuals|bodyparts|coords)"?[,;\t]'
)
# what ensemble Kalman smoothers write beside the coordinates
_SPREAD = re.compile(r"[xy]_(ens_median|ens_var|posterior_var|var)|zscore|nll|ensemble_std")

Labels = tuple[str, ...]  # of a column, one per level


@dataclass(frozen=True)
class LabelledTable:
    """What the files hold.

    levels: names of the header rows.
    columns: each column's labels, one per level.
    rows: frame numbers or image paths, as text.
    values: `[row, column]`, NaN where a cell is empty.
    row_name: what messages call a row (an index).
    """

    levels: Labels
    columns: Sequence[Labels]
    rows: Sequence[str]
    values: Floats
    row_name: Callable[[int], str]


def view_of_table(table: LabelledTable, document: Document) -> Keypoints2D:
    """Return the detections of a table: one instance per individual, in the order of the columns.

    The pseudo-individual `single` is left out when it shares no body part with the others.
    Raises FormatError.
    """
    origin = document.origin
    columns, unknown = _columns_by_label(table, origin.source)
    document.account.add_names(unknown, "columns")
    names = list(dict.fromkeys(name for name, _ in columns))
    others = {part for name, part in columns if name != _UNIQUE}
    unique = {part for name, part in columns if name == _UNIQUE}
    remarks: tuple[str, ...] = ()
    if unique and others and not unique & others:
        names.remove(_UNIQUE)
        left_out = ", ".join(sorted(unique))
        remarks = (f"unique body parts belong to no individual and are left out: {left_out}",)
    parts = list(dict.fromkeys(part for name, part in columns if name in names))
    check_size(len(table.rows), len(names), len(parts), origin.source)
    places = np.array(
        [
            [columns.get((name, part), {}).get(coord, -1) for coord in _COORDS]
            for name in names
            for part in parts
        ]
    ).ravel()
    values = table.values
    if not np.array_equal(places, np.arange(values.shape[1])):
        values = values[:, places]
        values[:, places < 0] = np.nan
    # SuperAnimal's, whom no one follows
    in_any_order = len(names) > 1 and all(re.fullmatch(r"animal[0-9]+", name) for name in names)
    return make_view(
        origin,
        parts,
        _frame_numbers(table.rows, origin.source),
        values.reshape(len(values), len(names), len(parts), len(_COORDS)),
        tracked=not in_any_order,
        row_name=table.row_name,
        remarks=remarks,
    )


def _columns_by_label(
    table: LabelledTable, source: str
) -> tuple[dict[tuple[str, str], dict[str, int]], list[str]]:
    """Return (individual, body part) -> coordinate -> column, and coordinates that are not known.

    Raises FormatError.
    """
    levels = set(table.levels)
    if not {"bodyparts", "coords"} <= levels or not levels <= set(LEVELS):
        found = ", ".join(table.levels) or "none"
        raise FormatError(source, f"header rows among {', '.join(LEVELS)}", found, _AGAIN)
    columns: dict[tuple[str, str], dict[str, int]] = {}
    others: list[str] = []
    for column, labels in enumerate(table.columns):
        label = dict(zip(table.levels, labels, strict=True))
        if label["coords"] not in (*_COORDS, "z"):
            others += [] if _SPREAD.fullmatch(label["coords"]) else [label["coords"]]
            continue
        column_of = columns.setdefault((label.get("individuals", ""), label["bodyparts"]), {})
        if label["coords"] in column_of:
            found = f"{' '.join(labels)} twice"
            raise FormatError(source, "each column once", found, "keep the columns of one scorer")
        column_of[label["coords"]] = column
    coords = {coord for column_of in columns.values() for coord in column_of}
    if "z" in coords:
        expected, remedy = "2D keypoints (x, y, likelihood)", "give the 2D file of each camera"
        raise FormatError(source, expected, "3D ones (x, y, z)", remedy)
    all_have_positions = all({"x", "y"} <= column_of.keys() for column_of in columns.values())
    if not columns or not all_have_positions:
        expected = "columns x, y and perhaps likelihood for each body part"
        found = ", ".join(sorted({*coords, *others})) or "none"
        raise FormatError(source, expected, found, _AGAIN)
    return columns, others


def _frame_numbers(rows: Sequence[str], source: str) -> Ints:
    """Return the `[row]` frame numbers. Raises FormatError."""
    if not rows:
        raise FormatError(source, "at least one row of data", "none", _AGAIN)
    folders = list(dict.fromkeys(row.replace("\\", "/").rpartition("/")[0] for row in rows))
    if len(folders) > 1:
        found = f"those of {folders[0]} and {folders[1]}"
        expected = "images of one folder, which is a video"
        raise FormatError(source, expected, found, "give one file per camera")
    numbers = [frame_number(row) for row in rows]
    if -1 in numbers:
        expected = "each row to begin with a frame number or a numbered image"
        raise FormatError(source, expected, rows[numbers.index(-1)], "correct the first column")
    return np.array(numbers, dtype=np.int64)


def table_of_view(view: Keypoints2D) -> LabelledTable:
    """Return the labelled columns of a camera."""
    frames, instances, _ = view.confidence.shape
    points = np.concatenate([view.positions, view.confidence[..., None]], axis=-1)
    values = np.where(np.isfinite(points[..., :1]), points, np.nan).reshape(frames, -1)
    individuals = [(f"individual{k + 1}",) for k in range(instances)] if instances > 1 else [()]
    columns = [
        (_SCORER, *individual, keypoint, coord)
        for individual in individuals
        for keypoint in view.keypoints
        for coord in _COORDS
    ]
    levels = LEVELS if instances > 1 else LEVELS_OF_ONE
    rows = list(map(str, view.frames))
    return LabelledTable(levels, columns, rows, values, rows.__getitem__)


# --- csv


def sniff_csv(document: Document) -> bool:
    """Return whether the first cell, or the one behind row numbers, names a header row."""
    return _FIRST_CELL.match(document.start[:64]) is not None


def read_csv(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read the camera of a DeepLabCut or Lightning Pose .csv. Raises FormatError."""
    header: dict[str, list[str]] = {}
    place = int(document.header[:1] not in [(level,) for level in LEVELS])  # of levels and frames
    for _, cells in islice(read_rows(document), len(LEVELS)):
        if len(cells) <= place or cells[place] not in LEVELS:
            break
        header[cells[place]] = cells
    coords = header.get("coords", [])
    headed = [column for column, cell in enumerate(coords) if column > place and cell]
    if not headed:
        found = document.head.splitlines()[0][:60]
        raise document.refuse("a header row `coords`", found, _AGAIN)
    first, end = headed[0], headed[-1] + 1
    levels = tuple(level for level in LEVELS if level in header)
    labels = [(header[level] + [""] * end)[first:end] for level in levels]
    # no one needs the scorers
    if any("" in row for level, row in zip(levels, labels, strict=True) if level != "scorer"):
        raise document.refuse("header rows of one length", "an empty cell among them", _AGAIN)
    index = range(place, first)
    table = read_table(document, texts=index, numbers=range(first, end), header_rows=len(header))
    labelled = LabelledTable(
        levels=levels,
        columns=list(zip(*labels, strict=True)),
        rows=list(map("/".join, zip(*map(table.text, index), strict=True))),
        values=table.numbers,
        row_name=lambda row: f"row {table.lines[row]} ({table.text(first - 1)[row]})",
    )
    return (view_of_table(labelled, document),)


def write_csv(views: tuple[Keypoints2D, ...]) -> dict[str, bytes]:
    """Write `<camera>.csv` with frame numbers and empty cells for missing points."""
    return {f"{view.camera}.csv": _format_csv(table_of_view(view)) for view in views}


def _format_csv(table: LabelledTable) -> bytes:
    cells = np.where(np.isnan(table.values), "", table.values.astype(str)).tolist()
    content = io.StringIO(newline="")
    writer = csv.writer(content, lineterminator="\n")
    labels = zip(*table.columns, strict=True)
    writer.writerows([level, *row] for level, row in zip(table.levels, labels, strict=True))
    writer.writerows([frame, *row] for frame, row in zip(table.rows, cells, strict=True))
    return content.getvalue().encode()


CSV = Format(
    name="deeplabcut-csv",
    title="DeepLabCut and Lightning Pose .csv",
    sniff=sniff_csv,
    read=read_csv,
    passed_over=("set",),
    write=write_csv,
    endings=(".csv",),
    followed=True,
    loses=(SIZES, SCORES),
)


# --- SuperAnimal


class _Frame(msgspec.Struct):
    """The x, y and likelihood of the body parts of each individual."""

    bodyparts: list[list[tuple[float | None, float | None, float | None]]]


def sniff_superanimal(document: Document) -> bool:
    """Return whether this is a list of objects with `bodyparts`."""
    return is_list_of(document.json, "bodyparts")


def read_superanimal(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read one camera. Raises FormatError."""
    detections = [frame.bodyparts for frame in document.records(list[_Frame])]
    return (view_of_frames(document, options, range(len(detections)), detections),)


SUPERANIMAL = Format(
    name="superanimal",
    title="DeepLabCut SuperAnimal .json",
    sniff=sniff_superanimal,
    read=read_superanimal,
    passed_over=("bboxes", "bbox_scores"),
)
