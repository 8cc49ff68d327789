"""What the joints of a body share of their accelerations, compiled.

`energy.shared_accelerations` says the same in numpy. Points are as in `energy_kernels`.
"""

import math

import numpy as np

from mocap_calib.compute.jit import INT, changed_floats, floats, inlined, kernel
from mocap_calib.types import Floats

LANES = 16


@inlined
def _accelerate(points: Floats, steps: Floats, own: Floats) -> None:
    """Set the accelerations `[3 * LANES]` of a group of joints, from points of three frames."""
    first, second, third = steps[0], steps[1], steps[2]
    for n in range(3 * LANES):
        own[n] = first * points[n] + second * points[3 * LANES + n] + third * points[6 * LANES + n]


@inlined
def _measure_distances(own: Floats, there: Floats, middle: Floats, off: Floats) -> float:
    """Set the distances `[LANES]` of a group's accelerations from a middle; return their sum."""
    for n in range(LANES):
        x, y, z = own[n] - middle[0], own[LANES + n] - middle[1], own[2 * LANES + n] - middle[2]
        off[n] = math.sqrt(x * x + y * y + z * z)
    total = 0.0
    for n in range(LANES):
        total += there[n] * off[n]
    return total


@inlined
def _add_weighed(own: Floats, there: Floats, off: Floats, least: float, sums: Floats) -> None:
    """Add accelerations of a group, by their inverse distances, and these weights."""
    for n in range(LANES):
        weight = there[n] / (off[n] + least)
        sums[n] += weight * own[n]
        sums[LANES + n] += weight * own[LANES + n]
        sums[2 * LANES + n] += weight * own[2 * LANES + n]
        sums[3 * LANES + n] += weight


@kernel(floats(3), floats(2), floats(2), INT, floats(1), changed_floats(2))
def share_accelerations(
    points: Floats, steps: Floats, there: Floats, rounds: int, shares: Floats, expected: Floats
) -> None:
    """Set what joints share of the accelerations of frames, in the last three columns.

    points: `[group, frame, 3 * LANES]`. there: `[group, LANES]` 1 for a joint, 0 for none. rounds:
    towards the middle, from the mean. shares: which of the mean distance is added to each, and of
    the middle is expected; and a tiny distance. expected: `[frame, 5]`; its last two frames stay as
    they are.
    """
    groups, joints = len(points), there.sum()
    own, off = np.empty((groups, 3 * LANES)), np.empty((groups, LANES))
    sums, middle = np.empty((4, LANES)), np.empty(3)
    for t in range(len(expected) - 2):
        middle[:] = 0.0
        for g in range(groups):
            _accelerate(points[g, t : t + 3].reshape(-1), steps[t], own[g])
            for k in range(3):
                for n in range(LANES):
                    middle[k] += there[g, n] * own[g, k * LANES + n] / joints
        for _ in range(rounds):
            total = 0.0
            for g in range(groups):
                total += _measure_distances(own[g], there[g], middle, off[g])
            least = shares[0] * total / joints + shares[2]
            sums[:] = 0.0
            for g in range(groups):
                _add_weighed(own[g], there[g], off[g], least, sums.reshape(-1))
            weight = sums[3].sum()
            for k in range(3):
                middle[k] = sums[k].sum() / weight
        for k in range(3):
            expected[t, 2 + k] = shares[1] * middle[k]
