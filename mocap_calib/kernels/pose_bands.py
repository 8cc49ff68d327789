"""The banded normal equations of a fit: their factors, the step and the inverse, compiled.

Rows are as in `pose_energy`. The bands of the joints are factored in blocks of a frame: S[t] = A[t]
- c[t]^2 P[t-2] - F[t] P[t-1] F[t]', where P = S^-1, c couples t with t-2, and F[t] = b[t] - c[t]
P[t-2] F[t-1]' with t-1.
"""

import numpy as np

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.kernels.pose_energy import FACTOR, LANES, MOTION, POINT, add_motion, weigh_motion
from mocap_calib.types import Floats, Ints


@inlined
def _link_frames(link: Floats, factor: Floats) -> None:
    """Set F and c of the last of three frames."""
    now = 2 * FACTOR
    for n in range(LANES):
        b, c = link[n], link[LANES + n]
        xx, xy, xz = factor[n], factor[LANES + n], factor[2 * LANES + n]
        yy, yz, zz = factor[3 * LANES + n], factor[4 * LANES + n], factor[5 * LANES + n]
        xx, xy, xz, yy, yz, zz = -c * xx, -c * xy, -c * xz, -c * yy, -c * yz, -c * zz
        factor[now + 15 * LANES + n] = c
        for k in range(3):
            x = factor[FACTOR + (6 + 3 * k) * LANES + n]
            y = factor[FACTOR + (7 + 3 * k) * LANES + n]
            z = factor[FACTOR + (8 + 3 * k) * LANES + n]
            factor[now + (6 + k) * LANES + n] = xx * x + xy * y + xz * z + (b if k == 0 else 0.0)
            factor[now + (9 + k) * LANES + n] = xy * x + yy * y + yz * z + (b if k == 1 else 0.0)
            factor[now + (12 + k) * LANES + n] = xz * x + yz * y + zz * z + (b if k == 2 else 0.0)


@inlined
def _factor_frame(factor: Floats) -> None:
    """Set P of the last of three frames, which has its block in that place, and F and c."""
    now = 2 * FACTOR + 6 * LANES
    for n in range(LANES):
        m = 2 * FACTOR + n
        xx, xy, xz = factor[m], factor[m + LANES], factor[m + 2 * LANES]
        yy, yz, zz = factor[m + 3 * LANES], factor[m + 4 * LANES], factor[m + 5 * LANES]
        c = factor[2 * FACTOR + 15 * LANES + n]
        c = c * c
        xx, xy = xx - c * factor[n], xy - c * factor[LANES + n]
        xz, yy = xz - c * factor[2 * LANES + n], yy - c * factor[3 * LANES + n]
        yz, zz = yz - c * factor[4 * LANES + n], zz - c * factor[5 * LANES + n]
        m = FACTOR + n
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
        m = 2 * FACTOR + n
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
    motion = np.zeros((LANES + 2, MOTION))  # of a tile and two frames before
    for g in range(len(points)):
        motion[LANES:] = 0.0
        for first in range(2, points.shape[1] - 2, LANES):
            motion[:2] = motion[LANES:]
            for f in range(LANES):
                t = first + f
                three, recent = points[g, t : t + 3].reshape(-1), motion[f : f + 3].reshape(-1)
                weigh_motion(three, steps[t], expected[t], narrow, motion[f + 2])
                ridge, before = expected[t, 1], steps[t - 2 : t + 1]
                add_motion(recent, before, ridge, factor[g, t], gradient[g, t], link)
                last = factor[g, t - 2 : t + 1].reshape(-1)
                _link_frames(link, last)
                _factor_frame(last)


# --- the step, by conjugate gradients that the bands precondition


@inlined
def _substitute(factor: Floats, vectors: Floats, total: Floats) -> None:
    """Solve forwards: the last of three frames' vectors, from its side.

    total: `[LANES]` the products of sides and solutions, to which those of the frame are added.
    """
    for n in range(LANES):
        c = factor[15 * LANES + n]
        m = POINT + n
        x, y, z = vectors[m], vectors[m + LANES], vectors[m + 2 * LANES]
        i = 6 * LANES + n
        to_x = factor[i] * x + factor[i + LANES] * y + factor[i + 2 * LANES] * z
        i = 9 * LANES + n
        to_y = factor[i] * x + factor[i + LANES] * y + factor[i + 2 * LANES] * z
        i = 12 * LANES + n
        to_z = factor[i] * x + factor[i + LANES] * y + factor[i + 2 * LANES] * z
        m = 2 * POINT + n
        x = vectors[m] - (to_x + c * vectors[n])
        y = vectors[m + LANES] - (to_y + c * vectors[n + LANES])
        z = vectors[m + 2 * LANES] - (to_z + c * vectors[n + 2 * LANES])
        xx, xy, xz = factor[n], factor[n + LANES], factor[n + 2 * LANES]
        yy, yz, zz = factor[n + 3 * LANES], factor[n + 4 * LANES], factor[n + 5 * LANES]
        by_x, by_y = xx * x + xy * y + xz * z, xy * x + yy * y + yz * z
        by_z = xz * x + yz * y + zz * z
        total[n] += x * by_x + y * by_y + z * by_z
        vectors[m], vectors[m + LANES], vectors[m + 2 * LANES] = by_x, by_y, by_z


@inlined
def _substitute_back(factor: Floats, vectors: Floats) -> None:
    """Solve backwards: the first of three frames' vectors. factor: of the three."""
    for n in range(LANES):
        c = factor[2 * FACTOR + 15 * LANES + n]
        m = POINT + n
        x, y, z = vectors[m], vectors[m + LANES], vectors[m + 2 * LANES]
        i, j, k = FACTOR + 6 * LANES + n, FACTOR + 9 * LANES + n, FACTOR + 12 * LANES + n
        to_x = factor[i] * x + factor[j] * y + factor[k] * z
        to_y = factor[i + LANES] * x + factor[j + LANES] * y + factor[k + LANES] * z
        to_z = factor[i + 2 * LANES] * x + factor[j + 2 * LANES] * y + factor[k + 2 * LANES] * z
        m = 2 * POINT + n
        x = to_x + c * vectors[m]
        y = to_y + c * vectors[m + LANES]
        z = to_z + c * vectors[m + 2 * LANES]
        xx, xy, xz = factor[n], factor[n + LANES], factor[n + 2 * LANES]
        yy, yz, zz = factor[n + 3 * LANES], factor[n + 4 * LANES], factor[n + 5 * LANES]
        vectors[n] -= xx * x + xy * y + xz * z
        vectors[n + LANES] -= xy * x + yy * y + yz * z
        vectors[n + 2 * LANES] -= xz * x + yz * y + zz * z


@inlined
def _couple_ends(along: Floats, first: Floats, second: Floats) -> None:
    """Add to each end of a bone, in a tile, what it couples to it. Rows: vectors, and sums."""
    for n in range(LANES):
        x, y, z = along[n], along[LANES + n], along[2 * LANES + n]
        by_first = x * first[n] + y * first[LANES + n] + z * first[2 * LANES + n]
        by_second = x * second[n] + y * second[LANES + n] + z * second[2 * LANES + n]
        first[3 * LANES + n] += x * by_second
        first[4 * LANES + n] += y * by_second
        first[5 * LANES + n] += z * by_second
        second[3 * LANES + n] += x * by_first
        second[4 * LANES + n] += y * by_first
        second[5 * LANES + n] += z * by_first


@inlined
def _couple(
    along: Floats, edges: Ints, joints: Floats, vectors: Floats, first: int, image: Floats
) -> None:
    """Set what the bones' coupling makes of vectors in a tile, `[group, frame, POINT]`.

    joints: `[joint, 2 * POINT]`, is overwritten.
    """
    for j in range(len(joints)):
        row, g, n = joints[j], j // LANES, j % LANES
        for f in range(LANES):
            for k in range(3):
                row[k * LANES + f] = vectors[g, first + f, k * LANES + n]
        for k in range(POINT, len(row)):
            row[k] = 0.0
    for e in range(len(edges)):
        _couple_ends(along[e], joints[edges[e, 0]], joints[edges[e, 1]])
    for j in range(len(joints)):
        row, g, n = joints[j], j // LANES, j % LANES
        for f in range(LANES):
            for k in range(3):
                image[g, first + f, k * LANES + n] = row[POINT + k * LANES + f]


@inlined
def _add_products(rows: Floats, others: Floats, first: int, total: Floats) -> None:
    """Add the products of the rows of a tile."""
    for t in range(first, first + LANES):
        for n in range(POINT):
            total[n] += rows[t, n] * others[t, n]


@inlined
def _add_times(factor: float, rows: Floats, first: int, total: Floats) -> None:
    """Add a factor times the rows of a tile to others."""
    for t in range(first, first + LANES):
        for n in range(POINT):
            total[t, n] += factor * rows[t, n]


@inlined
def _renew(rows: Floats, share: float, first: int, direction: Floats) -> None:
    """Set the rows of a tile of a direction to others and its share of what it was."""
    for t in range(first, first + LANES):
        for n in range(POINT):
            direction[t, n] = rows[t, n] + share * direction[t, n]


@inlined
def _forwards(first: int, factor: Floats, vectors: Floats, total: Floats) -> None:
    """Solve a tile forwards, after those before it."""
    for t in range(first, first + LANES):
        for g in range(len(vectors)):
            _substitute(factor[g, t], vectors[g, t - 2 : t + 1].reshape(-1), total)


@inlined
def _backwards(first: int, factor: Floats, vectors: Floats) -> None:
    """Solve a tile backwards, after those that follow."""
    for t in range(first + LANES - 1, first - 1, -1):
        for g in range(len(vectors)):
            _substitute_back(factor[g, t : t + 3].reshape(-1), vectors[g, t : t + 3].reshape(-1))


@inlined
def _move_step(length: float, work: Floats, factor: Floats, step: Floats) -> float:
    """Move a step along the direction, and solve the bands forwards for the residual left.

    Returns the product of the residual and what the bands make of it. work: as of `take_step`.
    """
    residual, towards, image, direction = work[0], work[1], work[2], work[3]
    total = np.zeros(LANES)
    for first in range(2, step.shape[1] - 2, LANES):
        for g in range(len(step)):
            _add_times(length, direction[g], first, step[g])
            _add_times(-length, image[g], first, residual[g])
            _renew(residual[g], 0.0, first, towards[g])
        _forwards(first, factor, towards, total)
    return float(total.sum())


@inlined
def _turn_direction(
    share: float, work: Floats, factor: Floats, along: Floats, edges: Ints, joints: Floats
) -> float:
    """Solve the bands backwards, set the next direction and its image, return their product.

    share: of the direction before. work: as of `take_step`. joints: as of `_couple`.
    """
    residual, towards, image, direction, by_bands = work[0], work[1], work[2], work[3], work[4]
    total = np.zeros(POINT)
    for first in range(towards.shape[1] - 2 - LANES, 1, -LANES):
        _backwards(first, factor, towards)
        for g in range(len(towards)):
            _renew(towards[g], share, first, direction[g])
            _renew(residual[g], share, first, by_bands[g])
        _couple(along[first // LANES], edges, joints, direction, first, image)
        for g in range(len(towards)):
            _renew(by_bands[g], -1.0, first, image[g])
            _add_products(direction[g], image[g], first, total)
    return float(total.sum())


@kernel("f8[:,:,::1], f8[:,:,::1], i8[:,::1], i8, i8, f8[:,:,:,::1], f8[:,:,::1], f8[:,:,::1]")
def take_step(
    along: Floats,
    factor: Floats,
    edges: Ints,
    keypoints: int,
    rounds: int,
    work: Floats,
    step: Floats,
    points: Floats,
) -> None:
    """Move points by the step of normal equations. step: their gradient, which is overwritten.

    rounds: of conjugate gradients. work: five arrays like the step, at first of zeros: the
    residual; what the bands make of it; the image of the direction; the direction; and the product
    of the bands' matrix with it. The rest: as of `pose_energy.sum_terms` and
    `factor_bands`.
    """
    groups, padded, _ = step.shape
    joints, total = np.empty((keypoints, 2 * POINT)), np.zeros(LANES)
    for first in range(2, padded - 2, LANES):
        _forwards(first, factor, step, total)
    for first in range(padded - 2 - LANES, 1, -LANES):
        _backwards(first, factor, step)
        if rounds:
            _couple(along[first // LANES], edges, joints, step, first, work[0])
    before, length = np.inf, 0.0
    for _ in range(rounds):
        product = _move_step(length, work, factor, step)
        if product <= 0.0:
            length = 0.0
            break
        length = product / _turn_direction(product / before, work, factor, along, edges, joints)
        before = product
    direction = work[3]
    for g in range(groups):
        for first in range(2, padded - 2, LANES):
            _add_times(length, direction[g], first, step[g])
            _add_times(-1.0, step[g], first, points[g])


@inlined
def _eliminate(factor: Floats, near: Floats, far: Floats, found: Floats) -> None:
    """Set -P (F' x + c y), with P of the first of three frames, F of the next, c of the last.

    near, far: `[3 * LANES]` x and y.
    """
    for n in range(LANES):
        c = factor[2 * FACTOR + 15 * LANES + n]
        x, y, z = near[n], near[n + LANES], near[n + 2 * LANES]
        i, j, k = FACTOR + 6 * LANES + n, FACTOR + 9 * LANES + n, FACTOR + 12 * LANES + n
        to_x = factor[i] * x + factor[j] * y + factor[k] * z
        to_y = factor[i + LANES] * x + factor[j + LANES] * y + factor[k + LANES] * z
        to_z = factor[i + 2 * LANES] * x + factor[j + 2 * LANES] * y + factor[k + 2 * LANES] * z
        x, y, z = to_x + c * far[n], to_y + c * far[n + LANES], to_z + c * far[n + 2 * LANES]
        xx, xy, xz = factor[n], factor[n + LANES], factor[n + 2 * LANES]
        yy, yz, zz = factor[n + 3 * LANES], factor[n + 4 * LANES], factor[n + 5 * LANES]
        found[n] = -(xx * x + xy * y + xz * z)
        found[n + LANES] = -(xy * x + yy * y + yz * z)
        found[n + 2 * LANES] = -(xz * x + yz * y + zz * z)


@inlined
def _transpose(blocks: Floats, found: Floats) -> None:
    """Set the transposes of blocks, `[3, 3 * LANES]`."""
    for i in range(3):
        for j in range(3):
            for n in range(LANES):
                found[i, j * LANES + n] = blocks[j, i * LANES + n]


@kernel("f8[:,:,::1], f8[:,:,::1]")
def invert_bands(factor: Floats, found: Floats) -> None:
    """Set the blocks of the diagonal of the inverse `[group, frame, 6 * LANES]` (Takahashi 1973).

    factor: as of `factor_bands`. Blocks of a frame and of the next ones follow from
    those of the next ones alone.
    """
    shape = 3, 3 * LANES
    # by columns: of the next frame, of it and the one after, by columns and by rows, of that
    near, link, link_rows, far = np.empty(shape), np.empty(shape), np.empty(shape), np.empty(shape)
    to_next, rows, to_far, far_rows = (
        np.empty(shape),
        np.empty(shape),
        np.empty(shape),
        np.empty(shape),
    )
    for g in range(len(found)):
        near[:], link[:], link_rows[:], far[:] = 0.0, 0.0, 0.0, 0.0
        for t in range(found.shape[1] - 3, 1, -1):
            three = factor[g, t : t + 3].reshape(-1)
            for k in range(3):
                _eliminate(three, near[k], link_rows[k], to_next[k])
                _eliminate(three, link[k], far[k], to_far[k])
            _transpose(to_next, rows)
            _transpose(to_far, far_rows)
            far[:], link[:], link_rows[:] = near, to_next, rows
            row = 0
            for k in range(3):
                _eliminate(three, rows[k], far_rows[k], near[k])
            for i in range(3):
                for j in range(i, 3):
                    for n in range(LANES):
                        value = near[j, i * LANES + n] + three[row * LANES + n]
                        found[g, t, row * LANES + n] = value
                        near[i, j * LANES + n], near[j, i * LANES + n] = value, value
                    row += 1
