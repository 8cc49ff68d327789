"""Arrays and text as a page takes them: small, exact to the integer, safe within HTML.

Of long recordings as many frames as there is room for: stretches in which frames follow each other.
"""

import base64
import json
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_calib.types import Floats, Ints

MISSING = -32768  # of int16
_LARGEST = 32767
_LEVEL = 6  # of zlib: 9 takes twice the time for 1 %
_MANTISSA_BITS = 12  # of numbers in single precision
_STRETCH = 60  # frames that follow each other, where not all are shown
_LEAST_STRETCHES = 8
_FULL = 0.7  # share of the room that is enough
_FILLINGS = 5  # how often it is tried to fill it


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
    dropped = np.uint32(23 - _MANTISSA_BITS)
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


def choose_frames(total: int, count: int) -> Ints:
    """Return at most `count` of `total` frames (indices): stretches spread evenly over them."""
    if count >= total:
        return np.arange(total)
    if count <= 0:
        return np.zeros(0, dtype=np.int64)
    each = max(1, min(_STRETCH, count // _LEAST_STRETCHES))
    starts = np.linspace(0, total - each, count // each).astype(np.int64)
    return np.unique(starts[:, None] + np.arange(each))


def fill_room(
    pack: Callable[[Ints], dict[str, Any]], total: int, guess: int, room: int
) -> tuple[dict[str, Any], Ints]:
    """Return what was packed of about as many of `total` frames as fit, and their indices.

    pack: of frames `[frame]` (indices); of none it is taken to fit. guess: how many may fit.
    room: bytes that there are.
    """
    count, best = min(total, guess), 0
    packed, index = pack(choose_frames(total, 0)), choose_frames(total, 0)
    for _ in range(_FILLINGS):
        tried_index = choose_frames(total, count)
        tried = pack(tried_index)
        size = packed_size(tried)
        if best < len(tried_index) and size <= room:
            packed, index, best = tried, tried_index, len(tried_index)
        if size <= room and (count >= total or size > _FULL * room):
            break
        count = min(total, int(0.95 * len(tried_index) * room / size))
    return packed, index


def split_evenly(count: int, bins: int) -> Ints:
    """Return the first index of each of at most `bins` bins of `count` things, and `count`."""
    bins = max(1, min(bins, count))
    return np.linspace(0, count, bins + 1).astype(np.int64)


def quantiles(values: Floats, shares: tuple[float, ...]) -> Floats:
    """Return quantiles `[share, ...]` of values `[..., N]` along the last axis, without the NaNs.

    NaN where there is none. One sort for all: `nanpercentile` takes each row by itself.
    """
    ordered = np.sort(values, axis=-1)  # NaN last
    number = np.isfinite(ordered).sum(-1)
    place = np.maximum(number - 1, 0) * np.array(shares).reshape(-1, *[1] * number.ndim)
    low = np.floor(place).astype(np.int64)
    high = np.minimum(low + 1, np.maximum(number - 1, 0))
    part = place - low
    if not ordered.shape[-1]:
        return np.full(place.shape, np.nan)
    below, above = (
        np.take_along_axis(ordered[None], index[..., None], axis=-1)[..., 0]
        for index in (low, high)
    )
    return np.where(part > 0, (1 - part) * below + part * above, below)
