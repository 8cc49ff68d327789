"""Read rows of comma-separated cells in blocks, several at a time, where all of them are plain."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from mocap_calib.compute.kernels import compiled
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.types import Bools, Floats


@dataclass(frozen=True)
class PlainRows:
    """Rows of a table.

    texts: of each row, its cells that are texts.
    values: `[row, number]`, NaN where a cell is empty.
    """

    texts: list[tuple[str, ...]]
    values: Floats


def read_plain_rows(blocks: Iterable[bytes], is_number: Sequence[bool]) -> PlainRows | None:
    """Return the rows in blocks of whole lines, whose numbers are read as `float` reads them.

    is_number: `[cell]` whether the cells of a row are numbers.

    None where a row is odd in any way (quotes, an empty text, a blank line, another number of
    cells, a number that JSON would not have), and where numba is missing: a reader that looks at
    each cell has to read the table, and says what is wrong with it.
    """
    kernels = compiled("mocap_calib.io.keypoints.table_kernels")
    if kernels is None:
        return None
    parse = partial(_parse, kernels, kernels.powers_of_ten(), np.array(is_number, dtype=bool))
    parts = []
    for part in map_in_threads(parse, blocks):
        if part is None:
            return None
        parts.append(part)
    if not parts:
        return None
    texts = [cells for part in parts for cells in part.texts]
    return PlainRows(texts, np.concatenate([part.values for part in parts]))


def _parse(kernels: Any, powers: Floats, is_number: Bools, block: bytes) -> PlainRows | None:
    """Return the rows of a block of lines; None where one is odd."""
    text = block if block.endswith(b"\n") else block + b"\n"
    rows, numbers = text.count(b"\n"), int(is_number.sum())
    values = np.empty((rows, numbers))
    places = np.empty((rows, len(is_number) - numbers, 2), dtype=np.int64)
    octets = np.frombuffer(text, dtype=np.uint8)
    if kernels.parse_rows(octets, is_number, powers, values, places) < rows:
        return None
    try:
        texts = [tuple(text[i:j].decode() for i, j in cells) for cells in places.tolist()]
    except UnicodeDecodeError:
        return None
    if not all(all(cells) for cells in texts):
        return None
    return PlainRows(texts, values)
