"""What factored bands give: the step of a fit, and the blocks of the inverse, compiled.

Rows are as in `pose_energy`.
"""

import numpy as np

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.kernels.pose_energy import LANES
from mocap_calib.types import Floats, Ints

_POINT = 3 * LANES
_FACTOR = 16 * LANES


@inlined
def _substitute(factor: Floats, vectors: Floats, total: Floats) -> None:
    """Solve forwards: the last of three frames' vectors, from its side.

    total: `[LANES]` the products of sides and solutions, to which those of the frame are added.
    """
    for n in range(LANES):
        c = factor[15 * LANES + n]
        m = _POINT + n
        x, y, z = vectors[m], vectors[m + LANES], vectors[m + 2 * LANES]
        i = 6 * LANES + n
        to_x = factor[i] * x + factor[i + LANES] * y + factor[i + 2 * LANES] * z
        i = 9 * LANES + n
        to_y = factor[i] * x + factor[i + LANES] * y + factor[i + 2 * LANES] * z
        i = 12 * LANES + n
        to_z = factor[i] * x + factor[i + LANES] * y + factor[i + 2 * LANES] * z
        m = 2 * _POINT + n
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
        c = factor[2 * _FACTOR + 15 * LANES + n]
        m = _POINT + n
        x, y, z = vectors[m], vectors[m + LANES], vectors[m + 2 * LANES]
        i, j, k = _FACTOR + 6 * LANES + n, _FACTOR + 9 * LANES + n, _FACTOR + 12 * LANES + n
        to_x = factor[i] * x + factor[j] * y + factor[k] * z
        to_y = factor[i + LANES] * x + factor[j + LANES] * y + factor[k + LANES] * z
        to_z = factor[i + 2 * LANES] * x + factor[j + 2 * LANES] * y + factor[k + 2 * LANES] * z
        m = 2 * _POINT + n
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
    """Set what the bones' coupling makes of vectors in a tile, `[group, frame, _POINT]`.

    joints: `[joint, 2 * _POINT]`, is overwritten.
    """
    for j in range(len(joints)):
        row, g, n = joints[j], j // LANES, j % LANES
        for f in range(LANES):
            for k in range(3):
                row[k * LANES + f] = vectors[g, first + f, k * LANES + n]
        for k in range(_POINT, len(row)):
            row[k] = 0.0
    for e in range(len(edges)):
        _couple_ends(along[e], joints[edges[e, 0]], joints[edges[e, 1]])
    for j in range(len(joints)):
        row, g, n = joints[j], j // LANES, j % LANES
        for f in range(LANES):
            for k in range(3):
                image[g, first + f, k * LANES + n] = row[_POINT + k * LANES + f]


@inlined
def _add_products(rows: Floats, others: Floats, first: int, total: Floats) -> None:
    """Add the products of the rows of a tile."""
    for t in range(first, first + LANES):
        for n in range(_POINT):
            total[n] += rows[t, n] * others[t, n]


@inlined
def _add_times(factor: float, rows: Floats, first: int, total: Floats) -> None:
    """Add a factor times the rows of a tile to others."""
    for t in range(first, first + LANES):
        for n in range(_POINT):
            total[t, n] += factor * rows[t, n]


@inlined
def _renew(rows: Floats, share: float, first: int, direction: Floats) -> None:
    """Set the rows of a tile of a direction to others and its share of what it was."""
    for t in range(first, first + LANES):
        for n in range(_POINT):
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
    total = np.zeros(_POINT)
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
    `pose_bands.factor_bands`.
    """
    groups, padded, _ = step.shape
    joints, total = np.empty((keypoints, 2 * _POINT)), np.zeros(LANES)
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
        c = factor[2 * _FACTOR + 15 * LANES + n]
        x, y, z = near[n], near[n + LANES], near[n + 2 * LANES]
        i, j, k = _FACTOR + 6 * LANES + n, _FACTOR + 9 * LANES + n, _FACTOR + 12 * LANES + n
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

    factor: as of `pose_bands.factor_bands`. Blocks of a frame and of the next ones follow from
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
