"""Points of an adjustment: those of least cost for fixed cameras, and how they are eliminated.

What a view saw of a point is `[4, 3]` numbers: its ray and the two rows of its metric, where lenses
are known; its pixel, else; and where the origin lay in its frame when it saw the point. A lens is a
row as of `kernels.lens`.
"""

from typing import Any

import numpy as np

from mocap_calib.kernels.jit import copied, inlined, kernel
from mocap_calib.kernels.lens import distort
from mocap_calib.types import Floats

_TILE = 128  # points at a time: what is computed of them stays in the cache


@inlined
def _look(
    turn: Floats, saw: Floats, v: int, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Return a point in a camera's frame."""
    return (
        turn[v, 0, 0] * x + turn[v, 0, 1] * y + turn[v, 0, 2] * z + saw[v, 3, 0],
        turn[v, 1, 0] * x + turn[v, 1, 1] * y + turn[v, 1, 2] * z + saw[v, 3, 1],
        turn[v, 2, 0] * x + turn[v, 2, 1] * y + turn[v, 2, 2] * z + saw[v, 3, 2],
    )


_Seen = tuple[float, float, bool, float, float, float, float, float, float]


@copied
def _residual(
    lens: Floats, saw: Floats, v: int, least: float, x: float, y: float, z: float
) -> _Seen:
    """Return the residual of a point in a camera's frame, and its slopes by the point.

    Between the two: whether the point is in front of the camera.
    """
    nearest = least * max(abs(x), abs(y), abs(z))
    if len(lens) == 0:
        ray_x, ray_y, ray_z = saw[v, 0, 0], saw[v, 0, 1], saw[v, 0, 2]
        a, b, c = saw[v, 1, 0], saw[v, 1, 1], saw[v, 1, 2]
        d, e, f = saw[v, 2, 0], saw[v, 2, 1], saw[v, 2, 2]
        along = max(ray_x * x + ray_y * y + ray_z * z, nearest)
        by = 1 / along
        r, s = (a * x + b * y + c * z) * by, (d * x + e * y + f * z) * by
        a, b, c = (a - r * ray_x) * by, (b - r * ray_y) * by, (c - r * ray_z) * by
        d, e, f = (d - s * ray_x) * by, (e - s * ray_y) * by, (f - s * ray_z) * by
        return r, s, along > 2 * nearest, a, b, c, d, e, f
    along = max(z, nearest)
    by = 1 / along
    x, y = x * by, y * by
    there_x, there_y, xx, xy, yy, _ = distort(lens[v], x, y)
    per_x, per_y = lens[v, 2], lens[v, 3]
    a, b, d, e = per_x * xx * by, per_x * xy * by, per_y * xy * by, per_y * yy * by
    r = per_x * there_x + lens[v, 4] - saw[v, 0, 0] * lens[v, 1]
    s = per_y * there_y + lens[v, 5] - saw[v, 0, 1] * lens[v, 1]
    return r, s, along > 2 * nearest, a, b, -(a * x + b * y), d, e, -(d * x + e * y)


@inlined
def _to_world(turn: Floats, v: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return slopes by a point in the world, given those by it in a camera's frame."""
    return (
        turn[v, 0, 0] * x + turn[v, 1, 0] * y + turn[v, 2, 0] * z,
        turn[v, 0, 1] * x + turn[v, 1, 1] * y + turn[v, 2, 1] * z,
        turn[v, 0, 2] * x + turn[v, 1, 2] * y + turn[v, 2, 2] * z,
    )


@copied
def _pull(given: Any, saw: Floats, weight: Floats, point: Floats, into: Any) -> None:
    """Set what moves a point: squared residuals and robust weights `[view]`, B'B and B'r.

    into: the two, and `[9]` xx, xy, xz, yy, yz and zz of B'B, and B'r.
    """
    turn, _, lens, _, _, _, options = given
    square, robust, sums = into
    xx = xy = xz = yy = yz = zz = by_x = by_y = by_z = 0.0
    for v in range(len(weight)):
        if weight[v] > 0:
            x, y, z = _look(turn, saw, v, point[0], point[1], point[2])
            r, s, in_front, a, b, c, d, e, f = _residual(lens, saw, v, options[1], x, y, z)
            square[v] = r * r + s * s
            w = weight[v] / (1 + square[v] / options[0]) if in_front else 0.0
            robust[v] = w
            a, b, c = _to_world(turn, v, a, b, c)
            d, e, f = _to_world(turn, v, d, e, f)
            xx += w * (a * a + d * d)
            xy += w * (a * b + d * e)
            xz += w * (a * c + d * f)
            yy += w * (b * b + e * e)
            yz += w * (b * c + e * f)
            zz += w * (c * c + f * f)
            by_x += w * (a * r + d * s)
            by_y += w * (b * r + e * s)
            by_z += w * (c * r + f * s)
    sums[0], sums[1], sums[2], sums[3], sums[4], sums[5] = xx, xy, xz, yy, yz, zz
    sums[6], sums[7], sums[8] = by_x, by_y, by_z


@inlined
def _factor(
    xx: float, xy: float, xz: float, yy: float, yz: float, zz: float
) -> tuple[float, float, float, float, float, float]:
    """Return Cholesky's factor of B'B, inverse on its diagonal: x, yx, y, zx, zy and z."""
    largest = max(xx, yy, zz)
    ridge = 1e-12 * largest if largest > 0 else 1.0
    x = 1 / np.sqrt(xx + ridge)
    yx, zx = xy * x, xz * x
    y = 1 / np.sqrt(yy + ridge - yx * yx)
    zy = (yz - zx * yx) * y
    return x, yx, y, zx, zy, 1 / np.sqrt(zz + ridge - zx * zx - zy * zy)


@inlined
def _solve(sums: Floats) -> tuple[float, float, float]:
    """Return (B'B)^-1 B'r."""
    p, yx, q, zx, zy, s = _factor(sums[0], sums[1], sums[2], sums[3], sums[4], sums[5])
    first = sums[6] * p
    second = (sums[7] - yx * first) * q
    z = (sums[8] - zx * first - zy * second) * s * s
    y = (second - zy * z) * q
    return (first - yx * y - zx * z) * p, y, z


@inlined
def _gather(given: Any, n: int, saw: Floats) -> None:
    """Set what the views saw of a point of a block, `[view, 4, 3]`."""
    _, origin, _, seen, metric, _, _ = given
    own = min(n, origin.shape[2] - 1)
    for v in range(len(seen)):
        for i in range(3):
            saw[v, 3, i] = origin[v, i, own]
        for i in range(seen.shape[1]):
            saw[v, 0, i] = seen[v, i, n]
        if metric.shape[3] > 0:
            for k in range(2):
                for i in range(3):
                    saw[v, k + 1, i] = metric[v, k, i, n]


@inlined
def _settle(given: Any, steps: int, points: Floats) -> None:
    """Move points `[3, n]` of a block to where they cost least; given: as kernels are given."""
    _, _, _, seen, _, weight, options = given
    views = len(seen)
    saw, of_view = np.empty((views, 4, 3)), np.empty(views)
    point, tried = np.empty(3), np.empty(3)
    square, robust, sums = np.zeros(views), np.zeros(views), np.empty(9)
    next_square, next_robust, next_sums = np.zeros(views), np.zeros(views), np.empty(9)
    for n in range(points.shape[1]):
        _gather(given, n, saw)
        of_view[:] = weight[:, n]
        point[:] = points[:, n]
        _pull(given, saw, of_view, point, (square, robust, sums))
        for _ in range(steps):
            x, y, z = _solve(sums)
            gain = sums[6] * x + sums[7] * y + sums[8] * z
            tried[0], tried[1], tried[2] = point[0] - x, point[1] - y, point[2] - z
            _pull(given, saw, of_view, tried, (next_square, next_robust, next_sums))
            higher = 0.0
            for v in range(views):
                if of_view[v] > 0:
                    higher += robust[v] * (next_square[v] - square[v])
            if not higher <= 0:
                break
            point[:] = tried
            if gain <= options[2]:
                break
            square[:], robust[:], sums[:] = next_square, next_robust, next_sums
        points[:, n] = point


@inlined
def _set_own(lens: Floats, v: int, x: float, y: float, root: float, own: Floats) -> None:
    """Set the weighed slopes `[2, intrinsic]` by log focal length, k1 and log aspect, if free."""
    if len(lens) > 0:
        there_x, there_y, _, _, _, by_k1 = distort(lens[v], x, y)
        per_x, per_y = lens[v, 2], lens[v, 3]
        for i in range(own.shape[1]):
            by_r = per_x * (x * by_k1 if i == 1 else there_x)
            by_s = per_y * (y * by_k1 if i == 1 else there_y)
            if i == 2:
                by_r, by_s = -by_r / 2, by_s / 2
            own[0, i], own[1, i] = by_r * root, by_s * root


@inlined
def _weigh(given: Any, points: Floats, into: Any) -> float:
    """Set what `residuals.Linearised` has of points of a block; return their cost."""
    in_camera, slope, own, residual = into
    turn, _, lens, seen, _, weight, options = given
    views, count = len(seen), points.shape[1]
    square_scale, least = options[0], options[1]
    saw = np.zeros((views, 4, 3))
    cost = 0.0
    for n in range(count):
        _gather(given, n, saw)
        for v in range(views):
            w = weight[v, n]
            x, y, z = _look(turn, saw, v, points[0, n], points[1, n], points[2, n])
            r, s, in_front, a, b, c, d, e, f = _residual(lens, saw, v, least, x, y, z)
            in_camera[v, 0, n], in_camera[v, 1, n], in_camera[v, 2, n] = x, y, z
            square = r * r + s * s
            share = square / square_scale
            root = 0.0
            if w > 0:
                cost += w * np.log1p(share)
                root = np.sqrt(w / (1 + share)) if in_front else 0.0
            residual[v, 0, n], residual[v, 1, n] = root * r, root * s
            for i, by_r, by_s in ((0, a, d), (1, b, e), (2, c, f)):
                slope[v, 0, i, n], slope[v, 1, i, n] = root * by_r, root * by_s
            along = max(z, least * max(abs(x), abs(y), abs(z)))
            _set_own(lens, v, x / along, y / along, root, own[v, :, :, n])
    return cost


@kernel(
    "f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,:,::1], f8[:,::1], f8[::1], "
    "i8, f8[:,::1], f8[:,:,::1], f8[:,:,:,::1], f8[:,:,:,::1], f8[:,:,::1]"
)
def optimise_points(
    rotation: Floats,
    origin: Floats,
    lens: Floats,
    seen: Floats,
    metric: Floats,
    weight: Floats,
    options: Floats,
    steps: int,
    points: Floats,
    in_camera: Floats,
    slope: Floats,
    own: Floats,
    residual: Floats,
) -> float:
    """Move points `[3, n]` of a block to where they cost least; return their cost there.

    Also set what `residuals.Linearised` has of them: in_camera `[view, 3, n]`, slope
    `[view, 2, 3, n]`, own `[view, 2, intrinsic, n]` by the intrinsics, and residual `[view, 2, n]`.

    origin: that of the world in each camera's frame when it saw a point, `[view, 3, n]`, or
    `[view, 3, 1]`. seen: `[view, 3, n]` rays with their metric `[view, 2, 3, n]`, where there is no
    lens; else `[view, 2, n]` pixels of lenses `[view, lens row]`, whose lengths are in standard
    deviations, and no metric. options: the square of the loss scale, the least depth of a point as
    a share of its size, and the gain that ends it. steps: of a point, at most.
    """
    given = (rotation, origin, lens, seen, metric, weight, options)
    _settle(given, steps, points)
    return _weigh(given, points, (in_camera, slope, own, residual))


# --- the normal equations of cameras and points, of which the points are eliminated


@inlined
def _cross(last: Floats, next_one: Floats, in_camera: Floats, i: int, into: Floats) -> None:
    """Set a component of the cross product of points and slopes."""
    after, before = in_camera[(i + 1) % 3], in_camera[(i + 2) % 3]
    for n in range(len(into)):
        into[n] = last[n] * after[n] - next_one[n] * before[n]


@inlined
def _add_products(first_row: Floats, second_row: Floats, others: Floats, into: Floats) -> None:
    """Add the products of two rows each."""
    first_other, second_other = others[0], others[1]
    for n in range(len(into)):
        into[n] += first_row[n] * first_other[n] + second_row[n] * second_other[n]


@inlined
def _turn_rows(x: Floats, y: Floats, z: Floats, root: Floats, into: Floats) -> None:
    """Set the products of rows `[n]` with upper triangles `[3, 3, n]`."""
    xx, xy, xz = root[0, 0], root[0, 1], root[0, 2]
    yy, yz, zz = root[1, 1], root[1, 2], root[2, 2]
    by_x, by_y, by_z = into[0], into[1], into[2]
    for n in range(len(x)):
        by_x[n] = x[n] * xx[n]
    for n in range(len(x)):
        by_y[n] = x[n] * xy[n] + y[n] * yy[n]
    for n in range(len(x)):
        by_z[n] = x[n] * xz[n] + y[n] * yz[n] + z[n] * zz[n]


@inlined
def _derivatives(
    turn: Floats, in_camera: Floats, slope: Floats, camera: Floats, by_point: Floats
) -> None:
    """Set the derivatives of the residuals of a view by its pose and by the points."""
    for k in range(2):
        by_x, by_y, by_z = slope[k, 0], slope[k, 1], slope[k, 2]
        for i in range(3):
            camera[3 + i, k] = slope[k, i]
            _cross(slope[k, (i + 2) % 3], slope[k, (i + 1) % 3], in_camera, i, camera[i, k])
            x, y, z, into = turn[0, i], turn[1, i], turn[2, i], by_point[k, i]
            for n in range(len(into)):
                into[n] = by_x[n] * x + by_y[n] * y + by_z[n] * z


@inlined
def _set_roots(point: Floats, root: Floats) -> None:
    """Set the upper triangle of a root Q of V^-1 = QQ' `[3, 3, n]`; the rest stays as it is."""
    for n in range(point.shape[2]):
        p, yx, q, zx, zy, s = _factor(
            point[0, 0, n],
            point[1, 0, n],
            point[2, 0, n],
            point[1, 1, n],
            point[2, 1, n],
            point[2, 2, n],
        )
        # the inverse of the factor, transposed, is upper triangular
        root[0, 0, n], root[0, 1, n] = p, -yx * p * q
        root[0, 2, n] = -(zx * p + zy * root[0, 1, n]) * s
        root[1, 1, n], root[1, 2, n] = q, -zy * q * s
        root[2, 2, n] = s


@inlined
def _set_sides(gradient: Floats, root: Floats, side: Floats) -> None:
    """Set the products Q'b `[3, n]` of upper triangles `[3, 3, n]`."""
    for n in range(side.shape[1]):
        x, y, z = gradient[0, n], gradient[1, n], gradient[2, n]
        side[0, n] = root[0, 0, n] * x
        side[1, n] = root[0, 1, n] * x + root[1, 1, n] * y
        side[2, n] = root[0, 2, n] * x + root[1, 2, n] * y + root[2, 2, n] * z


@inlined
def _set_products(first_row: Floats, second_row: Floats, others: Floats, into: Floats) -> None:
    """Set the sums of the products of two rows each."""
    first_other, second_other = others[0], others[1]
    for n in range(len(into)):
        into[n] = first_row[n] * first_other[n] + second_row[n] * second_other[n]


@kernel(
    "f8[:,:,::1], f8[:,:,::1], f8[:,:,:,::1], f8[:,:,:,::1], f8[:,:,::1], f8[:,:,:,::1], "
    "f8[:,:,::1], f8[:,::1]"
)
def reduced(
    rotation: Floats,
    in_camera: Floats,
    slope: Floats,
    own: Floats,
    residual: Floats,
    camera: Floats,
    product: Floats,
    side: Floats,
) -> None:
    """Set what the reduced system of n points is made of, a tile of them after the other.

    in_camera: `[view, 3, n]`. slope: `[view, 2, 3, n]` and own: `[view, 2, intrinsic, n]` by the
    points and the intrinsics. residual: `[view, 2, n]`. camera: `[view, 6 + intrinsic, 2, n]` by
    the cameras. product: W Q `[C view, 3, n]`, Q being a root of V^-1, and side: Q'b `[3, n]`.
    """
    (views, unknowns), count = camera.shape[:2], in_camera.shape[2]
    where, by_camera = np.empty((3, _TILE)), np.empty((2, 3, _TILE))
    poses = np.empty((6, 2, _TILE))
    by_point, turned = np.empty((views, 2, 3, _TILE)), np.empty((2, 3, _TILE))
    rest = np.empty((2, _TILE))
    point, gradient, root = np.empty((3, 3, _TILE)), np.empty((3, _TILE)), np.zeros((3, 3, _TILE))
    for start in range(0, count, _TILE):
        stop = min(start + _TILE, count)
        size = stop - start
        point[:] = 0.0
        gradient[:] = 0.0
        for v in range(views):
            where[:, :size] = in_camera[v, :, start:stop]
            by_camera[:, :, :size] = slope[v, :, :, start:stop]
            rest[:, :size] = residual[v, :, start:stop]
            _derivatives(rotation[v], where, by_camera, poses, by_point[v])
            camera[v, :6, :, start:stop] = poses[:, :, :size]
            for k in range(2):
                camera[v, 6:, k, start:stop] = own[v, k, :, start:stop]
            for i in range(3):
                _add_products(by_point[v, 0, i], by_point[v, 1, i], rest, gradient[i])
                for j in range(i + 1):
                    _add_products(
                        by_point[v, 0, i], by_point[v, 1, i], by_point[v, :, j], point[i, j]
                    )
        _set_roots(point[:, :, :size], root[:, :, :size])
        _set_sides(gradient, root, side[:, start:stop])
        for v in range(views):
            for k in range(2):
                _turn_rows(by_point[v, k, 0], by_point[v, k, 1], by_point[v, k, 2], root, turned[k])
            for c in range(unknowns):
                for j in range(3):
                    _set_products(
                        camera[v, c, 0, start:stop],
                        camera[v, c, 1, start:stop],
                        turned[:, j],
                        product[v * unknowns + c, j, start:stop],
                    )
