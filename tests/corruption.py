"""Damage to a file's bytes: what disks, editors and other programs do to files.

`damaged(content, rng)` gives one way of it, by what the file is. `complaint(call)` runs a reader on
it and returns the one line it refuses with, or "" where it reads the file. Anything else it raises
is the reader's fault.
"""

import io
import json
import random
import re
from collections.abc import Callable
from typing import Any

import h5py
import numpy as np

from mocap_calib.errors import MocapCalibError

HDF5 = b"\x89HDF"
JUNK = [
    "",
    "null",
    "[",
    "]",
    "{",
    "}",
    '"',
    "nan",
    "inf",
    "-1",
    "1e999",
    "-1e308",
    "9" * 5000,
    "0",
    "true",
    "&a ",
    "*a",
    ": ",
    ",",
    "\n",
    "\t",
]
JUNK += ["\ufeff", "\x00", "é", "[" * 3000]
ENCODINGS = ["utf-16", "latin-1", "utf-8-sig", "utf-32"]
_NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?")


ODD = [
    *(
        None,
        True,
        False,
        "",
        "x",
        "null",
        "1,5",
        "NaN",
        [],
        {},
        [[]],
        {"a": 1},
        0,
        -1,
        1,
        2.5,
        1e308,
        -1e308,
        10**400,
        -(10**400),
    ),
    *(
        2**63,
        -(2**63),
        float("nan"),
        float("inf"),
        -float("inf"),
        "\u0000",
        "ä",
        "9" * 5000,
        "1e999",
        [1, [2, [3]]],
        [[1, 2], [3]],
    ),
]
CELLS = [
    "",
    " ",
    "x",
    "nan",
    "inf",
    "-1",
    "1e999",
    "9" * 400,
    '"',
    "1;2",
    "1,5",
    "\t",
    "0x10",
    "1_0",
    "\u0000",
    "-0",
    "1e5",
    "²",
    "scorer",
    "x,y",
]


def scramble(content: bytes, rng: random.Random) -> bytes:
    """One damage: cut, a piece replaced, doubled or moved, a number replaced, bits flipped, another
    encoding.
    """
    if not content:
        return b""
    place, length = rng.randrange(len(content)), rng.randrange(41)
    lines = content.splitlines(keepends=True)
    k = place % len(lines)
    junk = rng.choice(JUNK).encode()
    damages = (
        lambda: content[:place],
        lambda: content[:place] + junk + content[place + length :],
        lambda: content[: place + length] + content[place:],
        lambda: _with_a_number_replaced(content, junk, rng),
        lambda: (
            content[:place] + bytes([content[place] ^ rng.randrange(1, 256)]) + content[place + 1 :]
        ),
        lambda: content.decode("utf-8", "replace").encode(rng.choice(ENCODINGS), "replace"),
        lambda: b"".join(lines[:k] + lines[k + 1 :]),
        lambda: b"".join(lines[: k + 1] + lines[k:]),
    )
    return rng.choice(damages)()


def _with_a_number_replaced(content: bytes, junk: bytes, rng: random.Random) -> bytes:
    """One number, replaced by what is none or cannot be."""
    numbers = list(_NUMBER.finditer(content))
    if not numbers:
        return content
    hit = rng.choice(numbers)
    return content[: hit.start()] + junk + content[hit.end() :]


def damaged(content: bytes, rng: random.Random) -> bytes:
    """The content, damaged by what it is: a store, a tree, a table, text or bytes."""
    share = rng.random()
    if share < 0.25:
        return damage_bytes(content, rng)
    if content.startswith(HDF5):
        return damage_hdf5(content, rng)
    if share < 0.5:
        return scramble(content, rng)
    try:
        if content.startswith(b"{"):
            return damage_json(json.loads(content), rng).encode("utf-8", "surrogatepass")
        return damage_text(content.decode(), rng).encode()
    except UnicodeDecodeError:
        return scramble(content, rng)


def damage_json(value: Any, rng: random.Random) -> str:
    """The value with a few of its nodes replaced, doubled, cut or gone; now and then in a very deep
    list.
    """
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
    """Cells replaced, rows doubled, cut, joined or in another order."""
    lines = text.splitlines() or [""]
    for _ in range(rng.randrange(1, 4)):
        k, kind = rng.randrange(len(lines)), rng.randrange(6)
        mark = "," if "," in lines[k] else " "
        cells = lines[k].split(mark)
        cells[rng.randrange(len(cells))] = rng.choice(CELLS)
        changed = {
            0: [mark.join(cells)],
            1: [mark.join(cells)],
            2: [lines[k]] * 2,
            3: [],
            4: [lines[k] + mark + "1"],
            5: [lines[k][: len(lines[k]) // 2]],
        }
        lines[k : k + 1] = changed[kind]
        lines = lines or [""]
    return "\n".join(lines)


def damage_bytes(content: bytes, rng: random.Random) -> bytes:
    """Cut, bytes changed, anywhere or where something stands (HDF5 is mostly empty), another
    encoding, a mark of byte order.
    """
    if not content:
        return b""
    kind = rng.randrange(8)
    if kind == 0:
        return content[: rng.randrange(len(content) + 1)]
    if kind == 1:
        return b"\xef\xbb\xbf" + content
    if kind == 2:
        return content.decode("latin-1").encode("utf-16")
    changed = bytearray(content)
    places = (
        np.flatnonzero(np.frombuffer(content, np.uint8)) if kind > 5 else np.arange(len(content))
    )
    for _ in range(rng.randrange(1, 20) if len(places) else 0):
        changed[min(int(rng.choice(places)) + rng.randrange(-4, 5), len(content) - 1)] = rng.choice(
            [0, 1, 255, rng.randrange(256)]
        )
    return bytes(changed)


def damage_hdf5(content: bytes, rng: random.Random) -> bytes:
    """A dataset of another type, shape or size, or none; an attribute changed."""
    store = io.BytesIO(content)
    with h5py.File(store, "r+") as file:
        names: list[str] = []
        file.visit(names.append)
        name = rng.choice(names)
        kind, item = rng.randrange(5), file[name]
        if kind == 0:
            del file[name]
        elif kind == 1 and item.attrs:
            attribute = rng.choice(list(item.attrs))
            item.attrs[attribute] = rng.choice(
                [b"x", 3.5, np.zeros(0), b"(lp0\n.", "json", b"{" * 5000, b"[" * 50_000, np.nan]
            )
        elif isinstance(item, h5py.Dataset):
            value = item[...]
            del file[name]
            if kind == 2:
                file[name] = rng.choice(
                    [
                        np.zeros(0),
                        np.zeros((2, 2)),
                        np.array([b"x"]),
                        np.float64(1),
                        np.full((3, 4, 5, 6), np.nan),
                        np.zeros(3, "i1"),
                    ]
                )
            elif kind == 3:
                file.create_dataset(
                    name,
                    shape=rng.choice([(2**40,), (2**31, 2), (0, 0), (10**5, 10**5)]),
                    dtype="f8",
                    chunks=True,
                )
            elif value.dtype.names:
                field = rng.choice(value.dtype.names)
                value[field] = np.array([rng.choice([0, 1, 2, 255, 2**31])]).astype(
                    value[field].dtype
                )
                file[name] = value
            else:
                file[name] = value[: len(value) // 2] if value.ndim else value
    return store.getvalue()


def complaint(call: Callable[[], object]) -> str:
    """The one line that a reader refuses with; "" where it reads."""
    try:
        call()
    except MocapCalibError as error:
        message = str(error)
        assert "\n" not in message, message
        assert message, "a complaint says something"
        return message
    return ""
