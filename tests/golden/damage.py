"""Damage to a file's bytes: what disks, editors and other programs do to files.

Four kinds are always the same: cut in half, emptied, a number of another type, a part missing. They
know JSON, TOML, YAML, tables, HDF5, .npz and .mat by content; other text loses a line.
`damaged(content, rng)` gives one way of many, by what the file is: a store, a tree, a table or
bytes.
"""

import io
import json
import random
import re
from collections.abc import Callable, Mapping
from pathlib import Path
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
    """Return TOML or YAML without one key and its lines, other text without one line."""
    lines = _lines(text)
    keys = [k for k, line in enumerate(lines) if _KEY.match(line)]
    keys = keys if len(keys) > 1 else list(range(len(lines)))
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
    if content.startswith(HDF5):
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
    sizes: dict[str, int] = {}
    with h5py.File(store) as file:
        file.visititems(lambda name, item: sizes.update({name: getattr(item, "nbytes", -1)}))
    change_store(store, {max(sizes, key=lambda name: sizes[name]): change})


def change_store(store: Path | io.BytesIO, changes: Mapping[str, object]) -> None:
    """Change `path` or `path@attribute` in HDF5, to a value or by a function; None removes it."""
    with h5py.File(store, "a") as file:
        for key, given in changes.items():
            place, _, attribute = key.partition("@")
            if attribute:
                file[place or "/"].attrs[attribute] = given
                continue
            value, kept = given, {}
            if place in file:
                value = given(file[place][...]) if callable(given) else given
                kept = {k: v for k, v in file[place].attrs.items() if not k.endswith("_LIST")}
                del file[place]
            if value is not None:
                file[place] = value
                file[place].attrs.update(kept)


# --- damage by lot


HDF5 = b"\x89HDF"
ENCODINGS = ["utf-16", "latin-1", "utf-8-sig", "utf-32"]
ODD: list[Any] = [None, True, False, "", "x", "null", "1,5", "NaN", [], {}, [[]], {"a": 1}, 0, -1]
ODD += [1, 2.5, 1e308, -1e308, 10**400, -(10**400), 2**63, -(2**63), float("nan"), float("inf")]
ODD += ["\u0000", "ä", "9" * 5000, "1e999", [1, [2, [3]]], [[1, 2], [3]]]
CELLS = ["", " ", "x", "nan", "inf", "-1", "1e999", "9" * 400, '"', "1;2", "1,5", "\t", "0x10"]
CELLS += ["1_0", "\u0000", "-0", "1e5", "²", "scorer", "x,y", "[", "]", "{", "}", "null", "&a "]
CELLS += ["*a", ": ", "\ufeff", "é", "[" * 3000]


def damaged(content: bytes, rng: random.Random) -> bytes:
    """Return the content with one damage."""
    share = rng.random()
    if share < 0.4:
        return damage_bytes(content, rng)
    if content.startswith(HDF5):
        return damage_hdf5(content, rng)
    try:
        if content.startswith((b"{", b"[{", b"[[")) and share < 0.8:
            return damage_json(json.loads(content), rng).encode("utf-8", "surrogatepass")
        return damage_text(content.decode(), rng).encode()
    except UnicodeDecodeError:
        return damage_bytes(content, rng)


def damage_json(value: Any, rng: random.Random) -> str:
    """Return a tree with a few nodes replaced, doubled, cut or gone; at times very deep."""
    for _ in range(rng.randrange(1, 4)):
        value = _change(value, rng, rng.randrange(8))
    text = json.dumps(value)
    if rng.random() < 0.03:
        text = '{"people":' * 3000 + text if rng.random() < 0.5 else "[" * 100_000 + text
    return text


def _change(value: Any, rng: random.Random, depth: int) -> Any:
    if depth and isinstance(value, dict) and value:
        key = rng.choice(list(value))
        return value | {key: _change(value[key], rng, depth - 1)}
    if depth and isinstance(value, list) and value:
        k = rng.randrange(len(value))
        return [*value[:k], _change(value[k], rng, depth - 1), *value[k + 1 :]]
    kind = rng.randrange(5)
    if kind == 0 and isinstance(value, list):
        return value * 2 if len(value) < 1000 else value[:1]
    if kind == 1 and isinstance(value, list | str):
        return value[: rng.randrange(len(value) + 1)]
    if kind == 2 and isinstance(value, dict) and value:
        gone = rng.choice(list(value))
        return {k: v for k, v in value.items() if k != gone}
    return rng.choice(ODD)


def damage_text(text: str, rng: random.Random) -> str:
    """Return a text whose cells are replaced, or rows doubled, cut, gone or longer."""
    lines = text.splitlines() or [""]
    for _ in range(rng.randrange(1, 4)):
        k, kind = rng.randrange(len(lines)), rng.randrange(6)
        mark = "," if "," in lines[k] else " "
        cells = lines[k].split(mark)
        cells[rng.randrange(len(cells))] = rng.choice(CELLS)
        replaced = [mark.join(cells)]
        cut = [lines[k][: len(lines[k]) // 2]]
        lines[k : k + 1] = (
            *(replaced, replaced, [lines[k]] * 2, [], [lines[k] + mark + "1"], cut),
        )[kind]
        lines = lines or [""]
    return "\n".join(lines)


def damage_bytes(content: bytes, rng: random.Random) -> bytes:
    """Return bytes that are cut, moved, changed (where something is: HDF5 is mostly empty), or in
    another encoding.
    """
    if not content:
        return b""
    kind, place, length = rng.randrange(8), rng.randrange(len(content)), rng.randrange(41)
    if kind == 0:
        return content[:place]
    if kind == 1:
        return content[:place] + rng.choice(CELLS).encode() + content[place + length :]
    if kind == 2:
        return content[: place + length] + content[place:]
    if kind == 3:
        return content.decode("utf-8", "replace").encode(rng.choice(ENCODINGS), "replace")
    changed = bytearray(content)
    filled = np.flatnonzero(np.frombuffer(content, np.uint8))
    places = filled if kind > 5 and len(filled) else np.arange(len(content))
    for _ in range(rng.randrange(1, 20)):
        at = min(max(int(rng.choice(places)) + rng.randrange(-4, 5), 0), len(content) - 1)
        changed[at] = rng.choice([0, 1, 255, rng.randrange(256)])
    return bytes(changed)


def damage_hdf5(content: bytes, rng: random.Random) -> bytes:
    """Return a store with a dataset of another type, shape or size, or none; or an attribute."""
    store = io.BytesIO(content)
    with h5py.File(store, "r+") as file:
        names: list[str] = []
        file.visit(names.append)
        name = rng.choice(names)
        kind, item = rng.randrange(5), file[name]
        if kind == 0:
            del file[name]
        elif kind == 1 and item.attrs:
            odd = [b"x", 3.5, np.zeros(0), b"(lp0\n.", "json", b"{" * 5000, b"[" * 50_000, np.nan]
            item.attrs[rng.choice(list(item.attrs))] = rng.choice(odd)
        elif isinstance(item, h5py.Dataset):
            _replace_dataset(file, name, kind, rng)
    return store.getvalue()


def _replace_dataset(file: h5py.File, name: str, kind: int, rng: random.Random) -> None:
    value = file[name][...]
    del file[name]
    if kind == 2:
        odd = [np.zeros(0), np.zeros((2, 2)), np.array([b"x"]), np.float64(1), np.zeros(3, "i1")]
        file[name] = rng.choice([*odd, np.full((3, 4, 5, 6), np.nan)])
    elif kind == 3:
        shape = rng.choice([(2**40,), (2**31, 2), (0, 0), (10**5, 10**5)])
        file.create_dataset(name, shape=shape, dtype="f8", chunks=True)
    elif value.dtype.names:
        field = rng.choice(value.dtype.names)
        number = np.array([rng.choice([0, 1, 2, 255, 2**31])])
        value[field] = number.astype(value[field].dtype)
        file[name] = value
    else:
        file[name] = value[: len(value) // 2] if value.ndim else value
