"""What the writers of CSV share: lines, and frames in pieces."""

import csv
import io
from collections.abc import Iterator, Sequence

import msgspec
import numpy as np

from mocap_calib import mapped
from mocap_calib.types import Bools, Floats, Ints

_PIECE = 1 << 17  # numbers: some are under way on each thread, of 25 characters each


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
