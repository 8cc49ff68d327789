"""Damage to a file's bytes, as a strategy: what disks, editors and other programs do to files.

`corrupted(content)` gives one way of it; `complaint(call)` runs a reader on it and returns the one
line it refuses with, or "" where it reads the file. Anything else it raises is the reader's fault,
and so is a hang (the deadline of the test).
"""

import re
from collections.abc import Callable

from hypothesis import strategies as st

from mocap_calib.errors import MocapCalibError

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


@st.composite
def corrupted(draw: st.DrawFn, content: bytes) -> bytes:
    """One damage: cut, a piece replaced, doubled or moved, a number replaced, bits flipped, another
    encoding.
    """
    place, length = draw(st.integers(0, max(len(content) - 1, 0))), draw(st.integers(0, 40))
    lines = content.splitlines(keepends=True) or [b""]
    k = place % len(lines)
    damages = {
        "cut": lambda: content[:place],
        "replace": lambda: (
            content[:place] + draw(st.sampled_from(JUNK)).encode() + content[place + length :]
        ),
        "double": lambda: content[: place + length] + content[place:],
        "number": lambda: _replaced(draw, content),
        "flip": lambda: (
            content[:place]
            + bytes([content[place] ^ draw(st.integers(1, 255))])
            + content[place + 1 :]
        ),
        "encode": lambda: content.decode("utf-8", "replace").encode(
            draw(st.sampled_from(ENCODINGS)), "replace"
        ),
        "remove line": lambda: b"".join(lines[:k] + lines[k + 1 :]),
        "repeat line": lambda: b"".join(lines[: k + 1] + lines[k:]),
    }
    return damages[draw(st.sampled_from(sorted(damages)))]() if content else b""


def _replaced(draw: st.DrawFn, content: bytes) -> bytes:
    """One number, replaced by what is none or cannot be."""
    numbers = list(_NUMBER.finditer(content))
    if not numbers:
        return content
    hit = numbers[draw(st.integers(0, len(numbers) - 1))]
    return content[: hit.start()] + draw(st.sampled_from(JUNK)).encode() + content[hit.end() :]


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
