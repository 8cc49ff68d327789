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
def _add_distances(own: Floats, middle: Floats, total: Floats) -> None:
    """Add the distances `[LANES]` of a joint's accelerations from their middles."""
    for n in range(LANES):
        x, y = own[n] - middle[n], own[LANES + n] - middle[LANES + n]
        z = own[2 * LANES + n] - middle[2 * LANES + n]
        total[n] += math.sqrt(x * x + y * y + z * z)


@inlined
def _add_weighed(own: Floats, middle: Floats, added: Floats, sums: Floats) -> None:
    """Add a joint's accelerations times weights, and the weights: inverse distances."""
    for n in range(LANES):
        a, b, c = own[n], own[LANES + n], own[2 * LANES + n]
        x, y, z = a - middle[n], b - middle[LANES + n], c - middle[2 * LANES + n]
        weight = 1 / (math.sqrt(x * x + y * y + z * z) + added[n])
        sums[n] += weight * a
        sums[LANES + n] += weight * b
        sums[2 * LANES + n] += weight * c
        sums[_POINT + n] += weight


@kernel("f8[:,:,::1], f8[:,::1], i8, i8, f8, f8, f8[:,::1]")
def share_accelerations(
    points: Floats,
    steps: Floats,
    joints: int,
    rounds: int,
    least: float,
    part: float,
    expected: Floats,
) -> None:
    """Set what joints share of the accelerations of frames, in the last three columns.

    points: `[group, frame, 3 * LANES]`. rounds: towards the middle, from the mean. least: what is
    added to each distance, in mean distances. part: of the middle, that is expected. expected:
    `[frame, 5]`; its last two frames stay as they are.
    """
    own, middle = np.zeros((joints, _POINT)), np.empty(_POINT)
    sums, usual, added = np.empty(4 * LANES), np.empty(LANES), np.empty(LANES)
    ends = len(expected) - 2
    for first in range(0, ends, LANES):
        frames = min(LANES, ends - first)
        for f in range(frames):
            t = first + f
            for g in range(len(points)):
                _accelerate(points[g, t : t + 3].reshape(-1), steps[t], own, f, g * LANES)
        middle[:], usual[:] = 0.0, 0.0
        for j in range(joints):
            middle += own[j]
        middle /= joints
        for j in range(joints):
            _add_distances(own[j], middle, usual)
        usual /= joints
        for _ in range(rounds):
            sums[:] = 0.0
            for n in range(LANES):
                added[n] = least * usual[n] + _TINY
            for j in range(joints):
                _add_weighed(own[j], middle, added, sums)
            for n in range(LANES):
                weight = sums[_POINT + n]
                usual[n] = joints / weight
                for k in range(3):
                    middle[k * LANES + n] = sums[k * LANES + n] / weight
        for f in range(frames):
            for k in range(3):
                expected[first + f, 2 + k] = part * middle[k * LANES + f]
