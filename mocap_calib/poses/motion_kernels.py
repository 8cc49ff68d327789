"""What the joints of a body share of their accelerations, compiled.

`energy.shared_accelerations` says the same in numpy. Points are as in `energy_kernels`.
"""

import math

import numpy as np

from mocap_calib.compute.jit import FLOAT, INT, changed_floats, floats, inlined, kernel
from mocap_calib.types import Floats

LANES = 20
_POINT = 3 * LANES
_TINY = 1e-100  # of an acceleration, as in `energy`


@inlined
def _total(row: Floats) -> float:
    """Return the sum of a row `[LANES]`, which is overwritten; four numbers at a time."""
    for k in range(4, LANES, 4):
        for n in range(4):
            row[n] += row[k + n]
    return (row[0] + row[2]) + (row[1] + row[3])


@inlined
def _add_accelerations(
    points: Floats, steps: Floats, there: Floats, own: Floats, sums: Floats
) -> None:
    """Set the accelerations `[3 * LANES]` of a group of joints, and add those of joints to sums.

    points: of three frames.
    """
    first, second, third = steps[0], steps[1], steps[2]
    for n in range(_POINT):
        own[n] = first * points[n] + second * points[_POINT + n] + third * points[2 * _POINT + n]
    for k in range(3):
        for n in range(LANES):
            sums[k * LANES + n] += there[n] * own[k * LANES + n]


@inlined
def _add_distances(own: Floats, there: Floats, middle: Floats, off: Floats, total: Floats) -> None:
    """Set the distances `[LANES]` of a group's accelerations from a middle; add those of joints."""
    middle_x, middle_y, middle_z = middle[0], middle[1], middle[2]
    for n in range(LANES):
        x, y, z = own[n] - middle_x, own[LANES + n] - middle_y, own[2 * LANES + n] - middle_z
        off[n] = math.sqrt(x * x + y * y + z * z)
        total[n] += there[n] * off[n]


@inlined
def _add_weighed(own: Floats, there: Floats, off: Floats, added: float, sums: Floats) -> None:
    """Add accelerations of a group times weights, and the weights: inverse distances."""
    for n in range(LANES):
        weight = there[n] / (off[n] + added)
        sums[n] += weight * own[n]
        sums[LANES + n] += weight * own[LANES + n]
        sums[2 * LANES + n] += weight * own[2 * LANES + n]
        sums[_POINT + n] += weight


@kernel(floats(3), floats(2), floats(2), INT, FLOAT, FLOAT, changed_floats(2))
def share_accelerations(
    points: Floats,
    steps: Floats,
    there: Floats,
    rounds: int,
    least: float,
    part: float,
    expected: Floats,
) -> None:
    """Set what joints share of the accelerations of frames, in the last three columns.

    points: `[group, frame, 3 * LANES]`. there: `[group, LANES]` 1 for a joint, 0 for none. rounds:
    towards the middle, from the mean. least: what is added to each distance, in mean distances.
    part: of the middle, that is expected. expected: `[frame, 5]`; its last two frames stay as they
    are.
    """
    groups, joints = len(points), there.sum()
    own, off = np.empty((groups, _POINT)), np.empty((groups, LANES))
    sums, middle = np.empty((4, LANES)), np.empty(3)
    for t in range(len(expected) - 2):
        sums[:] = 0.0
        for g in range(groups):
            three = points[g, t : t + 3].reshape(-1)
            _add_accelerations(three, steps[t], there[g], own[g], sums.reshape(-1))
        for k in range(3):
            middle[k] = _total(sums[k]) / joints
        usual = -1.0
        for _ in range(rounds):
            sums[:] = 0.0
            for g in range(groups):
                _add_distances(own[g], there[g], middle, off[g], sums[3])
            if usual < 0:
                usual = _total(sums[3]) / joints
            added = least * usual + _TINY
            sums[:] = 0.0
            for g in range(groups):
                _add_weighed(own[g], there[g], off[g], added, sums.reshape(-1))
            weight = _total(sums[3])
            for k in range(3):
                middle[k] = _total(sums[k]) / weight
            usual = joints / weight
        for k in range(3):
            expected[t, 2 + k] = part * middle[k]
