"""How far detections of neighbouring frames are apart, compiled: `tracklets` says it in numpy."""

import math

import numpy as np

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.types import Floats


@inlined
def _squared_gap(before: Floats, after: Floats, least_joints: int) -> float:
    """Return the mean squared distance of the joints that two detections `[keypoint, 2]` have."""
    total, common = 0.0, 0
    for k in range(len(before)):
        x, y = before[k, 0] - after[k, 0], before[k, 1] - after[k, 1]
        square = x * x + y * y
        if not math.isnan(square):
            total += square
            common += 1
    return total / common if common >= max(least_joints, 1) else np.inf


@inlined
def _squared_extent(joints: Floats) -> float:
    """Return the mean squared distance of joints `[keypoint, 2]` from their middle."""
    x = y = square = 0.0
    count = 0
    for k in range(len(joints)):
        if not math.isnan(joints[k, 0]):
            x += joints[k, 0]
            y += joints[k, 1]
            count += 1
    if count == 0:
        return 0.0
    x, y = x / count, y / count
    for k in range(len(joints)):
        if not math.isnan(joints[k, 0]):
            square += (joints[k, 0] - x) ** 2 + (joints[k, 1] - y) ** 2
    return square / count


@kernel("f8[:,:,:,::1], i8, f8, f8[:,:,::1]")
def squared_gaps(positions: Floats, least_joints: int, step: float, gaps: Floats) -> None:
    """Set `[frame - 1, I, J]` the squared gaps of detections to those of the next frame.

    Infinite where they have too few joints in common or are farther apart than a step allows.

    positions: `[frame, instance, keypoint, 2]` pixels, NaN = missing. step: in extents of the
    earlier detection.
    """
    for frame in range(len(gaps)):
        for i in range(gaps.shape[1]):
            allowed = step**2 * _squared_extent(positions[frame, i])
            for j in range(gaps.shape[2]):
                gap = _squared_gap(positions[frame, i], positions[frame + 1, j], least_joints)
                gaps[frame, i, j] = gap if gap < allowed else np.inf
