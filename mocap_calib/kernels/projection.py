"""What detections cost under a projection, compiled: `projection_search` says the same in numpy."""

import numpy as np

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.types import Floats

_MISSING, _AHEAD, _BEHIND = 0.0, 1.0, 2.0


@inlined
def _project(points: Floats, projection: Floats, seen: Floats) -> None:
    """Set `[3, keypoint]` where points `[keypoint, 3]` are seen, and on which side they are."""
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        for row in range(3):
            seen[row, k] = (
                projection[row, 0] * x
                + projection[row, 1] * y
                + projection[row, 2] * z
                + projection[row, 3]
            )
        depth = seen[2, k]
        ahead = depth > 0
        by = depth if ahead else 1.0
        seen[0, k] /= by
        seen[1, k] /= by
        seen[2, k] = _MISSING if np.isnan(x) else _AHEAD if ahead else _BEHIND


@inlined
def _mean_cost(image: Floats, seen: Floats, square_tolerance: float, least: int) -> float:
    """Return the mean cost of the joints that are known of a detection and a body, 1 of too few."""
    count, total = 0, 0.0
    for k in range(len(image)):
        if seen[2, k] == _MISSING or np.isnan(image[k, 0]):
            continue
        count += 1
        if seen[2, k] == _BEHIND:
            total += 1.0
            continue
        across, down = image[k, 0] - seen[0, k], image[k, 1] - seen[1, k]
        square = (across * across + down * down) / square_tolerance
        total += square / (1 + square)
    return total / count if count >= least else 1.0


@kernel("f8[:,:,:,::1], f8[:,:,:,::1], f8[:,::1], f8, i8, f8[:,:,::1]")
def cost_detections(
    points: Floats,
    image: Floats,
    projection: Floats,
    square_tolerance: float,
    least: int,
    cost: Floats,
) -> None:
    """Set the costs `[frame, instance, individual]`.

    points: `[frame, individual, keypoint, 3]`; image: `[frame, instance, keypoint, 2]`; NaN =
    missing. projection: `[3, 4]`. least: joints that are compared.
    """
    frames, individuals, joints, _ = points.shape
    seen = np.empty((3, joints))
    for frame in range(frames):
        for individual in range(individuals):
            _project(points[frame, individual], projection, seen)
            for instance in range(image.shape[1]):
                cost[frame, instance, individual] = _mean_cost(
                    image[frame, instance], seen, square_tolerance, least
                )
