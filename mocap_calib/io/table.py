"""Read and write tables of comma-separated values.

    table = read_table(document, texts=("frame", "keypoint"), numbers=("x", "y", "score"))
    table.text("frame")  # `[row]` cells of a column of text
    table.numbers        # `[row, 3]`, NaN where a cell is empty or the column is absent

Columns are named by their headings, in any case, or by their index, as where the header has several
rows (`header_rows`); other columns are passed over. A cell that is no number, a row that is cut and
cells beyond the header are refused with the number of the row.

Cells are separated by commas, semicolons or tabs. Where the separator is not a comma, numbers may
have a decimal comma, in all cells of a file or in none. `NA` and its like are empty cells.
"""

import csv
import io
import re
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice

import msgspec
import numpy as np

from mocap_calib import mapped
from mocap_calib.errors import FormatError
from mocap_calib.io.document import Document
from mocap_calib.io.file import are_whole
from mocap_calib.types import Bools, Floats, Ints

Column = int | str  # its index, or its heading
# the heading of a column of row numbers: of pandas and R, and of pandas' own file read again
ROW_NUMBERS = re.compile(r"|index|unnamed: *\d+")
_PIECE = 1 << 17  # numbers: some are under way on each thread, of 25 characters each
_ROWS = msgspec.json.Decoder(list[list[float]])
_NUMBERS = msgspec.json.Decoder(list[float])
_ABSENT = (
    "",
    "na",
    "n/a",
    "#n/a",
    "null",
    "none",
)  # cells without a number, as R, Excel write them


@dataclass(frozen=True)
class Table:
    """The rows below the header that are not empty.

    texts: text column -> its `[row]` cells, without spaces around them; of those that are there.
    numbers: `[row, column]`, NaN where a cell is empty or the column is absent.
    lines: `[row]` line numbers in the file.
    """

    source: str
    texts: dict[Column, tuple[str, ...]]
    numbers: Floats
    lines: list[int]

    def text(self, column: Column, absent: str = "") -> tuple[str, ...]:
        """Return the `[row]` cells of a text column, all of them `absent` where it is absent."""
        return self.texts.get(column, (absent,) * len(self.lines))

    def refuse(self, row: int, expected: str, found: object, remedy: str) -> FormatError:
        """Return the refusal of a row (an index)."""
        return FormatError(f"{self.source}: row {self.lines[row]}", expected, found, remedy)


def read_rows(document: Document, first_line: int = 0) -> Iterator[tuple[int, list[str]]]:
    """Yield the line number and the cells of each row that is not empty. Raises FormatError."""
    reader = csv.reader(document.lines(first_line), delimiter=document.separator)
    try:
        for cells in reader:
            if any(cells):
                yield first_line + reader.line_num, cells
    except csv.Error as error:
        raise document.refuse("separated values", error) from None


def read_table(
    document: Document, *, texts: Sequence[Column], numbers: Sequence[Column], header_rows: int = 1
) -> Table:
    """Read columns of a table.

    texts, numbers: the columns that are read, all by heading or all by index.

    Raises FormatError, also where a heading occurs twice, or there is no row below the header.
    """
    rows = read_rows(document)
    header = list(islice(rows, header_rows))
    first_line = header[-1][0]
    width = max(len(cells) for _, cells in header)
    places: dict[Column, int] = {place: place for place in range(width)}
    if any(isinstance(column, str) for column in (*texts, *numbers)):
        headings = [cell.strip() for cell in header[0][1]]
        named = list(filter(None, headings))
        if len(set(named)) < len(named):
            remedy = "rename or remove columns"
            raise document.refuse("each column once", ",".join(headings), remedy)
        places |= {heading.casefold(): place for place, heading in enumerate(headings)}
        places |= {heading: place for place, heading in enumerate(headings)}
    text_places = {column: places[column] for column in texts if column in places}
    number_places = [places.get(column, width) for column in numbers]
    labels = [[row[place : place + 1] for _, row in header] for place in range(width)]
    used = {*text_places.values(), *number_places}
    left = ("_".join(filter(None, chain(*labels[place]))) for place in {*range(width)} - used)
    names = (name.strip() for name in left)
    document.account.add_names(
        (name for name in names if not ROW_NUMBERS.fullmatch(name.casefold())), "columns"
    )
    values, is_all = np.empty((0, width)), False
    is_plain = [*text_places.values(), *number_places] == list(range(width))
    if is_plain and len(text_places) == 1 and document.separator == ",":
        values, is_all = _read_plain(document, first_line, width)
    lines = list(range(first_line + 1, first_line + 1 + len(values)))
    numbers_of_rows = tuple(map(str, values[:, 0].astype(np.int64).tolist()))
    kept: list[list[str]] = []
    further, first_cell = array("d"), max(text_places.values(), default=-1) + 1
    if len(values):
        rows = iter(()) if is_all else read_rows(document, first_line + len(values))
    parse = _parse_number if document.separator == "," else _LocalNumbers().parse
    for line, cells in rows:
        where = f"{document.source}: row {line}"
        is_missing = len(cells) > first_cell and not any(cells[first_cell:])
        row = _fit(cells, width, where, may_end=is_missing)
        further.extend(parse(row[place], where) for place in number_places)
        kept.append([row[place].strip() for place in text_places.values()])
        lines.append(line)
    if not lines:
        raise document.refuse("rows below the header", "none")
    columns = zip(*kept, strict=True) if kept else [()] * len(text_places)
    texts_of = zip(text_places, columns, strict=True)
    return Table(
        source=document.source,
        texts={column: numbers_of_rows + tuple(cells) for column, cells in texts_of},
        numbers=_join(values[:, 1:], np.frombuffer(further).reshape(-1, len(number_places))),
        lines=lines,
    )


def _join(first: Floats, then: Floats) -> Floats:
    """Return `[row, column]` numbers of both, without a copy where one has no rows."""
    if not len(first) or not len(then):
        return first if len(first) else then
    return np.concatenate([first, then])


def _read_plain(document: Document, first_line: int, width: int) -> tuple[Floats, bool]:
    """Return the `[row, width]` numbers of a table, and whether they are all that it has.

    They end before the first block with cells that are neither numbers nor empty. The first column
    holds frame numbers.
    """
    found, is_all = array("d"), True
    for block in document.blocks(first_line):
        values = _parse_block(block, width)
        if not len(values) or not are_whole(values[:, 0]):
            is_all = False
            break
        found.frombytes(values.tobytes())
    return np.frombuffer(found).reshape(-1, width), is_all


def _parse_block(block: bytes, width: int) -> Floats:
    """Return the `[row, width]` numbers of whole lines, NaN for empty cells; none for others.

    JSON's parser takes a quarter of the time of `float`, to the same last bit.
    """
    rows = block.strip().replace(b"\n", b"],[")
    try:
        numbers = _ROWS.decode(b"[[" + rows + b"]]")
    except msgspec.MsgspecError:
        return _parse_with_gaps(block, width)
    is_full = set(map(len, numbers)) == {width}
    return np.array(numbers if is_full else (), dtype=np.float64).reshape(-1, width)


def _parse_with_gaps(block: bytes, width: int) -> Floats:
    """Return what `_parse_block` does. JSON has no empty cells: the comma of each becomes blank."""
    lines = block.rstrip() if b"\r" not in block else block.rstrip().replace(b"\r\n", b"\n")
    none = np.empty((0, width))
    text = bytearray(b"[%b\n" % lines)
    codes = np.frombuffer(text, dtype=np.uint8)
    is_line_end = codes == ord("\n")
    ends = np.flatnonzero((codes == ord(",")) | is_line_end)  # of cells
    line_ends = ends[width - 1 :: width]
    is_table = len(ends) % width == 0 and np.count_nonzero(is_line_end) == len(line_ends)
    has_number = np.append(ends[0] > 1, ends[1:] - ends[:-1] > 1)
    if not is_table or not is_line_end[line_ends].all() or not has_number.any():
        return none
    codes[line_ends] = ord(",")
    codes[ends[~has_number]] = ord(" ")
    codes[ends[has_number][-1]] = ord("]")
    try:
        numbers = _NUMBERS.decode(text)
    except msgspec.MsgspecError:
        return none
    values = np.full(len(ends), np.nan)
    values[has_number] = np.fromiter(numbers, np.float64, len(numbers))
    return values.reshape(-1, width)


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


def _parse_number(cell: str, where: str, mark: str = ".") -> float:
    """Return the number in a cell, NaN where it is empty. Raises FormatError.

    mark: the decimal mark, a point or a comma.
    """
    try:
        if mark == ".":
            return float(cell)
        if "." not in cell:
            return float(cell.replace(mark, "."))
    except ValueError:
        if cell.strip().casefold() in _ABSENT:
            return np.nan
    expected = f"a number with a decimal {'point' if mark == '.' else 'comma'}"
    raise FormatError(where, expected, cell, f"write numbers like 12{mark}5")


class _LocalNumbers:
    """Parse the numbers of a table whose cells are not separated by commas.

    All have a decimal comma, or all a decimal point: the first that has either decides.
    """

    def __init__(self) -> None:
        self._mark = ""

    def parse(self, cell: str, where: str) -> float:
        """Return the number in a cell, NaN where it is empty. Raises FormatError."""
        self._mark = self._mark or next((mark for mark in cell if mark in ".,"), "")
        return _parse_number(cell, where, self._mark or ".")


# --- writing


def format_csv_line(cells: Sequence[str]) -> str:
    """Return a line of CSV, quoted where it needs to be."""
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(cells)
    return line.getvalue()


def slice_frames(frames: int, columns: int) -> Iterator[slice]:
    """Yield slices of so many frames that are written in one go.

    columns: numbers of a frame.
    """
    return mapped.frame_slices(frames, max(1, _PIECE // columns))


def format_lines(first: str, cells: Floats, last: str, numbers: Ints) -> bytes:
    """Return lines in UTF-8: a text, floats, another text, whole numbers.

    cells: `[row, column]`, "" for NaN. numbers: `[row, column]`. Commas are between those of a row
    alone. Floats are exact, as `repr` writes them.
    """
    whole = (",".join(map(str, row)) for row in numbers.tolist())
    rows = zip(_format_rows(cells), whole, strict=True)
    return "".join(f"{first}{row}{last}{own}\n" for row, own in rows).encode()


def _format_rows(table: Floats) -> list[str]:
    """Return the numbers of each row of `[row, column]`, with commas between them, "" for NaN.

    They are exact, as `repr` writes them. JSON has the same digits, eight times as fast; exponents
    and infinities it writes in its own way: rows that have such are left to `repr`.
    """
    if not table.size:
        return [""] * len(table)
    text = msgspec.json.encode(table.tolist()).decode()
    rows = text[2:-2].replace("null", "").split("],[")
    for row in np.flatnonzero(_need_exponents(table).any(1)).tolist():
        # a list writes its numbers as `repr` does
        rows[row] = str(table[row].tolist())[1:-1].replace(" ", "").replace("nan", "")
    return rows


def _need_exponents(table: Floats) -> Bools:
    """Return `[row, column]` where `repr` writes an exponent, or an infinity."""
    size = np.abs(table)
    return np.asarray(((size < 1e-4) & (size > 0)) | (size >= 1e16))
