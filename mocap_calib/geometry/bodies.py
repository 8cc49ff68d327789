"""Middles and sizes of bodies of which joints are missing."""

import numpy as np

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
    have three, or all where joints are fewer. NaN without bodies.
    """
    keypoints = points.shape[-2]
    count = np.isfinite(points[..., 0]).sum(-1)
    for least in (max(3, keypoints // 2), min(3, keypoints)):
        bodies = points[count >= least]
        if len(bodies):
            square = ((bodies - mean_of_known(bodies, 1)[:, None]) ** 2).sum(-1)
            return float(np.median(np.sqrt(mean_of_known(square, 1))))
    return float("nan")
