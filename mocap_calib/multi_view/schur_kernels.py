"""The normal equations of cameras and points, compiled.

`residuals` and `schur` define what is computed.
"""

import numpy as np

from mocap_calib.compute.jit import changed_floats, floats, inlined, kernel
from mocap_calib.types import Floats


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


@kernel(
    floats(3),
    floats(3),
    floats(4),
    floats(4),
    floats(3),
    changed_floats(3),
    changed_floats(2),
    changed_floats(4),
    changed_floats(4),
)
def normal_equations(
    rotation: Floats,
    in_camera: Floats,
    slope: Floats,
    own: Floats,
    residual: Floats,
    point: Floats,
    point_gradient: Floats,
    mixed: Floats,
    camera: Floats,
) -> None:
    """Set the equations of n points, from their derivatives.

    in_camera: `[view, 3, n]`. slope: `[view, 2, 3, n]` and own: `[view, 2, intrinsic, n]` as of
    `Slopes`. residual: `[view, 2, n]`, weighed. camera: `[view, 6 + intrinsic, 2, n]` is set to
    the derivatives by the cameras. The rest: as of `NormalEquations`.
    """
    views, unknowns, _, count = camera.shape
    by_point = np.empty((2, 3, count))
    point[:] = 0.0
    point_gradient[:] = 0.0
    mixed[:] = 0.0
    for v in range(views):
        _derivatives(rotation[v], in_camera[v], slope[v], camera[v], by_point)
        for c in range(6, unknowns):
            for k in range(2):
                camera[v, c, k] = own[v, k, c - 6]
        for i in range(3):
            _add_products(by_point[0, i], by_point[1, i], residual[v], point_gradient[i])
            for j in range(3):
                _add_products(by_point[0, i], by_point[1, i], by_point[:, j], point[i, j])
        for c in range(unknowns):
            for j in range(3):
                _add_products(camera[v, c, 0], camera[v, c, 1], by_point[:, j], mixed[v, c, j])


@kernel(floats(3), floats(3), changed_floats(3), changed_floats(3))
def rooted(point: Floats, mixed: Floats, root: Floats, product: Floats) -> None:
    """Set a root Q of V^-1 `[3, 3, n]`, and W Q `[C view, 3, n]`."""
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
        root[1, 0, n] = root[2, 0, n] = root[2, 1, n] = 0.0
    for c in range(len(mixed)):
        _turn_rows(mixed[c, 0], mixed[c, 1], mixed[c, 2], root, product[c])
