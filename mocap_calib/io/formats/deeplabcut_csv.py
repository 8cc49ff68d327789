"""Read DeepLabCut's .csv: 3 or 4 header rows, then a row per frame.

Traps: the index takes one column (a frame number or an image path) or three (folder, video,
image), the latter two without a heading; the row `scorer` is shorter than the others in some
files; Lightning Pose adds a last column `set`; spreadsheets write semicolons and decimal commas.
"""

import csv
import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.formats import deeplabcut_writer
from mocap_calib.io.formats.deeplabcut import LEVELS, Table, keypoints_from_table
from mocap_calib.io.keypoints.losses import SCORES, SIZES
from mocap_calib.io.keypoints.options import ReadOptions
from mocap_calib.types import Floats, Keypoints2D

_FIRST_CELL = re.compile(rb'(\xef\xbb\xbf)?"?(scorer|individuals|bodyparts|coords)"?[,;\t]')

Header = dict[str, list[str]]  # name of the level -> cells of its row


@dataclass(frozen=True)
class _Columns:
    """The columns from `first` to before `end` hold numbers; those before name the frame.

    levels: names of the header rows. labels: of each column, one per level.
    has_sets: Lightning Pose's last column follows: what the frame was used for.
    """

    first: int
    end: int
    levels: tuple[str, ...]
    labels: tuple[tuple[str, ...], ...]
    has_sets: bool


def sniff(document: Document) -> bool:
    """Return whether the first cell names a header row.

    The wrong separator is recognised so that `read` can refuse it in words.
    """
    return _FIRST_CELL.match(document.start[:64]) is not None


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read the camera of a DeepLabCut or Lightning Pose .csv. Raises FormatError."""
    table = _read_plain_table(document) or _read_any_table(document)
    return (keypoints_from_table(table, document.origin),)


def _read_plain_table(document: Document) -> Table | None:
    """Return the table of a file of plain rows, a quarter of the time of `_read_any_table`.

    None where a row has quotes, an empty text, another number of cells or something that is no
    number. Raises FormatError where the header is wrong.
    """
    header: Header = {}
    for line in document.lines():
        cells = line.rstrip("\r\n").split(",")
        if cells[0] not in LEVELS or '"' in line:
            break
        header[cells[0]] = cells
    if "coords" not in header:
        return None
    columns = _columns(header, document)
    values = np.empty((_count_rows(document, len(header)), columns.end - columns.first))
    texts: list[list[str]] = []
    for block in document.blocks(len(header)):
        try:
            own, numbers = _parse_block(block.decode(), columns)
        except ValueError:  # the careful reader says what it is
            return None
        values[len(texts) : len(texts) + len(own)] = numbers
        texts += own
    return Table(
        levels=columns.levels,
        columns=columns.labels,
        rows=["/".join(cells) for cells in texts],
        values=values,
        lines=[
            f"row {number} ({cells[-1]})" for number, cells in enumerate(texts, len(header) + 1)
        ],
    )


def _count_rows(document: Document, first_line: int) -> int:
    """Return the number of rows from a line on."""
    blocks = document.blocks(first_line)
    return sum(block.count(b"\n") + (not block.endswith(b"\n")) for block in blocks)


def _parse_block(text: str, columns: _Columns) -> tuple[list[list[str]], Floats]:
    """Return the texts and the numbers `[row, column]` of lines, NaN where a cell is empty.

    Raises ValueError where a row is not plain.
    """
    lines = text.replace("\r\n", "\n").removesuffix("\n").split("\n")
    cells = [line.split(",", columns.first) for line in lines]
    texts = [row[: columns.first] for row in cells]
    if '"' in text or not all(map(all, texts)) or len(min(cells, key=len)) <= columns.first:
        raise ValueError("quotes, an empty text or a row without numbers")
    numbers = "".join(f",{row[-1]},\n" for row in cells)
    for _ in range(2):  # each finds every second of neighbours
        numbers = numbers.replace(",,", ",nan,")
    rows = [row[1:-1] for row in numbers.removesuffix("\n").split("\n")]
    values = np.loadtxt(rows, delimiter=",", comments=None, ndmin=2)
    if values.shape != (len(texts), columns.end - columns.first):
        raise ValueError("another number of cells, or an empty line")
    return texts, values


def _read_any_table(document: Document) -> Table:
    """Return the table of a file, cell by cell. Raises FormatError."""
    source = document.source
    header: Header = {}
    columns: _Columns | None = None
    rows, lines, numbers = [], [], []
    for number, row in _rows(document):
        if row[0] in LEVELS and columns is None:
            header[row[0]] = row
            continue
        columns = columns or _columns(header, document)
        first, end = columns.first, columns.end
        cells = row[:end] if columns.has_sets else row
        numbers.append(_numbers(cells, first, end, f"{source}: row {number}"))
        rows.append("/".join(row[:first]))
        lines.append(f"row {number} ({row[first - 1]})")
    columns = columns or _columns(header, document)
    values = np.array(numbers).reshape(len(rows), columns.end - columns.first)
    return Table(columns.levels, columns.labels, rows, values, lines)


def _rows(document: Document) -> Iterator[tuple[int, list[str]]]:
    """Return the number in the file and the cells of each row that is not empty.

    Raises FormatError.
    """
    try:
        for number, row in enumerate(csv.reader(document.lines()), start=1):
            if any(row):
                yield number, row
    except csv.Error as error:
        raise FormatError(
            document.source, "comma-separated values", error, "export it from DeepLabCut again"
        ) from None


def _columns(header: Header, document: Document) -> _Columns:
    """Return which columns hold numbers, and what of. Raises FormatError."""
    source = document.source
    coords = header.get("coords", [])
    if not any(coords[1:]):
        raise FormatError(
            source,
            "commas between cells and a header row `coords`",
            document.head.splitlines()[0][:60],
            "export it with commas",
        )
    headed = [column for column, cell in enumerate(coords) if column and cell]
    first, end = headed[0], headed[-1] + 1
    levels, labels = _labels(header, first, end, source)
    has_sets = header.get("scorer", [])[end:] == ["set"]
    return _Columns(first, end, levels, labels, has_sets)


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
            raise FormatError(
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
        raise FormatError(
            source, f"{end} cells", len(row), "the file is cut or damaged: export it again"
        )
    if any(row[end:]):
        raise FormatError(
            source,
            f"{end} cells, as many as the header has",
            len(row),
            "it has commas in its numbers, perhaps: write numbers like 12.5",
        )
    try:
        return np.array([float(cell) if cell else np.nan for cell in row[first:end]])
    except ValueError as error:
        raise FormatError(
            source, "numbers with a decimal point", error, "write numbers like 12.5"
        ) from None


CSV = Format(
    kind="keypoints",
    name="deeplabcut-csv",
    title="DeepLabCut and Lightning Pose .csv",
    sniff=sniff,
    read=read,
    write=deeplabcut_writer.write_csv,
    endings=(".csv",),
    followed=True,
    loses=(SIZES, SCORES),
)
