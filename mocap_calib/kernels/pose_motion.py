"""What the joints of a body share of their accelerations, compiled.

`energy.shared_accelerations` says the same in numpy. Points are as in `energy_kernels`.
"""

import math

import numpy as np

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.types import Floats

LANES = 20  # joints of a group, and frames that are looked at side by side
_POINT = 3 * LANES
_TINY = 1e-100  # of an acceleration, as in `energy`


@inlined
def _accelerate(points: Floats, steps: Floats, found: Floats, frame: int, first: int) -> None:
    """Set the accelerations of a group's joints in one of the frames side by side.

    points: of three frames. found: `[joint, 3 * LANES]`. first: the first joint of the group.
    """
    before, now, after = steps[0], steps[1], steps[2]
    for n in range(min(LANES, len(found) - first)):
        for k in range(3):
            m = k * LANES + n
            value = before * points[m] + now * points[_POINT + m] + after * points[2 * _POINT + m]
            found[first + n, k * LANES + frame] = value


@inlined
def _add_weighed(own: Floats, middle: Floats, sums: Floats) -> None:
    """Add a joint's accelerations times weights, and the weights: inverse distances."""
    for n in range(LANES):
        a, b, c = own[n], own[LANES + n], own[2 * LANES + n]
        x, y, z = a - middle[n], b - middle[LANES + n], c - middle[2 * LANES + n]
        weight = 1 / (math.sqrt(x * x + y * y + z * z) + _TINY)
        sums[n] += weight * a
        sums[LANES + n] += weight * b
        sums[2 * LANES + n] += weight * c
        sums[_POINT + n] += weight


@kernel("f8[:,:,::1], f8[:,::1], i8, i8, f8, f8[:,::1]")
def share_accelerations(
    points: Floats, steps: Floats, joints: int, rounds: int, part: float, expected: Floats
) -> None:
    """Set what joints share of the accelerations of frames, in the last three columns.

    points: `[group, frame, 3 * LANES]`. rounds: towards the geometric median, from the mean
    (Weiszfeld 1937). part: of the median, that is expected. expected: `[frame, 5]`; its last two
    frames stay as they are.
    """
    own, middle = np.zeros((joints, _POINT)), np.empty(_POINT)
    sums = np.empty(4 * LANES)
    ends = len(expected) - 2
    for first in range(0, ends, LANES):
        frames = min(LANES, ends - first)
        for f in range(frames):
            t = first + f
            for g in range(len(points)):
                _accelerate(points[g, t : t + 3].reshape(-1), steps[t], own, f, g * LANES)
        middle[:] = 0.0
        for j in range(joints):
            middle += own[j]
        middle /= joints
        for _ in range(rounds):
            sums[:] = 0.0
            for j in range(joints):
                _add_weighed(own[j], middle, sums)
            for n in range(LANES):
                for k in range(3):
                    middle[k * LANES + n] = sums[k * LANES + n] / sums[_POINT + n]
        for f in range(frames):
            for k in range(3):
                expected[first + f, 2 + k] = part * middle[k * LANES + f]
