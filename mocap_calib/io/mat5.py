"""Read MATLAB 5 files, as far as tables of numbers need.

They are read here because scipy makes arrays of whatever size a damaged file claims.
"""

import struct
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np

# codes of the types of numbers, as numpy spells them
_TYPES = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
    16: "u1",
    17: "u2",
    18: "u4",
}
_MATRIX, _COMPRESSED = 14, 15  # types of elements
_CELL, _STRUCT, _CHAR = 1, 2, 4  # classes of matrices,
_NUMBERS = range(6, 16)  # double, single, and integers of all sizes
_HEADER = 128  # bytes, of which the last two tell the order of bytes
_MOST = 1 << 29  # bytes that one variable may unpack to
# what a damaged file makes of the reading
DAMAGE = (
    struct.error,
    zlib.error,
    ValueError,
    IndexError,
    KeyError,
    StopIteration,
    RecursionError,
    OverflowError,
    MemoryError,
)

Element = tuple[int, bytes]  # type and content


def read_mat(content: bytes, wanted: tuple[str, ...]) -> dict[str, Any]:
    """Return the variables of these names.

    They are arrays, text, lists for cells, and lists of dictionaries for structs (both in MATLAB's
    order). Raises one of DAMAGE for what is no whole MATLAB 5 file.
    """
    order = {b"IM": "<", b"MI": ">"}[content[_HEADER - 2 : _HEADER]]
    found = {}
    for element in _elements(content[_HEADER:], order):
        kind, data = _unpack(element, order)
        if kind == _MATRIX:
            name, value = _matrix(data, order, wanted)
            if name in wanted:
                found[name] = value
    return found


def _unpack(element: Element, order: str) -> Element:
    """Return an element, or the one that is compressed in it."""
    kind, data = element
    if kind != _COMPRESSED:
        return element
    return next(_elements(zlib.decompressobj().decompress(data, _MOST), order))


def _elements(data: bytes, order: str) -> Iterator[Element]:
    """Yield type and content of each element."""
    at = 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        if kind >> 16:  # a small element: type and size in four bytes, content in the other four
            kind, size = kind & 0xFFFF, kind >> 16
            start, after = at + 4, at + 8
        else:
            start = at + 8
            padded = size if kind == _COMPRESSED else (size + 7) // 8 * 8
            after = start + padded
        if start + size > len(data):
            raise ValueError("an element goes beyond the end")
        yield kind, data[start : start + size]
        at = after


def _matrix(data: bytes, order: str, wanted: tuple[str, ...] | None) -> tuple[str, Any]:
    """Return name and value of a matrix; no value where the name is not wanted."""
    if not data:
        return "", np.zeros((0, 0))
    parts = _elements(data, order)
    kind = int(_numbers(next(parts), order)[0]) & 0xFF
    shape = tuple(int(n) for n in _numbers(next(parts), order))
    name = next(parts)[1].decode("latin-1")
    if wanted is not None and name not in wanted:
        return name, None
    count = int(np.prod(shape, dtype=object))
    if min(shape) < 0 or count > len(data):
        raise ValueError(f"a matrix of shape {shape} in {len(data)} bytes")
    if kind in _NUMBERS:
        return name, _numbers(next(parts), order).reshape(shape, order="F")
    return name, _value(kind, count, parts, order)


def _value(kind: int, count: int, parts: Iterator[Element], order: str) -> Any:
    """Return what a matrix of this class holds that is no array of numbers.

    None stands for functions and objects, which nothing asks for.
    """
    if kind == _CHAR:
        return "".join(map(chr, _numbers(next(parts), order).tolist()))
    if kind == _CELL:
        return _cells(parts, count, order)
    return _structs(parts, count, order) if kind == _STRUCT else None


def _cells(parts: Iterator[Element], count: int, order: str) -> list[Any]:
    """Return the values of the next matrices."""
    return [_matrix(next(parts)[1], order, None)[1] for _ in range(count)]


def _structs(parts: Iterator[Element], count: int, order: str) -> list[dict[str, Any]]:
    """Return the fields of each struct of an array of them."""
    width = int(_numbers(next(parts), order)[0])  # bytes that the name of a field takes
    text = next(parts)[1]
    names = [text[start : start + width] for start in range(0, len(text), width)]
    fields = [name.split(b"\0")[0].decode("latin-1") for name in names]
    return [
        {field: _matrix(next(parts)[1], order, None)[1] for field in fields} for _ in range(count)
    ]


def _numbers(element: Element, order: str) -> np.ndarray[Any, np.dtype[Any]]:
    kind, data = element
    return np.frombuffer(data, dtype=f"{order}{_TYPES[kind]}")
