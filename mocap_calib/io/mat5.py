"""MATLAB 5 files, as far as tables of numbers need: read by ourselves, because scipy makes arrays of whatever size a damaged file claims."""

import struct
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np

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
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _CHAR = 1, 2, 4
_NUMBERS = range(6, 16)  # classes: double, single, and integers of all sizes
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


def read_mat(content: bytes, wanted: tuple[str, ...]) -> dict[str, Any]:
    """The variables of these names: arrays, text, lists for cells, lists of dictionaries for structs (both in MATLAB's order).

    Raises one of DAMAGE for what is no whole MATLAB 5 file.
    """
    order = {b"IM": "<", b"MI": ">"}[content[126:128]]
    found = {}
    for element in _elements(content[128:], order):
        compressed = element[0] == _COMPRESSED
        kind, data = (
            next(_elements(zlib.decompressobj().decompress(element[1], _MOST), order))
            if compressed
            else element
        )
        if kind == _MATRIX:
            name, value = _matrix(data, order, wanted)
            if name in wanted:
                found[name] = value
    return found


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Type and content of each element."""
    at = 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        if kind >> 16:  # a small element: type and size in four bytes, content in the other four
            kind, size, start, after = kind & 0xFFFF, kind >> 16, at + 4, at + 8
        else:
            start = at + 8
            after = start + size if kind == _COMPRESSED else start + (size + 7) // 8 * 8
        if start + size > len(data):
            raise ValueError("an element goes beyond the end")
        yield kind, data[start : start + size]
        at = after


def _matrix(data: bytes, order: str, wanted: tuple[str, ...] | None) -> tuple[str, Any]:
    """Name and value of a matrix; no value where the name is not wanted."""
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
    return name, _value(kind, shape, count, parts, order)


def _value(
    kind: int, shape: tuple[int, ...], count: int, parts: Iterator[tuple[int, bytes]], order: str
) -> Any:
    """What a matrix of this class holds; None for functions and objects, which nothing asks for."""
    if kind == _CELL:
        return [_matrix(next(parts)[1], order, None)[1] for _ in range(count)]
    if kind == _STRUCT:
        width = int(_numbers(next(parts), order)[0])
        text = next(parts)[1]
        fields = [
            text[k : k + width].split(b"\0")[0].decode("latin-1")
            for k in range(0, len(text), width)
        ]
        return [
            {field: _matrix(next(parts)[1], order, None)[1] for field in fields}
            for _ in range(count)
        ]
    if kind == _CHAR:
        return "".join(map(chr, _numbers(next(parts), order).tolist()))
    if kind in _NUMBERS:
        return _numbers(next(parts), order).reshape(shape, order="F")
    return None


def _numbers(element: tuple[int, bytes], order: str) -> np.ndarray[Any, np.dtype[Any]]:
    kind, data = element
    return np.frombuffer(data, dtype=f"{order}{_TYPES[kind]}")
