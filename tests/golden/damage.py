"""Four kinds of damage to a file: cut in half, emptied, a number of another type, a part missing.

Each takes and returns bytes and knows JSON, TOML, YAML, tables, HDF5, .npz and .mat by content.
"""

import io
import json
import re
from collections.abc import Callable
from typing import Any

import h5py
import numpy as np
from scipy.io import loadmat, savemat

_NUMBER = re.compile(r"(?<![\w\"'.-])-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?![\w\"'.])")
_KEY = re.compile(r"^\s*(?:- )?[\w\"-]+\s*[:=]")
_LENGTH = 8  # bytes changed or cut out of files of other kinds


def cut_in_half(content: bytes) -> bytes:
    """Return the first half."""
    return content[: len(content) // 2]


def emptied(_: bytes) -> bytes:
    """Return nothing."""
    return b""


def with_a_word_for_a_number(content: bytes) -> bytes:
    """Return the content with the middle number, or the largest array, made a word."""
    if (
        changed := _change_arrays(content, lambda value: np.full(np.shape(value), b"x"))
    ) is not None:
        return changed
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError:
        middle = len(content) // 2
        return content[:middle] + b"\xff" * _LENGTH + content[middle + _LENGTH :]
    hits = list(_NUMBER.finditer(text))
    hit = hits[len(hits) // 2]
    word = "x" if _separator(text) else '"x"'
    return (text[: hit.start()] + word + text[hit.end() :]).encode()


def with_a_part_missing(content: bytes) -> bytes:
    """Return the content without its largest array or key, or a column or key in the middle."""
    if (changed := _change_arrays(content, lambda _: None)) is not None:
        return changed
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError:
        middle = len(content) // 2
        return content[:middle] + content[middle + _LENGTH :]
    if text.lstrip().startswith(("{", "[{", "[[", "[\n")):
        return json.dumps(_without_largest_key(json.loads(text))).encode()
    if separator := _separator(text):
        return "".join(_without_middle_cell(line, separator) for line in _lines(text)).encode()
    return _without_middle_key(text).encode()


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "cut in half": cut_in_half,
    "empty": emptied,
    "word for a number": with_a_word_for_a_number,
    "part missing": with_a_part_missing,
}


def _lines(text: str) -> list[str]:
    return text.splitlines(keepends=True)


def _separator(text: str) -> str:
    """Return what separates the cells of a table, "" where the text is none."""
    rows = [line for line in _lines(text) if line.strip() and not line.startswith("#")]
    if not rows or _KEY.match(rows[0]) or rows[0].lstrip().startswith(("{", "[", "%")):
        return ""
    return next((mark for mark in "\t, " if rows[-1].count(mark) > 1), "")


def _without_middle_cell(line: str, separator: str) -> str:
    cells = line.rstrip("\r\n").split(separator)
    if line.startswith("#") or len(cells) < 3:
        return line
    del cells[len(cells) // 2]
    return separator.join(cells) + "\n"


def _without_middle_key(text: str) -> str:
    """Return TOML or YAML without one key and the lines of its value."""
    lines = _lines(text)
    keys = [k for k, line in enumerate(lines) if _KEY.match(line)]
    middle = len(keys) // 2
    return "".join(lines[: keys[middle]] + lines[keys[middle + 1] :])


def _without_largest_key(value: Any) -> Any:
    """Return a tree without the largest value of its first mapping, in the middle of its lists."""
    if isinstance(value, list) and value:
        middle = len(value) // 2
        return [*value[:middle], _without_largest_key(value[middle]), *value[middle + 1 :]]
    if isinstance(value, dict) and value:
        largest = max(value, key=lambda key: len(json.dumps(value[key])))
        return {key: each for key, each in value.items() if key != largest}
    return value


def _change_arrays(content: bytes, change: Callable[[Any], Any]) -> bytes | None:
    """Return the store with its largest array changed, or removed for None; None for no store."""
    store = io.BytesIO(content)
    if content.startswith(b"\x89HDF"):
        _change_hdf5(store, change)
    elif content.startswith(b"PK\x03\x04"):
        with np.load(store) as archive:
            arrays = dict(archive)
        _change_mapping(arrays, change)
        np.savez(store := io.BytesIO(), **arrays)
    elif content.startswith(b"MATLAB"):
        fields = {k: v for k, v in loadmat(store).items() if not k.startswith("__")}
        first = fields[min(fields, key=lambda name: name != "labelData")]
        inner = first[0, 0]
        arrays = {name: inner[name][0, 0] for name in inner.dtype.names}
        _change_mapping(arrays, change)
        first[0, 0] = arrays
        savemat(store := io.BytesIO(), fields)
    else:
        return None
    return store.getvalue()


def _change_mapping(arrays: dict[str, Any], change: Callable[[Any], Any]) -> None:
    name = max(arrays, key=lambda key: np.asarray(arrays[key]).nbytes)
    changed = change(arrays.pop(name))
    if changed is not None:
        arrays[name] = changed


def _change_hdf5(store: io.BytesIO, change: Callable[[Any], Any]) -> None:
    with h5py.File(store, "r+") as file:
        found: dict[str, int] = {}
        file.visititems(
            lambda name, item: (
                found.update({name: item.nbytes}) if hasattr(item, "nbytes") else None
            )
        )
        name = max(found, key=lambda key: found[key])
        changed = change(file[name][()])
        attributes = dict(file[name].attrs)
        del file[name]
        if changed is not None:
            file[name] = changed
            for key, value in attributes.items():
                if key not in ("DIMENSION_LIST", "REFERENCE_LIST"):
                    file[name].attrs[key] = value
