"""Points from the rays of many views, robustly, and how near the rays pass.

All steps of a point are done before the next one, on the rays of the views that see it: see
`geometry.intersection`. Symmetric matrices are their entries xx, xy, xz, yy, yz, zz.
"""

import math

import numpy as np

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.types import Floats, Ints

RIDGE = 1e-10  # added to the diagonal of matrices that are scaled to about 1
_Entries = tuple[float, float, float, float, float, float]


@inlined
def _add_across(matrix: Floats, share: float, x: float, y: float, z: float) -> None:
    """Add a share of I - u u' of a unit vector u to a matrix."""
    matrix[0] += share * (1 - x * x)
    matrix[1] -= share * x * y
    matrix[2] -= share * x * z
    matrix[3] += share * (1 - y * y)
    matrix[4] -= share * y * z
    matrix[5] += share * (1 - z * z)


@inlined
def _multiply(matrix: _Entries, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the product of a matrix and a vector."""
    return (
        matrix[0] * x + matrix[1] * y + matrix[2] * z,
        matrix[1] * x + matrix[3] * y + matrix[4] * z,
        matrix[2] * x + matrix[4] * y + matrix[5] * z,
    )


@inlined
def _invert(matrix: Floats) -> _Entries:
    """Return the inverse of a matrix that is not negative, by cofactors; of zero it is zero."""
    size = matrix[0] + matrix[3] + matrix[5]
    if size == 0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    xx, yy, zz = matrix[0] / size + RIDGE, matrix[3] / size + RIDGE, matrix[5] / size + RIDGE
    xy, xz, yz = matrix[1] / size, matrix[2] / size, matrix[4] / size
    of_xx, of_xy, of_xz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    determinant = xx * of_xx + xy * of_xy + xz * of_xz
    scale = 1 / (determinant * size) if abs(determinant) > 1e-300 else 0.0
    of_yy, of_yz, of_zz = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    return (
        of_xx * scale,
        of_xy * scale,
        of_xz * scale,
        of_yy * scale,
        of_yz * scale,
        of_zz * scale,
    )


@inlined
def _solve(matrix: Floats, side: Floats, solution: Floats) -> None:
    """Solve a system; what is open is set to zero."""
    inverse = _invert(matrix)
    solution[0], solution[1], solution[2] = _multiply(inverse, side[0], side[1], side[2])


@inlined
def _add(matrix: Floats, side: Floats, weight: float, ray: Floats, offset: Floats) -> None:
    """Add w (I - u u') to a matrix, and w (o - u'o u) to a side."""
    along = offset[0] * ray[0] + offset[1] * ray[1] + offset[2] * ray[2]
    _add_across(matrix, weight, ray[0], ray[1], ray[2])
    for k in range(3):
        side[k] += weight * (offset[k] - along * ray[k])


@inlined
def _intersect_lines(
    views: Ints,
    centre: Floats,
    ray: Floats,
    precision: Floats,
    matrix: Floats,
    side: Floats,
    point: Floats,
) -> None:
    """Set the point nearest to weighted lines, in closed form, of these views."""
    total = 0.0
    for i in views:
        total += precision[i]
    matrix[:] = 0.0
    side[:] = 0.0
    for i in views:
        _add(matrix, side, precision[i] / max(total, 1e-300), ray[i], centre[i])
    _solve(matrix, side, point)


@inlined
def _refine(
    count: int,
    centre: Floats,
    ray: Floats,
    precision: Floats,
    scales: Floats,
    weight: Floats,
    matrix: Floats,
    side: Floats,
    point: Floats,
) -> None:
    """Take a Gauss-Newton step of a point at each scale of the loss of Geman and McClure."""
    offset, step = np.empty(3), np.empty(3)
    for scale in scales:
        narrow, total = 1 / scale**2, 0.0
        for i in range(count):
            square, along = _lengths(centre[i], ray[i], point)
            # (1 + error / scale^2) times the squared distance: one division in all
            loss = square + max(square - along * along, 0.0) * precision[i] * narrow
            weight[i] = precision[i] * square / (loss * loss)
            total += weight[i]
        by_total = 1 / max(total, 1e-300)
        matrix[:] = 0.0
        side[:] = 0.0
        for i in range(count):
            for k in range(3):
                offset[k] = point[k] - centre[i, k]
            _add(matrix, side, weight[i] * by_total, ray[i], offset)
        _solve(matrix, side, step)
        for k in range(3):
            point[k] -= step[k]


@inlined
def _lengths(centre: Floats, ray: Floats, point: Floats) -> tuple[float, float]:
    """Return the squared length of the offset of a point, and its length along a ray."""
    x, y, z = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
    return max(x * x + y * y + z * z, 1e-18), x * ray[0] + y * ray[1] + z * ray[2]


@inlined
def _squared_error(centre: Floats, ray: Floats, precision: float, point: Floats) -> float:
    """Return the squared sine between a ray and a point, infinite behind the camera."""
    square, along = _lengths(centre, ray, point)
    if not along > 0:
        return np.inf
    error: float = max(1 - along * along / square, 0.0) * precision
    return error


@inlined
def _count_meeting(
    count: int, centre: Floats, ray: Floats, precision: Floats, point: Floats, limit: float
) -> int:
    """Return how many rays pass a point within a squared error."""
    meeting = 0
    for i in range(count):
        meeting += _squared_error(centre[i], ray[i], precision[i], point) <= limit
    return meeting


@inlined
def _search_pairs(
    rows: Ints,
    pairs: Ints,
    first: int,
    count: int,
    centre: Floats,
    ray: Floats,
    precision: Floats,
    outlier: float,
    found: Floats,
    point: Floats,
) -> None:
    """Set the best of the points that pairs of views give.

    rows: `[view]` the row of each view among the rays of the point, -1 = not seen.
    """
    matrix, side, both = np.empty(6), np.empty(3), np.empty(2, dtype=np.int64)
    best = np.inf
    for pair in range(len(pairs)):
        both[0], both[1] = rows[pairs[pair, 0]], rows[pairs[pair, 1]]
        if both[0] < 0 or both[1] < 0 or (pair >= first and best < np.inf):
            continue
        _intersect_lines(both, centre, ray, precision, matrix, side, found)
        cost = 0.0
        for i in range(count):
            cost += min(_squared_error(centre[i], ray[i], precision[i], found), outlier)
        if cost < best:
            best = cost
            point[:] = found


@inlined
def _gather(
    n: int,
    centres: Floats,
    world: Floats,
    seen: Floats,
    rows: Ints,
    centre: Floats,
    ray: Floats,
    precision: Floats,
) -> int:
    """Gather the rays of the views that see a point; return their number."""
    count = 0
    for view in range(len(centres)):
        rows[view] = -1
        if seen[view, n] > 0:
            rows[view] = count
            precision[count] = seen[view, n]
            for k in range(3):
                centre[count, k] = centres[view, k]
                ray[count, k] = world[view, k, n]
            count += 1
    return count


@kernel("f8[:,::1], f8[:,:,::1], f8[:,::1], i8[:,::1], i8, f8[::1], f8[::1], f8[::1], f8[:,::1]")
def intersect_rays(
    centres: Floats,
    world: Floats,
    seen: Floats,
    pairs: Ints,
    first: int,
    steps: Floats,
    tightening: Floats,
    limits: Floats,
    points: Floats,
) -> None:
    """Set points `[3, N]` nearest to rays, NaN where fewer than two are seen.

    centres: `[view, 3]`. world: `[view, 3, N]` unit rays. seen: `[view, N]` inverse variances of
    angles, 0 = not seen. pairs: `[pair, 2]` that give candidates, the first so many in any case.
    steps, tightening: scales of the loss at each step, and where not all rays meet. limits: (3,)
    INTERSECT_DOUBTFUL, _OUTLIER, _AGREEING_RAYS.
    """
    views, doubtful, outlier = len(centres), limits[0], limits[1]
    rows, centre, ray = np.empty(views, dtype=np.int64), np.empty((views, 3)), np.empty((views, 3))
    precision, weight, matrix, side = np.empty(views), np.empty(views), np.empty(6), np.empty(3)
    point, found, every = np.empty(3), np.empty(3), np.arange(views)
    for n in range(points.shape[1]):
        count = _gather(n, centres, world, seen, rows, centre, ray, precision)
        points[:, n] = np.nan
        if count < 2:
            continue
        _intersect_lines(every[:count], centre, ray, precision, matrix, side, point)
        _refine(count, centre, ray, precision, steps, weight, matrix, side, point)
        most = doubtful * count
        if count > 2 and _count_meeting(count, centre, ray, precision, point, most) < count:
            _refine(count, centre, ray, precision, tightening, weight, matrix, side, point)
            meeting = _count_meeting(count, centre, ray, precision, point, outlier)
            if meeting < limits[2] or 2 * meeting < count:
                _search_pairs(
                    rows, pairs, first, count, centre, ray, precision, outlier, found, point
                )
                _refine(count, centre, ray, precision, steps, weight, matrix, side, point)
        points[:, n] = point


@inlined
def _direction(centre: Floats, points: Floats, n: int) -> tuple[float, float, float, float]:
    """Return the unit vector from a centre to a point, and the inverse of the squared distance."""
    x, y, z = points[0, n] - centre[0], points[1, n] - centre[1], points[2, n] - centre[2]
    inverse = 1 / max(x * x + y * y + z * z, 1e-300)
    root = math.sqrt(inverse)
    return x * root, y * root, z * root, inverse


@kernel("f8[:,::1], f8[:,::1], f8[:,::1], f8, f8, f8[:,::1]")
def median_angles(
    centres: Floats,
    points: Floats,
    weight: Floats,
    least_share: float,
    untouched: float,
    medians: Floats,
) -> None:
    """Set the medians `[view, N]` of the angles between rays and the points made of them.

    centres: `[view, 3]`; points: `[3, N]`; weight: `[view, N]`. untouched: that of a view that does
    not see the point.
    """
    information = np.empty(6)
    for n in range(points.shape[1]):
        information[:] = 0.0
        for view in range(len(centres)):
            if weight[view, n] > 0:
                x, y, z, inverse_square = _direction(centres[view], points, n)
                _add_across(information, weight[view, n] * inverse_square, x, y, z)
        c = _invert(information)
        trace = c[0] + c[3] + c[5]
        squares = c[0] ** 2 + c[3] ** 2 + c[5] ** 2 + 2 * (c[1] ** 2 + c[2] ** 2 + c[4] ** 2)
        for view in range(len(centres)):
            medians[view, n] = untouched
            if weight[view, n] > 0:
                x, y, z, inverse_square = _direction(centres[view], points, n)
                part = weight[view, n] * inverse_square
                ax, ay, az = _multiply(c, x, y, z)
                straight = x * ax + y * ay + z * az
                taken = part * (trace - straight)
                square = squares - 2 * (ax * ax + ay * ay + az * az) + straight * straight
                mean = max(2 - taken, 2 * least_share)
                squared = max(2 - 2 * taken + part * part * square, 0.5 * mean * mean)
                freedom = min(max(mean * mean / squared, 1.0), 2.0)
                medians[view, n] = math.sqrt(mean * (1 - 2 / (9 * freedom)) ** 3)
