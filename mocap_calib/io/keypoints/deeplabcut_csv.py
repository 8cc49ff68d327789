"""Read DeepLabCut's .csv: 3 or 4 header rows, then a row per frame.

Traps: the index takes one column (a frame number or an image path) or three (folder, video,
image), the latter two without a heading; the row `scorer` is shorter than the others in some
files; Lightning Pose adds a last column `set`; spreadsheets write semicolons and decimal commas.
"""

import csv
import io
import re

import numpy as np

from mocap_calib.io.file import malformed
from mocap_calib.io.keypoints.deeplabcut import LEVELS, Table, keypoints_from_table
from mocap_calib.io.keypoints.document import Document, Item, ReadOptions
from mocap_calib.types import Floats, Keypoints2D

_FIRST_CELL = re.compile(rb'(\xef\xbb\xbf)?"?(scorer|individuals|bodyparts|coords)"?[,;\t]')

Header = dict[str, list[str]]  # name of the level -> cells of its row
Rows = list[tuple[int, list[str]]]  # number in the file, cells


def sniff(document: Document) -> bool:
    """Return whether the first cell names a header row.

    The wrong separator is recognised so that `read` can refuse it in words.
    """
    return _FIRST_CELL.match(document.content[:64]) is not None


def read(item: Item, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read the camera of a DeepLabCut or Lightning Pose .csv. Raises FormatError."""
    table = _read_table(item.document.text, item.origin.source)
    return (keypoints_from_table(table, item.origin),)


def _read_table(text: str, source: str) -> Table:
    """Return the table in the text. Raises FormatError."""
    header, rows = _split(text, source)
    coords = header.get("coords", [])
    if not any(coords[1:]):
        raise malformed(
            source,
            "commas between cells and a header row `coords`",
            text.splitlines()[0][:60],
            "export it with commas",
        )
    headed = [column for column, cell in enumerate(coords) if column and cell]
    first, end = headed[0], headed[-1] + 1
    levels, columns = _labels(header, first, end, source)
    if header.get("scorer", [])[end:] == ["set"]:
        # Lightning Pose's last column: what the frame was used for
        rows = [(number, row[:end]) for number, row in rows]
    numbers = [_numbers(row, first, end, f"{source}: row {number}") for number, row in rows]
    return Table(
        levels=levels,
        columns=columns,
        rows=["/".join(row[:first]) for _, row in rows],
        values=np.array(numbers).reshape(len(rows), end - first),
        lines=[f"row {number} ({row[first - 1]})" for number, row in rows],
    )


def _split(text: str, source: str) -> tuple[Header, Rows]:
    """Return the header rows, and the rows below that are not empty. Raises FormatError."""
    header: Header = {}
    rows: Rows = []
    reader = csv.reader(io.StringIO(text, newline=""))
    try:
        for number, row in enumerate(reader, start=1):
            if row and row[0] in LEVELS and not rows:
                header[row[0]] = row
            elif any(row):
                rows.append((number, row))
    except csv.Error as error:
        raise malformed(
            source, "comma-separated values", error, "export it from DeepLabCut again"
        ) from None
    return header, rows


def _labels(
    header: Header, first: int, end: int, source: str
) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """Return the names of the levels and the labels of the columns from `first` to before `end`.

    The row `scorer` may have empty cells, since nobody needs it. Raises FormatError.
    """
    levels = tuple(level for level in LEVELS if level in header)
    rows = [(header[level] + [""] * end)[first:end] for level in levels]
    for level, row in zip(levels, rows, strict=True):
        if level != "scorer" and "" in row:
            raise malformed(
                source,
                "header rows of one length",
                "an empty cell among them",
                "export it from DeepLabCut again",
            )
    return levels, tuple(zip(*rows, strict=True))


def _numbers(row: list[str], first: int, end: int, source: str) -> Floats:
    """Return the `[column]` numbers of a row, NaN where a cell is empty. Raises FormatError.

    A row may be short only if all its cells are empty: else the file is cut.
    """
    if first < len(row) < end and not any(row[first:]):
        return np.full(end - first, np.nan)
    if len(row) < end:
        raise malformed(
            source, f"{end} cells", len(row), "the file is cut or damaged: export it again"
        )
    if any(row[end:]):
        raise malformed(
            source,
            f"{end} cells, as many as the header has",
            len(row),
            "it has commas in its numbers, perhaps: write numbers like 12.5",
        )
    try:
        return np.array([float(cell) if cell else np.nan for cell in row[first:end]])
    except ValueError as error:
        raise malformed(
            source, "numbers with a decimal point", error, "write numbers like 12.5"
        ) from None
