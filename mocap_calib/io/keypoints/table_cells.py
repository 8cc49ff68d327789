"""Read the cells of a table of comma-separated values with a header, column by column."""

import csv
import io
from dataclasses import dataclass

import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.document import Document
from mocap_calib.types import Floats, Ints


@dataclass(frozen=True)
class Cells:
    """The rows below the header.

    columns: name -> `[row]` text without spaces around it.
    lines: `[row]` line numbers in the file.
    """

    source: str
    columns: dict[str, tuple[str, ...]]
    lines: Ints

    def __len__(self) -> int:
        return len(self.lines)

    def place(self, row: int) -> str:
        """Return the row, as messages name it."""
        return f"{self.source}: row {self.lines[row]}"

    def numbers(self, name: str) -> Floats:
        """Return the `[row]` numbers of a column, NaN where it is empty or not there.

        Raises FormatError.
        """
        column = self.columns.get(name, ("",) * len(self))
        try:
            return np.array([float(cell) if cell else np.nan for cell in column], dtype=np.float64)
        except ValueError:
            row = next(k for k, cell in enumerate(column) if cell and not _is_number(cell))
            raise FormatError(
                self.place(row),
                "a number with a decimal point",
                column[row],
                "write numbers like 12.5",
            ) from None


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def read_cells(document: Document) -> Cells:
    """Read all cells of a table. Raises FormatError, also where there is no row."""
    source, header = document.source, document.header
    if len(set(header)) < len(header):
        raise FormatError(source, "each column once", ",".join(header), "rename or remove columns")
    rows, lines = _read_rows(document)
    rows, lines = rows[1:], lines[1:]
    if not rows:
        raise FormatError(source, "rows below the header", "none", "export it again")
    for cells, line in zip(rows, lines, strict=True):
        if len(cells) != len(header):
            raise FormatError(
                f"{source}: row {line}",
                f"{len(header)} cells, as many as the header has",
                len(cells),
                "the file is cut, or has commas in its numbers",
            )
    columns = {
        name: tuple(map(str.strip, column))
        for name, column in zip(header, zip(*rows, strict=True), strict=True)
    }
    return Cells(source, columns, np.array(lines))


def _read_rows(document: Document) -> tuple[list[list[str]], list[int]]:
    """Return the rows of a table that are not empty, and their line numbers. Raises FormatError."""
    reader = csv.reader(io.StringIO(document.text, newline=""))
    rows, lines = [], []
    try:
        for cells in reader:
            if any(cells):
                rows.append(cells)
                lines.append(reader.line_num)
    except csv.Error as error:
        raise FormatError(
            document.source, "comma-separated values", error, "export it again"
        ) from None
    return rows, lines
