"""The step of a fit, compiled: `energy._solve` says the same in numpy.

Rows are as in `energy_kernels`.
"""

import numpy as np

from mocap_calib.compute.jit import INT, changed_floats, floats, inlined, ints, kernel
from mocap_calib.types import Floats, Ints

LANES = 8
_POINT = 3 * LANES
_FACTOR = 16 * LANES


@inlined
def _substitute(factor: Floats, vectors: Floats) -> None:
    """Solve forwards: the last of three frames' vectors, from its side."""
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
        vectors[m] = xx * x + xy * y + xz * z
        vectors[m + LANES] = xy * x + yy * y + yz * z
        vectors[m + 2 * LANES] = xz * x + yz * y + zz * z


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
def _couple(t: int, along: Floats, edges: Ints, vectors: Floats, image: Floats) -> None:
    """Set what the bones' coupling makes of vectors in a frame, `[group, _POINT]`."""
    image[:] = 0.0
    for e in range(len(edges)):
        a, b = edges[e, 0], edges[e, 1]
        x, y, z = along[0, e], along[1, e], along[2, e]
        of_a, of_b = vectors[a // LANES, t], vectors[b // LANES, t]
        to_a, to_b = image[a // LANES], image[b // LANES]
        n, m = a % LANES, b % LANES
        by_a = x * of_a[n] + y * of_a[n + LANES] + z * of_a[n + 2 * LANES]
        by_b = x * of_b[m] + y * of_b[m + LANES] + z * of_b[m + 2 * LANES]
        to_a[n] += x * by_b
        to_a[n + LANES] += y * by_b
        to_a[n + 2 * LANES] += z * by_b
        to_b[m] += x * by_a
        to_b[m + LANES] += y * by_a
        to_b[m + 2 * LANES] += z * by_a


@inlined
def _add_products(first: Floats, second: Floats, total: Floats) -> None:
    """Add the products of rows `[_POINT]` to a third."""
    for n in range(_POINT):
        total[n] += first[n] * second[n]


@inlined
def _add_times(factor: float, row: Floats, total: Floats) -> None:
    """Add a factor times a row `[_POINT]` to another."""
    for n in range(_POINT):
        total[n] += factor * row[n]


@inlined
def _renew(row: Floats, share: float, direction: Floats) -> None:
    """Set a direction `[_POINT]` to a row and its share of what it was."""
    for n in range(_POINT):
        direction[n] = row[n] + share * direction[n]


@inlined
def _forwards(t: int, factor: Floats, vectors: Floats) -> None:
    """Solve a frame forwards, after those before it."""
    for g in range(len(vectors)):
        _substitute(factor[g, t], vectors[g, t - 2 : t + 1].reshape(-1))


@inlined
def _backwards(t: int, factor: Floats, vectors: Floats) -> None:
    """Solve a frame backwards, after those that follow."""
    for g in range(len(vectors)):
        _substitute_back(factor[g, t : t + 3].reshape(-1), vectors[g, t : t + 3].reshape(-1))


@inlined
def _first_step(
    along: Floats, factor: Floats, edges: Ints, step: Floats, residual: Floats, towards: Floats
) -> None:
    """Solve the bands alone: the step is its side at first. Then set what this leaves."""
    padded = step.shape[1]
    for t in range(2, padded - 2):
        _forwards(t, factor, step)
    for t in range(padded - 3, 1, -1):
        _backwards(t, factor, step)
    for t in range(2, padded - 2):
        _couple(t, along[t - 2], edges, step, residual[:, t])
        towards[:, t] = residual[:, t]
        _forwards(t, factor, towards)


@inlined
def _finish(factor: Floats, residual: Floats, towards: Floats) -> float:
    """Solve all frames backwards; return the product of the residual and the solution."""
    total = np.zeros(_POINT)
    for t in range(towards.shape[1] - 3, 1, -1):
        _backwards(t, factor, towards)
        for g in range(len(towards)):
            _add_products(residual[g, t], towards[g, t], total)
    return float(total.sum())


@kernel(floats(3), floats(3), ints(2), INT, changed_floats(3), changed_floats(3))
def take_step(
    along: Floats, factor: Floats, edges: Ints, rounds: int, step: Floats, points: Floats
) -> None:
    """Move points by the step of normal equations. step: their gradient, which is overwritten.

    rounds: of conjugate gradients. The rest: as of `energy_kernels.factor_bands`.
    """
    groups, padded, _ = step.shape
    residual, towards = np.zeros_like(step), np.zeros_like(step)
    direction, by_bands = np.zeros_like(step), np.zeros_like(step)
    image, total = np.zeros_like(step), np.empty(_POINT)
    _first_step(along, factor, edges, step, residual, towards)
    before, share = np.inf, 0.0
    for k in range(rounds if len(edges) else 0):
        product = _finish(factor, residual, towards)
        if product <= 0:
            break
        share, before = product / before, product
        total[:] = 0.0
        for t in range(2, padded - 2):
            for g in range(groups):
                _renew(towards[g, t], share, direction[g, t])
                _renew(residual[g, t], share, by_bands[g, t])
            _couple(t, along[t - 2], edges, direction, image[:, t])
            for g in range(groups):
                _renew(by_bands[g, t], -1.0, image[g, t])
                _add_products(direction[g, t], image[g, t], total)
        length = product / total.sum()
        for t in range(2, padded - 2):
            for g in range(groups):
                _add_times(length, direction[g, t], step[g, t])
            if k + 1 < rounds:
                for g in range(groups):
                    _add_times(-length, image[g, t], residual[g, t])
                    towards[g, t] = residual[g, t]
                _forwards(t, factor, towards)
    for t in range(2, padded - 2):
        for g in range(groups):
            _add_times(-1.0, step[g, t], points[g, t])
