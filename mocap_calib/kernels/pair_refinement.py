"""Compiled: relative poses of two views by robust least squares on rays and lifted bodies.

Sums over rays take two divisions a ray and no root: for the error s v / sqrt(g), its slopes
s j / sqrt(g) and q = (s v / width)^2 the Geman-McClure weight is (g / (g + q))^2.
"""

import math

import numpy as np

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.kernels.lens import LANES
from mocap_calib.types import Floats


@inlined
def _across(direction: Floats) -> Floats:
    """Return the shifts `[3, 3]` of a unit vector `[3]` that leave its length as it is."""
    across = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            across[i, j] = (1.0 if i == j else 0.0) - direction[i] * direction[j]
    return across


@inlined
def _norm(vector: Floats) -> float:
    """Return the length of a vector `[K]`."""
    square = 0.0
    for k in range(len(vector)):
        square += vector[k] * vector[k]
    return math.sqrt(square)


@inlined
def _solve(system: Floats) -> Floats:
    """Return x `[K]` of A x = b, where A is symmetric positive definite and the system A | b.

    `[K, K + 1]`, which is overwritten (elimination).
    """
    size = len(system)
    for k in range(size):
        for i in range(k + 1, size):
            factor = system[i, k] / system[k, k]
            for j in range(k, size + 1):
                system[i, j] -= factor * system[k, j]
    found = np.empty(size)
    for i in range(size - 1, -1, -1):
        found[i] = system[i, size]
        for k in range(i + 1, size):
            found[i] -= system[i, k] * found[k]
        found[i] /= system[i, i]
    return found


@inlined
def _write_terms(
    data: Floats, rotation: Floats, direction: Floats, narrow: float, terms: Floats
) -> None:
    """Write the terms of a block of rays, rows of `LANES`; see `_sum_over_rays`.

    The slopes in a turn (3) and in a shift of t (3), the value v, and the weight
    s^2 w g / (g + q)^2. A slope is that of the error, times sqrt(g) / s; a step changes v and g.
    """
    tx, ty, tz = direction[0], direction[1], direction[2]
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    for n in range(LANES):
        ax, ay, az = data[n], data[LANES + n], data[2 * LANES + n]
        bx, by, bz = data[3 * LANES + n], data[4 * LANES + n], data[5 * LANES + n]
        weight, size = data[6 * LANES + n], data[7 * LANES + n]
        x = r00 * ax + r01 * ay + r02 * az
        y = r10 * ax + r11 * ay + r12 * az
        z = r20 * ax + r21 * ay + r22 * az
        nx, ny, nz = y * bz - z * by, z * bx - x * bz, x * by - y * bx
        cx, cy, cz = by * tz - bz * ty, bz * tx - bx * tz, bx * ty - by * tx
        value = tx * nx + ty * ny + tz * nz
        along_a, along_b = tx * x + ty * y + tz * z, tx * bx + ty * by + tz * bz
        gradient = 2 - along_a * along_a - along_b * along_b - 2 * value * value
        gradient = max(gradient, 1e-12)
        ratio = value / gradient
        growth, pull_a, pull_b = 1 + 2 * value * ratio, ratio * along_a, ratio * along_b
        square = (size * value) ** 2 * narrow
        inverse = 1 / (gradient + square)
        terms[n] = growth * (y * cz - z * cy) + pull_a * (y * tz - z * ty)
        terms[LANES + n] = growth * (z * cx - x * cz) + pull_a * (z * tx - x * tz)
        terms[2 * LANES + n] = growth * (x * cy - y * cx) + pull_a * (x * ty - y * tx)
        terms[3 * LANES + n] = growth * nx + pull_a * x + pull_b * bx
        terms[4 * LANES + n] = growth * ny + pull_a * y + pull_b * by
        terms[5 * LANES + n] = growth * nz + pull_a * z + pull_b * bz
        terms[6 * LANES + n] = value
        terms[7 * LANES + n] = weight * size * size * gradient * inverse * inverse


@inlined
def _add_product(first: Floats, second: Floats, total: Floats) -> None:
    """Add the products of two rows `[LANES]` to a third."""
    for n in range(LANES):
        total[n] += first[n] * second[n]


@inlined
def _sum_over_rays(data: Floats, rotation: Floats, direction: Floats, width: float) -> Floats:
    """Return the Hessian and the gradient `[6, 7]` of the loss of the rays.

    data: `[block, 8, LANES]` rays; direction: `[3]` unit; width: of the loss, in body sizes.
    """
    shifts = _across(direction)
    terms, slopes = np.empty((8, LANES)), np.empty((7, LANES))
    products, weighted = np.zeros((27, LANES)), np.empty(LANES)
    for block in range(len(data)):
        flat = data[block].reshape(-1)
        _write_terms(flat, rotation, direction, 1.0 / width**2, terms.reshape(-1))
        slopes[:3], slopes[6] = terms[:3], terms[6]
        for k in range(3):
            x, y, z, slope = terms[3], terms[4], terms[5], slopes[3 + k]
            for n in range(LANES):
                slope[n] = shifts[k, 0] * x[n] + shifts[k, 1] * y[n] + shifts[k, 2] * z[n]
        row = 0
        for i in range(6):
            slope, weight = slopes[i], terms[7]
            for n in range(LANES):
                weighted[n] = weight[n] * slope[n]
            for j in range(i, 7):  # the other slopes, and the value
                _add_product(weighted, slopes[j], products[row])
                row += 1
    return _as_system(products)


@inlined
def _as_system(products: Floats) -> Floats:
    """Return the Hessian and the gradient `[6, 7]` of sums that lanes hold."""
    system = np.zeros((6, 7))
    row, (size, width) = 0, system.shape  # loops of a length known ahead would be unrolled
    for i in range(size):
        for j in range(i, width):
            total = 0.0
            for n in range(products.shape[1]):
                total += products[row, n]
            system[i, j] = total
            if j < size:
                system[j, i] = system[i, j]
            row += 1
    return system


@inlined
def _turn(vector: Floats, rotation: Floats) -> None:
    """Turn a rotation `[3, 3]` by a rotation vector `[3]` backwards, from the left (Rodrigues)."""
    angle = _norm(vector)
    first, second = -1.0, 0.5
    if angle > 0:
        first = -math.sin(angle) / angle
        second = 0.5 * (math.sin(0.5 * angle) / (0.5 * angle)) ** 2
    for k in range(3):
        x, y, z = rotation[0, k], rotation[1, k], rotation[2, k]
        along = vector[0] * x + vector[1] * y + vector[2] * z
        by_x, by_y = vector[1] * z - vector[2] * y, vector[2] * x - vector[0] * z
        by_z = vector[0] * y - vector[1] * x
        # v x (v x c) = v (v . c) - c |v|^2
        rotation[0, k] += first * by_x + second * (vector[0] * along - x * angle**2)
        rotation[1, k] += first * by_y + second * (vector[1] * along - y * angle**2)
        rotation[2, k] += first * by_z + second * (vector[2] * along - z * angle**2)


@inlined
def _shift(vector: Floats, direction: Floats) -> None:
    """Subtract a vector `[3]` from a unit vector, which is of length 1 again."""
    for k in range(3):
        direction[k] -= vector[k]
    length = _norm(direction)
    for k in range(3):
        direction[k] /= length


@inlined
def _add_bodies(overlap: Floats, inertia: float, rotation: Floats, system: Floats) -> None:
    """Add the slopes in a turn of inertia - tr(R overlap), half the distance of matched bodies.

    overlap: `[3, 3]` and inertia: weighted sums over matches. The inertia bounds the Hessian.
    """
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        system[i, i] += inertia
        for n in range(3):
            system[i, 6] += rotation[k, n] * overlap[n, j] - rotation[j, n] * overlap[n, k]


@kernel("f8[:,:,::1], f8[:,::1], f8[:,:,:,::1], f8[:,:,::1], f8[::1], f8[::1]")
def refine(
    rotations: Floats,
    directions: Floats,
    rays: Floats,
    overlap: Floats,
    inertia: Floats,
    widths: Floats,
) -> None:
    """Refine rotations `[M, 3, 3]` and unit directions `[M, 3]` by Gauss-Newton steps.

    rays: `[M, block, 8, LANES]` as of `view_pair.in_blocks`; overlap: `[M, 3, 3]` and inertia:
    `[M]` of `_add_bodies`; widths: `[step]` of the loss in body sizes.
    """
    for m in range(len(rotations)):
        for width in widths:
            system = _sum_over_rays(rays[m], rotations[m], directions[m], width)
            _add_bodies(overlap[m], inertia[m], rotations[m], system)
            damping = 1e-12
            for k in range(6):
                damping += 1e-6 * system[k, k]
            for k in range(6):
                system[k, k] += damping
            delta = _solve(system)
            _turn(delta[:3], rotations[m])
            _shift(delta[3:], directions[m])
