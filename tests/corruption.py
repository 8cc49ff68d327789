"""Damage to a file's bytes: what disks, editors and other programs do to files.

`damaged(content, rng)` gives one way of it, by what the file is: a store, a tree, a table or bytes.
"""

import io
import json
import random
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

HDF5 = b"\x89HDF"
ENCODINGS = ["utf-16", "latin-1", "utf-8-sig", "utf-32"]
ODD: list[Any] = [None, True, False, "", "x", "null", "1,5", "NaN", [], {}, [[]], {"a": 1}, 0, -1]
ODD += [1, 2.5, 1e308, -1e308, 10**400, -(10**400), 2**63, -(2**63), float("nan"), float("inf")]
ODD += ["\u0000", "ä", "9" * 5000, "1e999", [1, [2, [3]]], [[1, 2], [3]]]
CELLS = ["", " ", "x", "nan", "inf", "-1", "1e999", "9" * 400, '"', "1;2", "1,5", "\t", "0x10"]
CELLS += ["1_0", "\u0000", "-0", "1e5", "²", "scorer", "x,y", "[", "]", "{", "}", "null", "&a "]
CELLS += ["*a", ": ", "\ufeff", "é", "[" * 3000]


def change_store(path: Path, changes: Mapping[str, object]) -> None:
    """Change `path` or `path@attribute` in HDF5, to a value or by a function; None removes it."""
    with h5py.File(path, "a") as file:
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
