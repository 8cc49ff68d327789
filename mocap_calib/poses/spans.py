"""Which frames of an individual belong together: gaps that are bridged, and blocks."""

from collections.abc import Iterator

import numpy as np

from mocap_calib.config import PosesConfig
from mocap_calib.types import Bools, Floats, Ints


def time_around(there: Bools, times: Floats) -> Floats:
    """Return times `[2, keypoint, frame]`: since the last that is there, and to the next."""
    last = np.maximum.accumulate(np.where(there, times, -np.inf), axis=1)
    following = np.minimum.accumulate(np.where(there, times, np.inf)[:, ::-1], axis=1)[:, ::-1]
    return np.stack([times - last, following - times])


def with_gaps(there: Ints, times: Floats, longest: int) -> Ints:
    """Return indices of frames, with those of gaps between them that are no longer than this."""
    if not len(there):
        return there
    short = np.diff(times[there]) <= longest + 1
    inside = np.zeros(len(times) + 1, dtype=np.int64)
    np.add.at(inside, there[:-1][short], 1)
    np.add.at(inside, there[1:][short], -1)
    wanted = np.cumsum(inside)[:-1] > 0
    wanted[there] = True
    return np.flatnonzero(wanted)


def blocks(frames: Ints, config: PosesConfig) -> Iterator[tuple[slice, Ints]]:
    """Yield frames to fit at once, and which of them are new there: the others are margins."""
    for start in range(0, len(frames), config.block_frames):
        first = max(start - config.margin_frames, 0)
        last = start + config.block_frames
        own = frames[first : last + config.margin_frames]
        yield slice(start - first, min(last, len(frames)) - first), own
