"""The normal equations of cameras and points, compiled.

`ray_residuals` and `schur` define what is computed. Arrays of all points are read from a first
point on; arrays of a block have its n points alone.
"""

import numpy as np

from mocap_calib.compute.jit import FLOAT, INT, changed_floats, floats, inlined, kernel
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
    INT,
    floats(3),
    floats(4),
    floats(3),
    FLOAT,
    changed_floats(2),
    changed_floats(3),
)
def ray_residuals(
    first: int,
    rays: Floats,
    metric: Floats,
    in_camera: Floats,
    least: float,
    depth: Floats,
    residual: Floats,
) -> None:
    """Set the depths `[view, n]` and residuals `[view, 2, n]` of points in front of rays.

    least: depth of a point as a share of its size, so that none is behind.
    """
    views, _, count = in_camera.shape
    for v in range(views):
        for n in range(count):
            m = first + n
            x, y, z = in_camera[v, 0, n], in_camera[v, 1, n], in_camera[v, 2, n]
            along = rays[v, 0, m] * x + rays[v, 1, m] * y + rays[v, 2, m] * z
            along = max(along, least * max(abs(x), abs(y), abs(z)))
            depth[v, n] = along
            for k in range(2):
                offset = metric[v, k, 0, m] * x + metric[v, k, 1, m] * y + metric[v, k, 2, m] * z
                residual[v, k, n] = offset / along


@kernel(
    INT,
    floats(3),
    floats(4),
    floats(2),
    floats(3),
    floats(2),
    changed_floats(4),
)
def ray_slopes(
    first: int,
    rays: Floats,
    metric: Floats,
    depth: Floats,
    residual: Floats,
    weight: Floats,
    slope: Floats,
) -> None:
    """Set the weighed derivatives `[view, 2, 3, n]` of residuals by the points in the cameras."""
    views, count = depth.shape
    for v in range(views):
        for k in range(2):
            for i in range(3):
                for n in range(count):
                    m = first + n
                    by = metric[v, k, i, m] - residual[v, k, n] * rays[v, i, m]
                    slope[v, k, i, n] = by * (weight[v, n] / depth[v, n])


@kernel(
    INT,
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
    first: int,
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
    """Fill in the equations of a block of points, from its derivatives.

    in_camera: `[view, 3, n]`. slope: `[view, 2, 3, n]` and own: `[view, 2, intrinsic, n]` as of
    `Slopes`. residual: `[view, 2, n]`, weighed. camera: `[view, 6 + intrinsic, 2, n]` is set to
    the derivatives by the cameras. The rest: as of `NormalEquations`.
    """
    views, unknowns, _, count = camera.shape
    by_point = np.empty((2, 3, count))
    last = first + count
    point[:, :, first:last] = 0.0
    point_gradient[:, first:last] = 0.0
    for v in range(views):
        _derivatives(rotation[v], in_camera[v], slope[v], camera[v], by_point)
        for c in range(6, unknowns):
            for k in range(2):
                camera[v, c, k] = own[v, k, c - 6]
        for i in range(3):
            _add_products(
                by_point[0, i], by_point[1, i], residual[v], point_gradient[i, first:last]
            )
            for j in range(3):
                _add_products(
                    by_point[0, i], by_point[1, i], by_point[:, j], point[i, j, first:last]
                )
        for c in range(unknowns):
            for j in range(3):
                into = mixed[v, c, j, first:last]
                into[:] = 0.0
                _add_products(camera[v, c, 0], camera[v, c, 1], by_point[:, j], into)


@kernel(INT, FLOAT, floats(3), floats(4), changed_floats(3), changed_floats(3), changed_floats(3))
def damped_products(
    first: int,
    damping: float,
    point: Floats,
    mixed: Floats,
    inverse: Floats,
    root: Floats,
    product: Floats,
) -> None:
    """Set V^-1 `[3, 3, N]` of a block, its root `[3, 3, n]`, and W times that.

    product: `[C view, 3, n]`.
    """
    views, unknowns = mixed.shape[:2]
    count = product.shape[2]
    for n in range(count):
        m = first + n
        xx, yy, zz = point[0, 0, m], point[1, 1, m], point[2, 2, m]
        xx, yy, zz = xx * (1 + damping), yy * (1 + damping), zz * (1 + damping)
        largest = max(xx, yy, zz)
        ridge = 1e-12 * largest if largest > 0 else 1.0
        # the inverse of the Cholesky factor, transposed, is upper triangular
        p = 1 / np.sqrt(xx + ridge)
        yx, zx = point[1, 0, m] * p, point[2, 0, m] * p
        q = 1 / np.sqrt(yy + ridge - yx * yx)
        zy = (point[2, 1, m] - zx * yx) * q
        s = 1 / np.sqrt(zz + ridge - zx * zx - zy * zy)
        root[0, 0, n], root[0, 1, n] = p, -yx * p * q
        root[0, 2, n] = -(zx * p + zy * root[0, 1, n]) * s
        root[1, 1, n], root[1, 2, n] = q, -zy * q * s
        root[2, 2, n] = s
        root[1, 0, n] = root[2, 0, n] = root[2, 1, n] = 0.0
        for i in range(3):
            for j in range(3):
                total = 0.0
                for k in range(3):
                    total += root[i, k, n] * root[j, k, n]
                inverse[i, j, m] = total
    for v in range(views):
        for c in range(unknowns):
            into, last = product[v * unknowns + c], first + count
            x, y = mixed[v, c, 0, first:last], mixed[v, c, 1, first:last]
            z = mixed[v, c, 2, first:last]
            _turn_rows(x, y, z, root, into)
