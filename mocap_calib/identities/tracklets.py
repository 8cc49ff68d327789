"""Follow detections through each view by their motion in the image.

Many frames tell who one is that a single frame does not. Tracks that the input names are not
needed for this and not believed: where they are exchanged the image jumps, and what jumps is not
followed.
"""

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import MatchingConfig
from mocap_calib.geometry.graphs import connected_parts
from mocap_calib.kernels.loading import contiguous
from mocap_calib.kernels.tracklets import squared_gaps
from mocap_calib.types import Bools, Floats, Ints, Reals, Recording

_FRAMES = 512  # linked at a time


def all_tracklets(recording: Recording, config: MatchingConfig) -> Ints:
    """Return the `tracklets` of all views, `[view, frame, instance]`."""
    found = mapped.empty(recording.positions.shape[:3], np.int64)
    views = list(range(len(found)))
    parts = map_in_threads(lambda view: tracklets(recording, view, config), views)
    for view, part in zip(views, parts, strict=True):
        found[view] = part
    return found


def tracklets(recording: Recording, view: int, config: MatchingConfig) -> Ints:
    """Return the number of the tracklet of each detection of a view.

    Detections of neighbouring frames are linked that are each other's nearest and near for their
    size. Returns `[frame, instance]`, -1 where there is no detection.
    """
    positions = recording.positions[view]
    frames, instances = positions.shape[:2]
    linked = _links(positions, config)
    linked &= (np.diff(recording.frames) == 1)[:, None, None]
    earlier, later = np.divmod(np.flatnonzero(linked), instances)
    later += (earlier // instances + 1) * instances
    del linked

    number = connected_parts(earlier, later, frames * instances)
    detected = mapped.in_blocks(lambda block: np.isfinite(positions[block, ..., 0]).any(-1), frames)
    return np.where(detected, number.reshape(frames, instances), -1)


def _links(positions: Reals, config: MatchingConfig) -> Bools:
    """Return `[frame - 1, instance, instance]` which detection goes on as which of the next frame.

    positions: `[frame, instance, keypoint, 2]` pixels.
    """
    frames, instances = positions.shape[:2]
    blocks = [
        _links_in_block(positions[block.start : block.stop + 1], config)
        for block in mapped.frame_slices(frames - 1, _FRAMES)
    ]
    nothing = np.zeros((0, instances, instances), dtype=bool)
    return np.concatenate([nothing, *blocks])


def _links_in_block(positions: Reals, config: MatchingConfig) -> Bools:
    """Return the links of `_links` in one block of frames."""
    gap2 = _squared_gaps(positions.astype(np.float64), config)
    nearest_later = gap2 == gap2.min(-1, keepdims=True)
    nearest_earlier = gap2 == gap2.min(-2, keepdims=True)
    return nearest_later & nearest_earlier & np.isfinite(gap2)


def _squared_gaps(positions: Floats, config: MatchingConfig) -> Floats:
    """Return how far the detections of each frame are from those of the next.

    positions: `[frame, instance, keypoint, 2]` pixels. Returns `[frame - 1, I, J]` the mean squared
    distance of the joints that both have; infinite where these are too few, and where it is more
    than `config.tracklet_step` allows for the mean squared distance of the earlier's joints from
    their middle.
    """
    frames, instances = positions.shape[:2]
    gaps = np.empty((frames - 1, instances, instances))
    squared_gaps(*contiguous(positions), config.tracklet_joints, config.tracklet_step, gaps)
    return gaps
