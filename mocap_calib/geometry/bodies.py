"""Middles and sizes of bodies of which joints are missing."""

import numpy as np

from mocap_calib import mapped
from mocap_calib.types import Floats


def mean_of_known(values: Floats, axis: int) -> Floats:
    """Return the mean over an axis of the values that are not NaN; NaN where there is none."""
    known = np.isfinite(values)
    count = known.sum(axis)
    total = np.where(known, values, 0.0).sum(axis)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def body_size(points: Floats) -> float:
    """Return the RMS distance of joints `[..., keypoint, 3]` from their middle, the median body's.

    Of the bodies that have half of their joints, and three; where there is none, of those that
    have three, or all where joints are fewer. NaN without bodies. A long recording, the first axis,
    is looked at in some of its frames.
    """
    keypoints = points.shape[-2]
    points = mapped.some_frames(points).reshape(-1, keypoints, 3)
    count, size = np.zeros(len(points), dtype=np.int64), np.zeros(len(points))
    for block in mapped.frame_slices(len(points)):
        bodies = points[block]
        count[block] = np.isfinite(bodies[..., 0]).sum(-1)
        square = ((bodies - mean_of_known(bodies, 1)[:, None]) ** 2).sum(-1)
        size[block] = np.sqrt(mean_of_known(square, 1))
    for least in (max(3, keypoints // 2), min(3, keypoints)):
        enough = count >= least
        if enough.any():
            return float(np.median(size[enough]))
    return float("nan")
