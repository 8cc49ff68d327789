"""Compiled: relative poses by robust least squares on rays, with lifted bodies or without.

`refine.refine_two_view` and the energies of `posterior` say the same in numpy. The sums over rays
take two divisions a ray and no root: where the error is s v / sqrt(g), its slopes s j / sqrt(g),
and q = (s v / width)^2, Geman and McClure weigh it by (g / (g + q))^2.
"""

import math

import numpy as np

from mocap_calib.kernels.jit import FLOAT, INT, changed_floats, floats, inlined, kernel
from mocap_calib.pairs.view_pair import RAYS_OF_A_BLOCK
from mocap_calib.types import Floats

LANES = RAYS_OF_A_BLOCK


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
    return math.sqrt((vector * vector).sum())


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

    The slopes in a turn (3) and in a shift of t (3), the value v, the weight
    s^2 w g / (g + q)^2, and the loss w q / (g + q). A slope is that of the error, times
    sqrt(g) / s; a step changes v and g.
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
        terms[8 * LANES + n] = weight * square * inverse


@inlined
def _add_product(first: Floats, second: Floats, total: Floats) -> None:
    """Add the products of two rows `[LANES]` to a third."""
    for n in range(LANES):
        total[n] += first[n] * second[n]


@inlined
def _sum_over_rays(
    data: Floats, rotation: Floats, direction: Floats, shifts: Floats, width: float
) -> tuple[Floats, float]:
    """Return the Hessian and the gradient `[6, 7]`, and the loss: the sum of w q / (g + q).

    data: `[block, 8, LANES]` rays; direction: `[3]` unit; shifts: `[3, 3]` of it; width of loss.
    """
    size = len(shifts) + 3
    terms, slopes = np.empty((9, LANES)), np.empty((7, LANES))
    products, weighted, one = np.zeros((28, LANES)), np.empty(LANES), np.ones(LANES)
    for block in range(len(data)):
        flat = data[block].reshape(-1)
        _write_terms(flat, rotation, direction, 1.0 / width**2, terms.reshape(-1))
        slopes[:3], slopes[6] = terms[:3], terms[6]
        for k in range(len(shifts)):
            x, y, z, slope = terms[3], terms[4], terms[5], slopes[3 + k]
            for n in range(LANES):
                slope[n] = shifts[k, 0] * x[n] + shifts[k, 1] * y[n] + shifts[k, 2] * z[n]
        row = 0
        for i in range(size):
            slope, weight = slopes[i], terms[7]
            for n in range(LANES):
                weighted[n] = weight[n] * slope[n]
            for j in range(i, size + 1):  # the other slopes, and the value
                _add_product(weighted, slopes[j], products[row])
                row += 1
        _add_product(one, terms[8], products[row])
    return _as_system(products, size)


@inlined
def _as_system(products: Floats, size: int) -> tuple[Floats, float]:
    """Return the Hessian and the gradient `[K, K + 1]` and the loss of sums that lanes hold."""
    total = np.zeros((size + 1, size + 1))
    row = 0
    for i in range(size + 1):
        for j in range(i, size + 1):
            for n in range(LANES):
                total[i, j] += products[row, n]
            row += 1
            total[j, i] = total[i, j]
    return total[:size], total[size, size]


@inlined
def _turn(vector: Floats, rotation: Floats) -> Floats:
    """Return a rotation `[3, 3]` turned by a rotation vector `[3]` from the left (Rodrigues)."""
    angle = _norm(vector)
    first, second = 1.0, 0.5
    if angle > 0:
        first = math.sin(angle) / angle
        second = 0.5 * (math.sin(0.5 * angle) / (0.5 * angle)) ** 2
    turned = np.empty((3, 3))
    for k in range(3):
        x, y, z = rotation[0, k], rotation[1, k], rotation[2, k]
        along = vector[0] * x + vector[1] * y + vector[2] * z
        turned[0, k] = x + first * (vector[1] * z - vector[2] * y)
        turned[1, k] = y + first * (vector[2] * x - vector[0] * z)
        turned[2, k] = z + first * (vector[0] * y - vector[1] * x)
        for i in range(3):  # v x (v x c) = v (v . c) - c |v|^2
            turned[i, k] += second * (vector[i] * along - rotation[i, k] * angle**2)
    return turned


@kernel(changed_floats(3), changed_floats(2), floats(4), floats(1), FLOAT)
def refine(
    rotations: Floats, directions: Floats, rays: Floats, widths: Floats, largest: float
) -> None:
    """Take the steps of Gauss-Newton from rotations `[M, 3, 3]` and unit directions `[M, 3]`.

    rays: `[M, block, 8, LANES]` as `MatchedRays.in_blocks`; widths: `[step]`; largest: of a step.
    """
    for m in range(len(rotations)):
        for step in range(len(widths)):
            shifts = _across(directions[m])
            system, _ = _sum_over_rays(rays[m], rotations[m], directions[m], shifts, widths[step])
            damping = 1e-12 + 1e-6 * np.trace(system[:, :6])
            for k in range(6):
                system[k, k] += damping
            delta = _solve(system)
            delta *= -min(1.0, largest / max(_norm(delta), 1e-12))
            rotations[m] = _turn(delta[:3], rotations[m])
            directions[m] += delta[3:]
            directions[m] /= _norm(directions[m])


@inlined
def _add_rays(
    data: Floats, rotation: Floats, translation: Floats, rule: Floats, system: Floats
) -> float:
    """Add `posterior.ray_energy` to its slopes `[6, 7]` (Hessian, gradient); return its value."""
    noise, width = rule[0], rule[1]
    length = _norm(translation)
    direction = translation / length
    across = _across(direction) / length  # slope of the direction
    found, loss = _sum_over_rays(data, rotation, direction, across, width)
    system += found / noise**2
    return 0.5 * (width / noise) ** 2 * loss


@inlined
def _diagonalise(both: Floats) -> None:
    """Turn a symmetric matrix, and the rows below it, to its axes: `[6, 3]`.

    Jacobi's rotations (Golub and Van Loan, 8.5): numba would have scipy's LAPACK imported, 0.2 s.
    """
    for turn in range(24):
        p, q = turn % 3, (turn + 1) % 3
        if both[p, q] != 0.0:
            ratio = (both[q, q] - both[p, p]) / (2 * both[p, q])
            tangent = math.copysign(1.0, ratio) / (abs(ratio) + math.sqrt(1 + ratio**2))
            cosine = 1 / math.sqrt(1 + tangent**2)
            sine = tangent * cosine
            for k in range(6):
                x, y = both[k, p], both[k, q]
                both[k, p], both[k, q] = cosine * x - sine * y, sine * x + cosine * y
            for k in range(3):
                x, y = both[p, k], both[q, k]
                both[p, k], both[q, k] = cosine * x - sine * y, sine * x + cosine * y


@inlined
def _add_bodies(
    cross: Floats, norm: float, rotation: Floats, rule: Floats, system: Floats
) -> float:
    """Add a share of `posterior.body_energy`, likewise. cross: `[3, 3]` and norm are summed."""
    precision = rule[2] * 3 / rule[3] ** 2
    turned = (np.expand_dims(rotation, 2) * cross).sum(1)
    trace = turned[0, 0] + turned[1, 1] + turned[2, 2]
    both = np.concatenate((trace * np.eye(3) - (turned + turned.T) / 2, np.eye(3)))
    _diagonalise(both)
    for i in range(3):
        for j in range(3):
            for k in range(3):
                system[i, j] += both[3 + i, k] * precision * max(both[k, k], 0.0) * both[3 + j, k]
    system[0, 6] += precision * (turned[2, 1] - turned[1, 2])
    system[1, 6] += precision * (turned[0, 2] - turned[2, 0])
    system[2, 6] += precision * (turned[1, 0] - turned[0, 1])
    return precision * (norm / 2 - trace)


@inlined
def _add_centres(
    centres: Floats, rotation: Floats, translation: Floats, rule: Floats, system: Floats
) -> float:
    """Add a share of `posterior.centre_energy`, likewise. centres: `[N, 6]` of both."""
    share, across, along, outlier = rule[2], rule[3] ** 2, rule[4] ** 2, rule[5] ** 2
    value = 0.0
    covariance, information, slope = np.empty((3, 3)), np.empty((3, 3)), np.zeros((3, 6))
    turned, gap, pull = np.empty(3), np.empty(3), np.empty(3)
    slope[:, 3:] = np.eye(3)
    for n in range(len(centres)):
        for i in range(3):
            turned[i] = 0.0
            for j in range(3):
                turned[i] += rotation[i, j] * centres[n, j]
            gap[i] = turned[i] + translation[i] - centres[n, 3 + i]
        for i in range(3):
            for j in range(3):
                outer = turned[i] * turned[j] + centres[n, 3 + i] * centres[n, 3 + j]
                covariance[i, j] = along * outer + (across if i == j else 0.0)
        _invert(covariance, information)
        squared, lean = 0.0, 0.0
        for i in range(3):
            pull[i] = 0.0
            for j in range(3):
                pull[i] += information[i, j] * gap[j]
            squared += gap[i] * pull[i] / outlier
            lean += turned[i] * pull[i]
        value += squared / (1 + squared)
        slope[0, 1], slope[1, 2], slope[2, 0] = turned[2], turned[0], turned[1]
        slope[1, 0], slope[2, 1], slope[0, 2] = -turned[2], -turned[0], -turned[1]
        weight = share / (1 + squared) ** 2
        _add_match(slope, information, pull, weight, 1 - along * lean, system)
    return share * outlier / 2 * value


@inlined
def _invert(m: Floats, inverse: Floats) -> None:
    """Write the inverse of a symmetric matrix `[3, 3]` by its cofactors."""
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for n in range(3):
            o, p = (n + 1) % 3, (n + 2) % 3
            inverse[i, n] = m[j, o] * m[k, p] - m[j, p] * m[k, o]
    determinant = m[0, 0] * inverse[0, 0] + m[0, 1] * inverse[0, 1] + m[0, 2] * inverse[0, 2]
    for i in range(3):
        for j in range(3):
            inverse[i, j] /= determinant


@inlined
def _add_match(
    slope: Floats, information: Floats, pull: Floats, weight: float, of_turn: float, system: Floats
) -> None:
    """Add slope' information slope and slope' pull, weighted. slope: `[3, 6]`; pull: `[3]`.

    of_turn: what the pull on the turn is multiplied by.
    """
    for i in range(6):
        weight_of_pull = weight * of_turn if i < 3 else weight
        for k in range(3):
            row = 0.0
            for m in range(3):
                row += slope[m, i] * information[m, k]
            for j in range(6):
                system[i, j] += weight * row * slope[k, j]
            system[i, 6] += weight_of_pull * slope[k, i] * pull[k]


@kernel(
    *(floats(3), floats(2), FLOAT, floats(2)),
    *(changed_floats(2), changed_floats(1)),
    *(floats(1), floats(1), INT),
)
def minimise(
    rays: Floats,
    cross: Floats,
    norm: float,
    centres: Floats,
    rotation: Floats,
    translation: Floats,
    rule: Floats,
    damping_rule: Floats,
    steps: int,
) -> None:
    """Set the most probable rotation `[3, 3]` and translation `[3]`, from a first one.

    rays: `[block, 8, LANES]`; cross: `[3, 3]` and norm: sums over the lifted matches; centres:
    `[match, 6]`. rule: noise, width of the loss, share of the lifted bodies, spread of
    lifts, spread of centres, standard deviations of an outlier. damping_rule: the first damping,
    its factor, and the change of the energy that ends the steps.
    """
    damping, factor, least = damping_rule[0], damping_rule[1], damping_rule[2]
    best_rotation, best_translation = rotation.copy(), translation.copy()
    next_rotation, next_translation = best_rotation, best_translation
    best, best_system = np.inf, np.zeros((6, 7))
    for step in range(steps + 1):
        if step:
            system = best_system.copy()
            guard = 1e-9 * np.trace(system[:, :6])
            for k in range(6):
                system[k, k] += damping * system[k, k] + guard
            move = -_solve(system)
            next_rotation = _turn(move[:3], best_rotation)
            next_translation = best_translation + move[3:]
        system = np.zeros((6, 7))
        value = _add_rays(rays, next_rotation, next_translation, rule, system)
        value += _add_bodies(cross, norm, next_rotation, rule, system)
        value += _add_centres(centres, next_rotation, next_translation, rule, system)
        settled = abs(best - value) < least
        if value < best:
            best, best_system = value, system
            best_rotation, best_translation = next_rotation, next_translation
            damping = damping / factor if step else damping
        else:
            damping *= factor
        if settled:
            break
    rotation[:] = best_rotation
    translation[:] = best_translation
