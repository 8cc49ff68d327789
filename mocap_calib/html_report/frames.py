"""Which frames of a long recording a report shows: stretches in which frames follow each other."""

from collections.abc import Callable
from typing import Any

import numpy as np

from mocap_calib.html_report.config import ReportConfig
from mocap_calib.html_report.encode import packed_size
from mocap_calib.types import Floats, Ints

_CONFIG = ReportConfig()


def choose_frames(total: int, count: int) -> Ints:
    """Return at most `count` of `total` frames (indices): stretches spread evenly over them."""
    if count >= total:
        return np.arange(total)
    if count <= 0:
        return np.zeros(0, dtype=np.int64)
    each = max(1, min(_CONFIG.stretch, count // _CONFIG.least_stretches))
    starts = np.linspace(0, total - each, count // each).astype(np.int64)
    return np.unique(starts[:, None] + np.arange(each))


def starts_of_stretches(index: Ints) -> list[int]:
    """Return where in `index` `[frame]` stretches of consecutive indices begin."""
    if not len(index):
        return []
    return [0, *(np.flatnonzero(np.diff(index) > 1) + 1).tolist()]


def fill_room(
    pack: Callable[[Ints], dict[str, Any]], total: int, guess: int, room: int
) -> tuple[dict[str, Any], Ints]:
    """Return what was packed of about as many of `total` frames as fit, and their indices.

    pack: of frames `[frame]` (indices); of none it is taken to fit. guess: how many may fit.
    room: bytes that there are.
    """
    count, best = min(total, guess), 0
    packed, index = pack(choose_frames(total, 0)), choose_frames(total, 0)
    for _ in range(_CONFIG.fillings):
        tried_index = choose_frames(total, count)
        tried = pack(tried_index)
        size = packed_size(tried)
        if best < len(tried_index) and size <= room:
            packed, index, best = tried, tried_index, len(tried_index)
        if size <= room and (count >= total or size > _CONFIG.full * room):
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
