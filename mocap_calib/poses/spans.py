"""Which frames of an individual belong together: gaps that are bridged, what fills them, blocks."""

from collections.abc import Iterator

import numpy as np

from mocap_calib.config import PosesConfig
from mocap_calib.poses.track import Detections
from mocap_calib.types import POINT_SOURCES, Bools, Floats, Ints

_TRIANGULATED = POINT_SOURCES.index("triangulated")
_ONE_VIEW = POINT_SOURCES.index("one view")
_INTERPOLATED = POINT_SOURCES.index("interpolated")


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


def point_sources(seen: Detections, met: Bools, times: Floats, longest: int) -> Ints:
    """Return what points are made of, `[keypoint, frame]`, 0 = missing.

    met: `[keypoint, frame]` whether there is a point that was started from. longest: gap that is
    bridged, and distance from a triangulated point up to which one view will do: along its ray a
    point may be at either of two places. Below 0 neither is.
    """
    views = (seen.precision > 0).sum(0)
    firm = met & (views >= 2)
    gap = time_around(views > 0, times)
    source = np.where(gap.sum(0) <= longest + 1, _INTERPOLATED, 0)
    near = time_around(firm, times).min(0) <= longest
    source = np.where(views > 0, np.where(near, _ONE_VIEW, 0), source)
    return np.where(firm, _TRIANGULATED, source)


def blocks(frames: Ints, config: PosesConfig) -> Iterator[tuple[slice, Ints]]:
    """Yield frames to fit at once, and which of them are new there: the others are margins."""
    for start in range(0, len(frames), config.block_frames):
        first = max(start - config.margin_frames, 0)
        last = start + config.block_frames
        own = frames[first : last + config.margin_frames]
        yield slice(start - first, min(last, len(frames)) - first), own
