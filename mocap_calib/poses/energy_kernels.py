"""The normal equations of a fit, compiled: `energy.linearise` says the same in numpy.

What rays and bones tell is summed in tiles of `LANES` frames, rows of which are computed at once.
Over time, `LANES` joints lie side by side in a group; what the last has no joints for stays zero.
The bands of the joints are factored in blocks of a frame: S[t] = A[t] - c[t]^2 P[t-2] - F[t] P[t-1]
F[t]', where P = S^-1, c couples t with t-2, and F[t] = b[t] - c[t] P[t-2] F[t-1]' with t-1.
"""

import math

import numpy as np

from mocap_calib.compute.jit import FLOAT, changed_floats, floats, inlined, ints, kernel
from mocap_calib.types import Floats, Ints

LANES = 16  # with fewer the loops of fixed length are not made into vector instructions
_POINT = 3 * LANES  # numbers of a group in a frame: coordinates,
_MOTION = 4 * LANES  # weights of accelerations, and these times them,
_FACTOR = 16 * LANES  # P, F and c
_OWN = 9 * LANES  # blocks of the diagonal, and the gradient
_TABLE, _ROWS, _SET = floats(2), floats(3), changed_floats(3)
_GIVEN = (floats(4), _TABLE, _ROWS, _TABLE, _TABLE, _TABLE, ints(2), _ROWS, FLOAT, FLOAT)
_ROUNDING = 1e-12  # of what a point is held by, as in `energy`


@inlined
def _add_view(rays: Floats, centre: Floats, narrow: float, own: Floats) -> None:
    """Add a view's rays to the blocks and the gradient of a joint in a tile.

    rays: directions and precisions. own: `[12 * LANES]`, and the points. narrow: the loss to the
    power of -2.
    """
    from_x, from_y, from_z = centre[0], centre[1], centre[2]
    for n in range(LANES):
        rx, ry, rz = rays[n], rays[LANES + n], rays[2 * LANES + n]
        precision = rays[3 * LANES + n]
        x, y = own[9 * LANES + n] - from_x, own[10 * LANES + n] - from_y
        z = own[11 * LANES + n] - from_z
        along = rx * x + ry * y + rz * z
        behind = 1e-3 * math.sqrt(x * x + y * y + z * z)
        inverse = 1 / (along if along > 0 else behind)
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
def _hold(own: Floats) -> None:
    """Add a trace of their size to the blocks of a joint, as `energy.linearise` does."""
    for n in range(LANES):
        trace = _ROUNDING * (own[n] + own[3 * LANES + n] + own[5 * LANES + n])
        own[n] += trace
        own[3 * LANES + n] += trace
        own[5 * LANES + n] += trace


@inlined
def _weigh_bone(first: Floats, second: Floats, bone: Floats, narrow: float, along: Floats) -> None:
    """Set the directions of a bone times the root of their weights, and errors last.

    first, second: its joints. bone: lengths, inverse standard deviations and shortest lengths.
    """
    for n in range(LANES):
        x, y = first[_OWN + n] - second[_OWN + n], first[10 * LANES + n] - second[10 * LANES + n]
        z = first[11 * LANES + n] - second[11 * LANES + n]
        known, shortest = bone[LANES + n], bone[2 * LANES + n]
        length = math.sqrt(x * x + y * y + z * z)
        error = (length - bone[n]) * known
        weight = math.sqrt(1 / (1 + error * error * narrow))
        scale = weight * known / (length if length > shortest else shortest)
        along[n], along[LANES + n], along[2 * LANES + n] = x * scale, y * scale, z * scale
        along[3 * LANES + n] = weight * error


@inlined
def _add_bone(along: Floats, sign: float, own: Floats) -> None:
    """Add a bone to the blocks and the gradient of a joint at its end. sign: 1, -1 at the other."""
    for n in range(LANES):
        x, y, z = along[n], along[LANES + n], along[2 * LANES + n]
        error = sign * along[3 * LANES + n]
        own[n] += x * x
        own[LANES + n] += x * y
        own[2 * LANES + n] += x * z
        own[3 * LANES + n] += y * y
        own[4 * LANES + n] += y * z
        own[5 * LANES + n] += z * z
        own[6 * LANES + n] += x * error
        own[7 * LANES + n] += y * error
        own[8 * LANES + n] += z * error


@inlined
def _sum_tile(
    points: Floats,
    rays: Floats,
    centres: Floats,
    narrow: float,
    edges: Ints,
    bones: Floats,
    bones_narrow: float,
    along: Floats,
    own: Floats,
    turned: Floats,
) -> None:
    """Set the blocks and gradients of a tile, turned `[frame, group, 9 * LANES]`.

    points: `[group, frame, 3 * LANES]` of the tile. own: `[joint, 12 * LANES]`, is overwritten.
    """
    for j in range(len(own)):
        row, g, n = own[j], j // LANES, j % LANES
        row[:_OWN] = 0.0
        for k in range(3):
            for f in range(LANES):
                row[_OWN + k * LANES + f] = points[g, f, k * LANES + n]
        for v in range(len(centres)):
            _add_view(rays[v, j], centres[v], narrow, row)
        _hold(row)
    for e in range(len(edges)):
        a, b = edges[e, 0], edges[e, 1]
        _weigh_bone(own[a], own[b], bones[e], bones_narrow, along[e])
        _add_bone(along[e], 1.0, own[a])
        _add_bone(along[e], -1.0, own[b])
    for j in range(len(own)):
        row, g, n = own[j], j // LANES, j % LANES
        for f in range(LANES):
            for k in range(9):
                turned[f, g, k * LANES + n] = row[k * LANES + f]


@inlined
def _weigh_motion(
    points: Floats, steps: Floats, expected: Floats, stiff: Floats, narrow: float, motion: Floats
) -> None:
    """Set the weights of accelerations and these times them, from points of three frames.

    stiff: `[LANES]` factors of the frame's inverse variance, one for each joint.
    """
    first, second, third, usual = steps[0], steps[1], steps[2], expected[0]
    shared_x, shared_y, shared_z = expected[2], expected[3], expected[4]
    for n in range(LANES):
        x = first * points[n] + second * points[_POINT + n] + third * points[2 * _POINT + n]
        m = n + LANES
        y = first * points[m] + second * points[_POINT + m] + third * points[2 * _POINT + m]
        m = n + 2 * LANES
        z = first * points[m] + second * points[_POINT + m] + third * points[2 * _POINT + m]
        x, y, z = x - shared_x, y - shared_y, z - shared_z
        own = usual * stiff[n]
        pull = own / (1 + (x * x + y * y + z * z) * own * narrow)
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


@inlined
def _factor_next(
    t: int, recent: Floats, steps: Floats, ridge: float, own: Floats, link: Floats, factor: Floats
) -> None:
    """Add the accelerations to a frame's blocks, and factor these after those of the frames before.

    recent: accelerations of three frames. factor: of a group.
    """
    _add_motion(recent, steps[t - 2 : t + 1], ridge, own, link)
    last = factor[t - 2 : t + 1].reshape(-1)
    _link_frames(link, last)
    _factor_frame(own, last)


@kernel(*_GIVEN, _SET, _SET, _SET)
def factor_bands(
    rays: Floats,
    centres: Floats,
    points: Floats,
    steps: Floats,
    expected: Floats,
    stiffness: Floats,
    edges: Ints,
    bones: Floats,
    loss: float,
    prior_loss: float,
    along: Floats,
    factor: Floats,
    gradient: Floats,
) -> None:
    """Set the normal equations at these points, their bands factored.

    Frames fill whole tiles. rays: `[tile, view, keypoint, 4 * LANES]`, precisions last. bones:
    `[tile, edge, 3 * LANES]` lengths, inverse standard deviations and the shortest length. along:
    `[tile, edge, 4 * LANES]`. The others have two frames of zeros before and after: points and
    gradient `[group, frame, 3 * LANES]`, steps `[frame, 3]`, expected `[frame, 5]` inverse
    variances of accelerations, the ridge, and what accelerations share; factor `[group, frame, 16 *
    LANES]`. stiffness: `[group, LANES]` factors of the inverse variances, by joint.
    """
    groups = len(points)
    own, link = np.empty((rays.shape[2], 12 * LANES)), np.empty(2 * LANES)
    turned = np.zeros((LANES, groups, _OWN))
    motion = np.zeros((groups, LANES + 2, _MOTION))  # of the tile and two frames before
    narrow, prior_narrow = 1 / loss**2, 1 / prior_loss**2
    for k in range(len(rays)):
        first = 2 + k * LANES
        tile = points[:, first : first + LANES]
        _sum_tile(
            tile, rays[k], centres, narrow, edges, bones[k], prior_narrow, along[k], own, turned
        )
        for g in range(groups):
            motion[g, :2] = motion[g, LANES:]
            for f in range(LANES):
                t, own_frame = first + f, turned[f, g]
                three, recent = points[g, t : t + 3].reshape(-1), motion[g, f : f + 3].reshape(-1)
                _weigh_motion(
                    three, steps[t], expected[t], stiffness[g], prior_narrow, motion[g, f + 2]
                )
                _factor_next(t, recent, steps, expected[t, 1], own_frame, link, factor[g])
                gradient[g, t] = own_frame[6 * LANES :]


@kernel(_ROWS, _TABLE, floats(1), _SET, _SET)
def factor_blocks(
    motion: Floats, steps: Floats, ridge: Floats, blocks: Floats, factor: Floats
) -> None:
    """Factor bands of given blocks and weights of accelerations; arrays are as of `factor_bands`.

    motion: `[group, frame, 4 * LANES]` the weights first. ridge: `[frame]`. blocks: `[group,
    frame, 9 * LANES]`, which are overwritten.
    """
    link = np.empty(2 * LANES)
    for g in range(len(blocks)):
        for t in range(2, blocks.shape[1] - 2):
            recent = motion[g, t - 2 : t + 1].reshape(-1)
            _factor_next(t, recent, steps, ridge[t], blocks[g, t], link, factor[g])
