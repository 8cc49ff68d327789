"""The normal equations of cameras and points, of which the points are eliminated."""

import numpy as np

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.types import Floats

_TILE = 128  # points at a time: what is computed of them stays in the cache


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
        xx, yy, zz = point[0, 0, n], point[1, 1, n], point[2, 2, n]
        largest = max(xx, yy, zz)
        ridge = 1e-12 * largest if largest > 0 else 1.0
        # the inverse of the Cholesky factor, transposed, is upper triangular
        p = 1 / np.sqrt(xx + ridge)
        yx, zx = point[1, 0, n] * p, point[2, 0, n] * p
        q = 1 / np.sqrt(yy + ridge - yx * yx)
        zy = (point[2, 1, n] - zx * yx) * q
        s = 1 / np.sqrt(zz + ridge - zx * zx - zy * zy)
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


@inlined
def _copy(row: Floats, into: Floats) -> None:
    """Copy a row."""
    for n in range(len(into)):
        into[n] = row[n]


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
            for i in range(3):
                _copy(in_camera[v, i, start:stop], where[i, :size])
                for k in range(2):
                    _copy(slope[v, k, i, start:stop], by_camera[k, i, :size])
            for k in range(2):
                _copy(residual[v, k, start:stop], rest[k, :size])
            _derivatives(rotation[v], where, by_camera, poses, by_point[v])
            for k in range(2):
                for c in range(6):
                    _copy(poses[c, k, :size], camera[v, c, k, start:stop])
                for c in range(6, unknowns):
                    _copy(own[v, k, c - 6, start:stop], camera[v, c, k, start:stop])
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
