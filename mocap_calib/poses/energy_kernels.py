"""The normal equations of a fit, compiled: `energy.linearise` says the same in numpy.

Joints lie side by side in groups of `LANES`, whose rows are computed at once; what the last group
has no joints for is filled with copies of the last joint, which nothing looks at. A frame's rows
follow those of the frame before, so that each pass goes once through the memory. The bands of the
joints are factored in blocks of a frame: S[t] = A[t] - c[t]^2 P[t-2] - F[t] P[t-1] F[t]', where
P = S^-1, c couples t with t-2, and F[t] = b[t] - c[t] P[t-2] F[t-1]' with t-1.
"""

import math

import numpy as np

from mocap_calib.compute.jit import FLOAT, changed_floats, floats, inlined, ints, kernel
from mocap_calib.types import Floats, Ints

LANES = 8
_POINT = 3 * LANES  # numbers of a group in a frame: coordinates,
_RAYS = 4 * LANES  # of a view: directions and precisions,
_OWN = 9 * LANES  # a block of the diagonal and the gradient,
_MOTION = 4 * LANES  # weights of accelerations, and these times them,
_FACTOR = 16 * LANES  # P, F and c


@inlined
def _add_view(rays: Floats, point: Floats, centre: Floats, narrow: float, own: Floats) -> None:
    """Add a view's rays to the blocks and the gradient. narrow: the loss to the power of -2."""
    from_x, from_y, from_z = centre[0], centre[1], centre[2]
    for n in range(LANES):
        rx, ry, rz = rays[n], rays[LANES + n], rays[2 * LANES + n]
        precision = rays[3 * LANES + n]
        x, y, z = point[n] - from_x, point[LANES + n] - from_y, point[2 * LANES + n] - from_z
        along = rx * x + ry * y + rz * z
        behind = 1e-3 * math.sqrt(x * x + y * y + z * z)
        depth = along if along > 0 else behind
        inverse = 1 / depth
        x, y, z = (x - along * rx) * inverse, (y - along * ry) * inverse, (z - along * rz) * inverse
        square = x * x + y * y + z * z
        weight = precision / (1 + square * precision * narrow) * inverse
        size = 1 - square
        own[6 * LANES + n] += weight * (x - square * rx)
        own[7 * LANES + n] += weight * (y - square * ry)
        own[8 * LANES + n] += weight * (z - square * rz)
        weight = weight * inverse
        own[n] += weight * (1 - (size * rx + 2 * x) * rx)
        own[LANES + n] -= weight * (size * rx * ry + x * ry + y * rx)
        own[2 * LANES + n] -= weight * (size * rx * rz + x * rz + z * rx)
        own[3 * LANES + n] += weight * (1 - (size * ry + 2 * y) * ry)
        own[4 * LANES + n] -= weight * (size * ry * rz + y * rz + z * ry)
        own[5 * LANES + n] += weight * (1 - (size * rz + 2 * z) * rz)


@inlined
def _weigh_bones(along: Floats, bones: Floats, narrow: float) -> None:
    """Turn vectors along bones into directions times the root of their weights, and errors.

    along: `[4, edge]` the errors last. bones: `[3, edge]` lengths, inverse standard deviations
    and the shortest length. narrow: the loss to the power of -2.
    """
    ax, ay, az, errors = along[0], along[1], along[2], along[3]
    lengths, known, least = bones[0], bones[1], bones[2]
    for e in range(len(ax)):
        x, y, z = ax[e], ay[e], az[e]
        length = math.sqrt(x * x + y * y + z * z)
        error = (length - lengths[e]) * known[e]
        weight = math.sqrt(1 / (1 + error * error * narrow))
        scale = weight * known[e] / max(length, least[e])
        ax[e], ay[e], az[e] = x * scale, y * scale, z * scale
        errors[e] = weight * error


@inlined
def _add_bones(
    t: int, points: Floats, edges: Ints, bones: Floats, narrow: float, along: Floats, own: Floats
) -> None:
    """Set the directions of bones in a frame, and add them to its blocks and gradients."""
    for e in range(len(edges)):
        a, b = edges[e, 0], edges[e, 1]
        start, end = points[a // LANES, t], points[b // LANES, t]
        for c in range(3):
            along[c, e] = start[c * LANES + a % LANES] - end[c * LANES + b % LANES]
    _weigh_bones(along, bones, narrow)
    for e in range(len(edges)):
        x, y, z, error = along[0, e], along[1, e], along[2, e], along[3, e]
        for k in range(2):
            joint, sign = edges[e, k], 1.0 - 2.0 * k
            row, n = own[joint // LANES], joint % LANES
            row[n] += x * x
            row[LANES + n] += x * y
            row[2 * LANES + n] += x * z
            row[3 * LANES + n] += y * y
            row[4 * LANES + n] += y * z
            row[5 * LANES + n] += z * z
            row[6 * LANES + n] += sign * x * error
            row[7 * LANES + n] += sign * y * error
            row[8 * LANES + n] += sign * z * error


@inlined
def _weigh_motion(
    points: Floats, steps: Floats, stiffness: float, narrow: float, motion: Floats
) -> None:
    """Set the weights of accelerations and these times them, from points of three frames."""
    first, second, third = steps[0], steps[1], steps[2]
    for n in range(LANES):
        x = first * points[n] + second * points[_POINT + n] + third * points[2 * _POINT + n]
        m = n + LANES
        y = first * points[m] + second * points[_POINT + m] + third * points[2 * _POINT + m]
        m = n + 2 * LANES
        z = first * points[m] + second * points[_POINT + m] + third * points[2 * _POINT + m]
        pull = stiffness / (1 + (x * x + y * y + z * z) * stiffness * narrow)
        motion[n], motion[LANES + n] = pull, pull * x
        motion[2 * LANES + n], motion[3 * LANES + n] = pull * y, pull * z


@inlined
def _add_motion(motion: Floats, steps: Floats, ridge: float, own: Floats, link: Floats) -> None:
    """Add the accelerations of three frames to the last; set its links to the ones before.

    motion: of the three frames. steps: `[3, 3]` by frame. link: b and c.
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
        push = in_last * motion[m] + in_middle * motion[_MOTION + m]
        own[6 * LANES + n] += push + in_first * motion[2 * _MOTION + m]


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
def _factor_frame(own: Floats, factor: Floats) -> None:
    """Set P of the last of three frames, whose F and c are set."""
    now = 2 * _FACTOR + 6 * LANES
    for n in range(LANES):
        xx, xy, xz = own[n], own[LANES + n], own[2 * LANES + n]
        yy, yz, zz = own[3 * LANES + n], own[4 * LANES + n], own[5 * LANES + n]
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


@kernel(
    floats(3),
    floats(2),
    floats(3),
    floats(2),
    floats(2),
    ints(2),
    floats(3),
    FLOAT,
    FLOAT,
    changed_floats(3),
    changed_floats(3),
    changed_floats(3),
)
def factor_bands(
    rays: Floats,
    centres: Floats,
    points: Floats,
    steps: Floats,
    by_frame: Floats,
    edges: Ints,
    bones: Floats,
    loss: float,
    prior_loss: float,
    along: Floats,
    factor: Floats,
    gradient: Floats,
) -> None:
    """Set the normal equations at these points, their bands factored.

    All have two frames of zeros before and after, where not said otherwise. rays: `[group, frame,
    view * 32]` as of `pack_rays`, without. points, gradient: `[group, frame, 3 * LANES]`. steps:
    `[frame, 3]`. by_frame: `[2, frame]` inverse variances of accelerations, and the ridge. bones:
    `[frame, 3, edge]` lengths, inverse standard deviations and the shortest length, without.
    along: `[frame, 4, edge]`, without. factor: `[group, frame, 16 * LANES]`.
    """
    groups, padded = points.shape[:2]
    own, link = np.empty((groups, _OWN)), np.empty(2 * LANES)
    motion = np.zeros((groups, padded, _MOTION))
    narrow, prior_narrow = 1 / loss**2, 1 / prior_loss**2
    for t in range(2, padded - 2):
        own[:] = 0.0
        for g in range(groups):
            for v in range(len(centres)):
                part = rays[g, t - 2, v * _RAYS : (v + 1) * _RAYS]
                _add_view(part, points[g, t], centres[v], narrow, own[g])
        _add_bones(t, points, edges, bones[t - 2], prior_narrow, along[t - 2], own)
        for g in range(groups):
            three = points[g, t : t + 3].reshape(-1)
            _weigh_motion(three, steps[t], by_frame[0, t], prior_narrow, motion[g, t])
            recent = motion[g, t - 2 : t + 1].reshape(-1)
            _add_motion(recent, steps[t - 2 : t + 1], by_frame[1, t], own[g], link)
            last = factor[g, t - 2 : t + 1].reshape(-1)
            _link_frames(link, last)
            _factor_frame(own[g], last)
            gradient[g, t] = own[g, 6 * LANES :]


@kernel(floats(4), floats(3), changed_floats(3))
def pack_rays(rays: Floats, precision: Floats, packed: Floats) -> None:
    """Set rows `[group, frame, view * 32]` of rays `[3, view, keypoint, frame]`, precisions last.

    precision: `[view, keypoint, frame]`.
    """
    _, views, joints, frames = rays.shape
    for v in range(views):
        for j in range(joints):
            place = v * _RAYS + j % LANES
            for t in range(frames):
                row = packed[j // LANES, t]
                for c in range(3):
                    row[place + c * LANES] = rays[c, v, j, t]
                row[place + 3 * LANES] = precision[v, j, t]
