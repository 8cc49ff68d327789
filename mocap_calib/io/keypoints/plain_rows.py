"""Read rows of comma-separated cells in blocks, several at a time, where all of them are plain."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.kernels.loading import compiled
from mocap_calib.types import Bools, Floats

_ROOM = 1.2  # times the rows that the first block lets expect


@dataclass(frozen=True)
class PlainRows:
    """Rows of a table.

    texts: of each row, its cells that are texts.
    values: `[row, number]`, NaN where a cell is empty.
    size: number of bytes that they take.
    """

    texts: list[tuple[str, ...]]
    values: Floats
    size: int


def read_plain_rows(
    blocks: Iterable[bytes], size: int, is_number: Sequence[bool]
) -> PlainRows | None:
    """Return the rows in blocks of whole lines, whose numbers are read as `float` reads them.

    size: number of bytes in all blocks, roughly.
    is_number: `[cell]` whether the cells of a row are numbers.

    None where a row is odd in any way (quotes, an empty text, a blank line, another number of
    cells, a number that JSON would not have), and where numba is missing: a reader that looks at
    each cell has to read the table, and says what is wrong with it.
    """
    kernels = compiled("mocap_calib.kernels.tables")
    if kernels is None:
        return None
    parse = partial(_parse, kernels, kernels.powers_of_ten(), np.array(is_number, dtype=bool))
    texts: list[tuple[str, ...]] = []
    values = np.empty((0, sum(is_number)))
    for part in map_in_threads(parse, blocks):
        if part is None:
            return None
        start = len(texts)
        texts += part.texts
        if len(texts) > len(values):
            # in one piece at the first part, as a rule: rows are of about one length
            room = len(texts) + int(_ROOM * len(part.texts) * size / part.size)
            values, before = np.empty((room, values.shape[1])), values
            values[:start] = before[:start]
        values[start : len(texts)] = part.values
    return PlainRows(texts, values[: len(texts)], size) if texts else None


def _parse(kernels: Any, powers: Floats, is_number: Bools, block: bytes) -> PlainRows | None:
    """Return the rows of a block of lines; None where one is odd."""
    text = block if block.endswith(b"\n") else block + b"\n"
    rows, numbers = text.count(b"\n"), int(is_number.sum())
    values = np.empty((rows, numbers))
    places = np.empty((rows, len(is_number) - numbers, 2), dtype=np.int64)
    octets = np.frombuffer(text, dtype=np.uint8)
    if kernels.parse_rows(octets, is_number, powers, values, places) < rows:
        return None
    cells = [text[begin:end] for begin, end in places.reshape(-1, 2).tolist()]
    try:
        words = b"\n".join(cells).decode().split("\n")
    except UnicodeDecodeError:
        return None
    if not all(words):
        return None
    return PlainRows(list(zip(*[iter(words)] * places.shape[1], strict=True)), values, len(text))
