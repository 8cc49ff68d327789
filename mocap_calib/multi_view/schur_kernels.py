"""The normal equations of cameras and points, compiled.

`ray_residuals` and `schur` define what is computed. Arrays of all points are read from a first
point on; arrays of a block have its n points alone.
"""

import numpy as np

from mocap_calib.compute.jit import FLOAT, INT, changed_floats, floats, kernel


@kernel(
    INT,
    floats(3),
    floats(4),
    floats(3),
    FLOAT,
    changed_floats(2),
    changed_floats(3),
)
def ray_residuals(first, rays, metric, in_camera, least, depth, residual):
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
def ray_slopes(first, rays, metric, depth, residual, weight, slope):
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
    floats(2),
    floats(3),
    floats(4),
    floats(4),
    floats(3),
    changed_floats(3),
    changed_floats(2),
    changed_floats(4),
    changed_floats(3),
    changed_floats(2),
)
def normal_equations(
    first,
    rotation,
    weight,
    in_camera,
    slope,
    own,
    residual,
    point,
    point_gradient,
    mixed,
    camera,
    camera_gradient,
):
    """Fill in the equations of a block of points, and add to the cameras' (as `Jacobian`, fused).

    weight: `[view, n]` of the robust loss, 0 = nothing to add. in_camera: `[view, 3, n]`.
    slope: `[view, 2, 3, n]` and own: `[view, 2, intrinsic, n]` as of `Slopes`.
    residual: `[view, 2, n]`, before it is weighed. The rest: as of `NormalEquations`.
    """
    views, unknowns = camera_gradient.shape
    count = weight.shape[1]
    a, b, r = np.empty((2, unknowns)), np.empty((2, 3)), np.empty(2)
    for i in range(3):
        point_gradient[i, first : first + count] = 0.0
        for j in range(3):
            point[i, j, first : first + count] = 0.0
    for v in range(views):
        turn = rotation[v]
        for n in range(count):
            m = first + n
            if weight[v, n] == 0:
                for c in range(unknowns):
                    for j in range(3):
                        mixed[v, c, j, m] = 0.0
                continue
            x, y, z = in_camera[v, 0, n], in_camera[v, 1, n], in_camera[v, 2, n]
            for k in range(2):
                by_x, by_y, by_z = slope[v, k, 0, n], slope[v, k, 1, n], slope[v, k, 2, n]
                a[k, 0] = by_z * y - by_y * z
                a[k, 1] = by_x * z - by_z * x
                a[k, 2] = by_y * x - by_x * y
                a[k, 3], a[k, 4], a[k, 5] = by_x, by_y, by_z
                for c in range(6, unknowns):
                    a[k, c] = own[v, k, c - 6, n]
                for j in range(3):
                    b[k, j] = by_x * turn[0, j] + by_y * turn[1, j] + by_z * turn[2, j]
                r[k] = residual[v, k, n] * weight[v, n]
            for i in range(3):
                point_gradient[i, m] += b[0, i] * r[0] + b[1, i] * r[1]
                for j in range(i + 1):
                    point[i, j, m] += b[0, i] * b[0, j] + b[1, i] * b[1, j]
            for c in range(unknowns):
                first_row, second_row = a[0, c], a[1, c]
                camera_gradient[v, c] += first_row * r[0] + second_row * r[1]
                for d in range(c + 1):
                    camera[v, c, d] += first_row * a[0, d] + second_row * a[1, d]
                for j in range(3):
                    mixed[v, c, j, m] = first_row * b[0, j] + second_row * b[1, j]
        for c in range(unknowns):  # the other half
            for d in range(c):
                camera[v, d, c] = camera[v, c, d]
    for i in range(3):
        for j in range(i):
            for n in range(first, first + count):
                point[j, i, n] = point[i, j, n]


@kernel(INT, FLOAT, floats(3), floats(4), changed_floats(3), changed_floats(3), changed_floats(3))
def damped_products(first, damping, point, mixed, inverse, root, product):
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
            row = v * unknowns + c
            for n in range(count):
                m = first + n
                wx, wy, wz = mixed[v, c, 0, m], mixed[v, c, 1, m], mixed[v, c, 2, m]
                product[row, 0, n] = wx * root[0, 0, n]
                product[row, 1, n] = wx * root[0, 1, n] + wy * root[1, 1, n]
                product[row, 2, n] = wx * root[0, 2, n] + wy * root[1, 2, n] + wz * root[2, 2, n]
