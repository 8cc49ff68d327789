"""Read tables of separated text: comma-separated values, and what spreadsheets make of them.

    table = read_table(document, texts=("frame", "keypoint"), numbers=("x", "y", "score"))
    table.text("frame")  # `[row]` cells of a column of text
    table.numbers        # `[row, 3]`, NaN where a cell is empty or the column is absent

Columns are named by their headings, or by their index where the header has several rows
(`header_rows`); other columns are passed over. A cell that is no number, a row that is cut and
cells beyond the header are refused with the number of the row.
"""

import csv
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice

import msgspec
import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.document import Document
from mocap_calib.types import Floats

Column = int | str  # its index, or its heading
_NUMBERS = msgspec.json.Decoder(list[float | None])


@dataclass(frozen=True)
class Table:
    """The rows below the header that are not empty.

    texts: text column -> its `[row]` cells, without spaces around them; of those that are there.
    columns: the number columns.
    numbers: `[row, column]`, NaN where a cell is empty or the column is absent.
    lines: `[row]` line numbers in the file.
    """

    source: str
    texts: dict[Column, tuple[str, ...]]
    columns: tuple[Column, ...]
    numbers: Floats
    lines: tuple[int, ...]

    def __len__(self) -> int:
        return len(self.lines)

    def text(self, column: Column, absent: str = "") -> tuple[str, ...]:
        """Return the `[row]` cells of a text column, all of them `absent` where it is absent."""
        return self.texts.get(column, (absent,) * len(self))

    def number(self, column: Column) -> Floats:
        """Return the `[row]` numbers of a column."""
        return self.numbers[:, self.columns.index(column)]

    def refuse(self, row: int, expected: str, found: object, remedy: str) -> FormatError:
        """Return the refusal of a row (an index)."""
        return FormatError(f"{self.source}: row {self.lines[row]}", expected, found, remedy)


def read_header(document: Document, rows: int = 1, separator: str = ",") -> list[list[str]]:
    """Return the cells of the first rows that are not empty. Raises FormatError."""
    lines = enumerate(document.lines(), start=1)
    return [cells for _, cells in islice(_rows(lines, document, separator), rows)]


def read_table(
    document: Document,
    *,
    texts: Sequence[Column] = (),
    numbers: Sequence[Column],
    header_rows: int = 1,
    separator: str = ",",
    ragged: bool = False,
) -> Table:
    """Read columns of a table.

    texts, numbers: the columns that are read.
    ragged: a row may end anywhere behind its texts; else only where all numbers are missing.

    Raises FormatError, also where a heading occurs twice, or there is no row below the header.
    """
    lines = enumerate(document.lines(), start=1)
    header = [cells for _, cells in islice(_rows(lines, document, separator), header_rows)]
    width = max(map(len, header), default=0)
    places = _places(header, document)
    text_places = {column: places[column] for column in texts if column in places}
    number_places = [places.get(column, width) for column in numbers]
    behind = max(text_places.values(), default=-1) + 1
    is_plain = separator == "," and number_places == list(range(behind, width))
    kept, values, line_of = list[list[str]](), array("d"), list[int]()
    for line, text in lines:
        cells, row = text.split(separator, behind), None
        if is_plain and len(cells) > behind and '"' not in text:
            row = _parse_plain(cells[behind], width - behind)
        if row is None:
            first = chain([(line, text)], lines)
            line, cells = next(_rows(first, document, separator), (0, []))  # noqa: PLW2901
            if not cells:
                break
            where = f"{document.source}: row {line}"
            may_end = ragged or (len(cells) > behind and not any(cells[behind:]))
            cells = _fit(cells, width, where, may_end=may_end)
            row = [_parse_number(cells[place], where) for place in number_places]
        kept.append([cells[place] for place in text_places.values()])
        values.frombytes(np.array(row, dtype=np.float64).tobytes())
        line_of.append(line)
    if not line_of:
        raise document.refuse("rows below the header", "none")
    columns = (tuple(map(str.strip, column)) for column in zip(*kept, strict=True))
    return Table(
        source=document.source,
        texts=dict(zip(text_places, columns, strict=True)),
        columns=tuple(numbers),
        numbers=np.frombuffer(values).reshape(len(line_of), len(number_places)),
        lines=tuple(line_of),
    )


def _rows(
    lines: Iterator[tuple[int, str]], document: Document, separator: str
) -> Iterator[tuple[int, list[str]]]:
    """Yield the line number and the cells of each row that is not empty. Raises FormatError."""
    number = 0

    def texts() -> Iterator[str]:
        nonlocal number
        for number, text in lines:  # noqa: B007
            yield text

    try:
        for cells in csv.reader(texts(), delimiter=separator):
            if any(cells):
                yield number, cells
    except csv.Error as error:
        raise document.refuse("separated values", error) from None


def _places(header: list[list[str]], document: Document) -> dict[Column, int]:
    """Return the places of columns: by index, and by heading where the header is one row."""
    places: dict[Column, int] = {k: k for k in range(max(map(len, header), default=0))}
    headings = [cell.strip() for cell in header[0]] if len(header) == 1 else []
    if len(set(headings)) < len(headings):
        raise document.refuse("each column once", ",".join(headings), "rename or remove columns")
    return places | {heading: place for place, heading in enumerate(headings)}


def _parse_plain(cells: str, count: int) -> list[float | None] | None:
    """Return the numbers of plain cells, None where they are empty; None for any other cells.

    JSON's parser takes a quarter of the time of `float`, to the same last bit.
    """
    if "n" in cells:  # nan, null
        return None
    cells = f",{cells.strip()},"
    while ",," in cells:  # each time finds every second of neighbours
        cells = cells.replace(",,", ",null,")
    try:
        numbers = _NUMBERS.decode(f"[{cells[1:-1]}]")
    except msgspec.MsgspecError:
        return None
    return numbers if len(numbers) == count else None


def _fit(cells: list[str], width: int, where: str, *, may_end: bool) -> list[str]:
    """Return the cells of a row, and empty ones up to one behind the header. Raises FormatError.

    may_end: the row may have fewer cells than the header.
    """
    if any(cells[width:]) or (len(cells) < width and not may_end):
        expected = f"{width} cells, as many as the header has"
        remedy = "the file is cut, or has commas in its numbers"
        raise FormatError(where, expected, len(cells), remedy)
    within = cells[:width]
    return [*within, *[""] * (width + 1 - len(within))]


def _parse_number(cell: str, where: str) -> float:
    """Return the number in a cell, NaN where it is blank. Raises FormatError."""
    try:
        return float(cell) if cell.strip() else np.nan
    except ValueError:
        expected = "a number with a decimal point"
        raise FormatError(where, expected, cell, "write numbers like 12.5") from None
