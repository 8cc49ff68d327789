"""What the writers of CSV share: lines, and frames in pieces."""

import csv
import io
from collections.abc import Iterator, Sequence

import msgspec
import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.kernels import compiled, contiguous
from mocap_calib.types import Bools, Floats, Ints

_PIECE = 4096  # frames: Python's numbers take four times the room of numpy's


def format_csv_line(cells: Sequence[str]) -> str:
    """Return a line of CSV, quoted where it needs to be."""
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(cells)
    return line.getvalue()


def slice_frames(frames: int) -> Iterator[slice]:
    """Yield slices of so many frames that are written in one go."""
    return mapped.frame_slices(frames, _PIECE)


def format_lines(first: str, cells: Floats, last: str, numbers: Ints) -> str:
    """Return lines: a text, floats, another text, whole numbers.

    cells: `[row, column]`, "" for NaN. numbers: `[row, column]`. Commas between those of a row.
    Floats are exact, as `repr` writes them.
    """
    kernels = compiled("mocap_calib.io.results.csv_kernels")
    if kernels is None:
        return _format_lines(first, cells, last, numbers)
    powers = kernels.powers_of_ten()
    cells, numbers = contiguous(cells, numbers)
    texts = [np.frombuffer(text.encode(), np.uint8) for text in (first, last)]
    width = len(texts[0]) + len(texts[1]) + kernels.NUMBER * (cells.shape[1] + numbers.shape[1])
    text, ends = np.empty(len(cells) * (width + 1), np.uint8), np.zeros(len(cells), np.int64)
    lines, row = [], 0
    while row < len(cells):
        rest = slice(row, None)
        done = kernels.write_rows(
            texts[0],
            cells[rest].view(np.int64),
            powers,
            texts[1],
            numbers[rest],
            text,
            ends[rest],
        )
        if done:
            lines.append(str(text[: ends[row + done - 1]].data, "utf-8"))
        row += done
        if row < len(cells):  # it has a number that kernels do not write
            one = slice(row, row + 1)
            lines.append(_format_lines(first, cells[one], last, numbers[one]))
            row += 1
    return "".join(lines)


def _format_lines(first: str, cells: Floats, last: str, numbers: Ints) -> str:
    """Return what `format_lines` returns."""
    whole = (",".join(map(str, row)) for row in numbers.tolist())
    rows = zip(format_rows(cells), whole, strict=True)
    return "".join(f"{first}{row}{last}{own}\n" for row, own in rows)


def format_rows(table: Floats) -> list[str]:
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
