"""Arrays and text as a page takes them: small, exact to the integer, safe within HTML."""

import base64
import json
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_calib.html_report.config import ReportConfig
from mocap_calib.types import Floats, Ints

MISSING = -32768  # of int16
_LARGEST = 32767
_LEVEL = 6  # of zlib: 9 takes twice the time for 1 %
_CONFIG = ReportConfig()


def pack(values: NDArray[Any], delta: int | None = None) -> dict[str, Any]:
    """Return an array as JSON: base64 of zlib, the bytes in planes (see web/src/data.d.ts).

    delta: the axis along which integers are stored as differences, which wrap round.
    """
    array = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
    kind = array.dtype.name
    if delta is not None and array.size:
        unsigned = array.view(array.dtype.str.replace("i", "u"))
        first = np.take(unsigned, [0], axis=delta)
        array = np.ascontiguousarray(
            np.concatenate([first, np.diff(unsigned, axis=delta)], axis=delta)
        )
    planes = array.reshape(-1, 1).view(np.uint8).T.tobytes()
    return {
        "dtype": kind,
        "shape": list(values.shape),
        "delta": delta,
        "data": _encode(planes) if planes else "",
    }


def pack_text(text: str) -> dict[str, str]:
    """Return text as JSON: base64 of zlib."""
    return {"text": _encode(text.encode())}


def pack_floats(values: Floats) -> dict[str, Any]:
    """Return numbers in single precision, of which the first four digits count."""
    bits = np.ascontiguousarray(values, dtype=np.float32).view(np.uint32)
    dropped = np.uint32(23 - _CONFIG.mantissa_bits)
    half = np.uint32(1) << (dropped - np.uint32(1))
    rounded = ((bits + half) >> dropped) << dropped
    single = rounded.view(np.float32)
    return pack(np.where(np.isfinite(values), single, np.float32(np.nan)))


def quantise(values: Floats, scale: float) -> NDArray[np.int16]:
    """Return numbers in steps of `scale`; `MISSING` where they are NaN or too large."""
    with np.errstate(invalid="ignore"):
        steps = np.rint(values / scale)
    inside = np.abs(steps) <= _LARGEST  # never of NaN
    return np.where(inside, steps, MISSING).astype(np.int16)


def small_ints(values: Ints) -> NDArray[np.int32]:
    """Return whole numbers in 32 bits; what is larger becomes the largest."""
    limit = np.iinfo(np.int32).max
    return values.clip(-limit, limit).astype(np.int32)


def packed_size(packed: Any) -> int:
    """Return how many bytes JSON that was packed takes in a page."""
    return len(to_script(packed))


def to_script(data: Any) -> str:
    """Return data as JSON that can stand in a <script> of a page: no name can end it."""
    text = json.dumps(data, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    for letter in "<>&":
        text = text.replace(letter, f"\\u{ord(letter):04x}")
    return text


def _encode(content: bytes) -> str:
    return base64.b64encode(zlib.compress(content, _LEVEL)).decode("ascii")
