"""Rays of detections in the order of a network's joints."""

import numpy as np

from mocap_calib.types import Floats, Ints


def rays_by_joint(rays: Floats, vocabulary: Ints, joints: int) -> Floats:
    """Return rays `[..., joint, 3]` in the order of a model's joints, NaN where no keypoint is one.

    rays: `[..., keypoint, 3]`; vocabulary: `[keypoint]` index of the model's joint, -1 = none;
    joints: how many the model has.
    """
    known = vocabulary >= 0
    ordered = np.full((*rays.shape[:-2], joints, 3), np.nan)
    ordered[..., vocabulary[known], :] = rays[..., known, :]
    return ordered
