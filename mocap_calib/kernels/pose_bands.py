"""Accelerations of the points of a fit, and the banded normal equations with them, factored.

Rows are as in `pose_energy`. The bands of the joints are
factored in blocks of a frame: S[t] = A[t] - c[t]^2 P[t-2] - F[t] P[t-1] F[t]', where P = S^-1, c
couples t with t-2, and F[t] = b[t] - c[t] P[t-2] F[t-1]' with t-1.
"""

import math

import numpy as np

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.kernels.pose_energy import LANES
from mocap_calib.types import Floats

_POINT = 3 * LANES  # numbers of a group in a frame: coordinates,
_MOTION = 4 * LANES  # weights of accelerations, and these times them,
_FACTOR = 16 * LANES  # P, F and c
_TINY = 1e-100  # of an acceleration


@inlined
def _weigh_motion(
    points: Floats, steps: Floats, expected: Floats, narrow: float, motion: Floats
) -> None:
    """Set the weights of accelerations and these times them, from points of three frames."""
    first, second, third, own = steps[0], steps[1], steps[2], expected[0]
    shared_x, shared_y, shared_z = expected[2], expected[3], expected[4]
    for n in range(LANES):
        x = first * points[n] + second * points[_POINT + n] + third * points[2 * _POINT + n]
        m = n + LANES
        y = first * points[m] + second * points[_POINT + m] + third * points[2 * _POINT + m]
        m = n + 2 * LANES
        z = first * points[m] + second * points[_POINT + m] + third * points[2 * _POINT + m]
        x, y, z = x - shared_x, y - shared_y, z - shared_z
        pull = own / (1 + (x * x + y * y + z * z) * own * narrow)
        motion[n], motion[LANES + n] = pull, pull * x
        motion[2 * LANES + n], motion[3 * LANES + n] = pull * y, pull * z


@inlined
def _add_motion(
    motion: Floats, steps: Floats, ridge: float, own: Floats, push: Floats, link: Floats
) -> None:
    """Add the accelerations of three frames to the last; set its links to the ones before.

    motion: of the three frames. steps: `[3, 3]` by frame. own: its blocks. push: its gradient.
    link: b and c.
    """
    in_last, in_middle, in_first = steps[0, 2], steps[1, 1], steps[2, 0]
    at_middle, at_end = steps[0, 1], steps[1, 0]
    at_start = steps[0, 0]
    for n in range(LANES):
        last, middle, first = motion[n], motion[_MOTION + n], motion[2 * _MOTION + n]
        same = last * in_last * in_last + middle * in_middle * in_middle
        same = same + first * in_first * in_first + ridge
        own[n] += same
        own[3 * LANES + n] += same
        own[5 * LANES + n] += same
        link[n] = last * at_middle * in_last + middle * at_end * in_middle
        link[LANES + n] = last * at_start * in_last
    for n in range(_POINT):
        m = LANES + n
        own_push = in_last * motion[m] + in_middle * motion[_MOTION + m]
        push[n] += own_push + in_first * motion[2 * _MOTION + m]


@inlined
def _link_frames(link: Floats, factor: Floats) -> None:
    """Set F and c of the last of three frames."""
    now = 2 * _FACTOR
    for n in range(LANES):
        b, c = link[n], link[LANES + n]
        xx, xy, xz = factor[n], factor[LANES + n], factor[2 * LANES + n]
        yy, yz, zz = factor[3 * LANES + n], factor[4 * LANES + n], factor[5 * LANES + n]
        xx, xy, xz, yy, yz, zz = -c * xx, -c * xy, -c * xz, -c * yy, -c * yz, -c * zz
        factor[now + 15 * LANES + n] = c
        for k in range(3):
            x = factor[_FACTOR + (6 + 3 * k) * LANES + n]
            y = factor[_FACTOR + (7 + 3 * k) * LANES + n]
            z = factor[_FACTOR + (8 + 3 * k) * LANES + n]
            factor[now + (6 + k) * LANES + n] = xx * x + xy * y + xz * z + (b if k == 0 else 0.0)
            factor[now + (9 + k) * LANES + n] = xy * x + yy * y + yz * z + (b if k == 1 else 0.0)
            factor[now + (12 + k) * LANES + n] = xz * x + yz * y + zz * z + (b if k == 2 else 0.0)


@inlined
def _factor_frame(factor: Floats) -> None:
    """Set P of the last of three frames, which has its block in that place, and F and c."""
    now = 2 * _FACTOR + 6 * LANES
    for n in range(LANES):
        m = 2 * _FACTOR + n
        xx, xy, xz = factor[m], factor[m + LANES], factor[m + 2 * LANES]
        yy, yz, zz = factor[m + 3 * LANES], factor[m + 4 * LANES], factor[m + 5 * LANES]
        c = factor[2 * _FACTOR + 15 * LANES + n]
        c = c * c
        xx, xy = xx - c * factor[n], xy - c * factor[LANES + n]
        xz, yy = xz - c * factor[2 * LANES + n], yy - c * factor[3 * LANES + n]
        yz, zz = yz - c * factor[4 * LANES + n], zz - c * factor[5 * LANES + n]
        m = _FACTOR + n
        pxx, pxy, pxz = factor[m], factor[m + LANES], factor[m + 2 * LANES]
        pyy, pyz, pzz = factor[m + 3 * LANES], factor[m + 4 * LANES], factor[m + 5 * LANES]
        m = now + n
        ax, ay, az = factor[m], factor[m + LANES], factor[m + 2 * LANES]
        bx, by, bz = factor[m + 3 * LANES], factor[m + 4 * LANES], factor[m + 5 * LANES]
        cx, cy, cz = factor[m + 6 * LANES], factor[m + 7 * LANES], factor[m + 8 * LANES]
        x, y, z = pxx * ax + pxy * ay + pxz * az, pxy * ax + pyy * ay + pyz * az, 0.0
        z = pxz * ax + pyz * ay + pzz * az
        xx, xy, xz = (
            xx - (ax * x + ay * y + az * z),
            xy - (bx * x + by * y + bz * z),
            xz - (cx * x + cy * y + cz * z),
        )
        x, y = pxx * bx + pxy * by + pxz * bz, pxy * bx + pyy * by + pyz * bz
        z = pxz * bx + pyz * by + pzz * bz
        yy, yz = yy - (bx * x + by * y + bz * z), yz - (cx * x + cy * y + cz * z)
        x, y = pxx * cx + pxy * cy + pxz * cz, pxy * cx + pyy * cy + pyz * cz
        z = pxz * cx + pyz * cy + pzz * cz
        zz = zz - (cx * x + cy * y + cz * z)
        # the inverse by a Cholesky factor without roots
        first = 1 / xx
        x, y = -xy * first, -xz * first
        second = 1 / (yy + x * xy)
        yz = yz + x * xz
        z = -yz * second
        third = 1 / (zz + y * xz + z * yz)
        y = y + z * x
        m = 2 * _FACTOR + n
        factor[m] = first + x * x * second + y * y * third
        factor[m + LANES], factor[m + 2 * LANES] = x * second + y * z * third, y * third
        factor[m + 3 * LANES] = second + z * z * third
        factor[m + 4 * LANES], factor[m + 5 * LANES] = z * third, third


@kernel("f8[:,:,::1], f8[:,::1], f8[:,::1], f8, f8[:,:,::1], f8[:,:,::1]")
def factor_bands(
    points: Floats,
    steps: Floats,
    expected: Floats,
    prior_loss: float,
    factor: Floats,
    gradient: Floats,
) -> None:
    """Add accelerations to blocks and gradient, and set the factors of the bands.

    All have two frames of zeros before and after, and between these whole tiles of frames. points
    and gradient: `[group, frame, 3 * LANES]`. factor: `[group, frame, 16 * LANES]`, blocks where P
    is set. steps: `[frame, 3]`. expected: `[frame, 5]` inverse variances of accelerations, the
    ridge, and what accelerations share.
    """
    link, narrow = np.empty(2 * LANES), 1 / prior_loss**2
    motion = np.zeros((LANES + 2, _MOTION))  # of a tile and two frames before
    for g in range(len(points)):
        motion[LANES:] = 0.0
        for first in range(2, points.shape[1] - 2, LANES):
            motion[:2] = motion[LANES:]
            for f in range(LANES):
                t = first + f
                three, recent = points[g, t : t + 3].reshape(-1), motion[f : f + 3].reshape(-1)
                _weigh_motion(three, steps[t], expected[t], narrow, motion[f + 2])
                ridge, before = expected[t, 1], steps[t - 2 : t + 1]
                _add_motion(recent, before, ridge, factor[g, t], gradient[g, t], link)
                last = factor[g, t - 2 : t + 1].reshape(-1)
                _link_frames(link, last)
                _factor_frame(last)


# --- what the joints of a body share of their accelerations


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
