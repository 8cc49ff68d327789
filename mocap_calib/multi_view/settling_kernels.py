"""Points that settle under cameras that stay, compiled. `settling` defines what is computed."""

import numpy as np

from mocap_calib.compute.jit import INT, changed_floats, floats, inlined, kernel
from mocap_calib.types import Floats


@inlined
def _look(turn: Floats, shift: Floats, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return a point in a camera's frame."""
    return (
        turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z + shift[0],
        turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z + shift[1],
        turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z + shift[2],
    )


@inlined
def _pull(
    turn: Floats,
    shift: Floats,
    lines: Floats,
    weight: Floats,
    square_scale: float,
    least: float,
    point: Floats,
    square: Floats,
    robust: Floats,
    sums: Floats,
) -> None:
    """Set the squared residuals `[view]` of a point, their robust weights, and B'B and B'r.

    lines: `[view, 3, 3]` the ray of each view and the two rows of its metric. sums: `[9]` xx, xy,
    xz, yy, yz and zz of B'B, and B'r.
    """
    sums[:] = 0.0
    for v in range(len(weight)):
        if weight[v] == 0.0:
            continue
        x, y, z = _look(turn[v], shift[v], point[0], point[1], point[2])
        ray_x, ray_y, ray_z = lines[v, 0, 0], lines[v, 0, 1], lines[v, 0, 2]
        nearest = least * max(abs(x), abs(y), abs(z))
        along = max(ray_x * x + ray_y * y + ray_z * z, nearest)
        inverse = 1.0 / along
        total = 0.0
        for k in range(1, 3):
            offset = lines[v, k, 0] * x + lines[v, k, 1] * y + lines[v, k, 2] * z
            total += (offset * inverse) ** 2
        square[v] = total
        robust[v] = 0.0 if along <= 2 * nearest else weight[v] / (1.0 + total / square_scale)
        for k in range(1, 3):
            offset = lines[v, k, 0] * x + lines[v, k, 1] * y + lines[v, k, 2] * z
            residual = offset * inverse
            by_x = (lines[v, k, 0] - residual * ray_x) * inverse
            by_y = (lines[v, k, 1] - residual * ray_y) * inverse
            by_z = (lines[v, k, 2] - residual * ray_z) * inverse
            a = turn[v, 0, 0] * by_x + turn[v, 1, 0] * by_y + turn[v, 2, 0] * by_z
            b = turn[v, 0, 1] * by_x + turn[v, 1, 1] * by_y + turn[v, 2, 1] * by_z
            c = turn[v, 0, 2] * by_x + turn[v, 1, 2] * by_y + turn[v, 2, 2] * by_z
            w = robust[v]
            sums[0] += w * a * a
            sums[1] += w * a * b
            sums[2] += w * a * c
            sums[3] += w * b * b
            sums[4] += w * b * c
            sums[5] += w * c * c
            sums[6] += w * a * residual
            sums[7] += w * b * residual
            sums[8] += w * c * residual


@inlined
def _solve(sums: Floats) -> tuple[float, float, float]:
    """Return (B'B)^-1 B'r by Cholesky's factors."""
    xx, xy, xz, yy, yz, zz = sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]
    largest = max(xx, yy, zz)
    ridge = 1e-12 * largest if largest > 0 else 1.0
    p = 1 / np.sqrt(xx + ridge)
    yx, zx = xy * p, xz * p
    q = 1 / np.sqrt(yy + ridge - yx * yx)
    zy = (yz - zx * yx) * q
    s = 1 / np.sqrt(zz + ridge - zx * zx - zy * zy)
    first = sums[6] * p
    second = (sums[7] - yx * first) * q
    z = (sums[8] - zx * first - zy * second) * s * s
    y = (second - zy * z) * q
    return (first - yx * y - zx * z) * p, y, z


@kernel(
    INT,
    floats(3),
    floats(2),
    floats(3),
    floats(4),
    floats(2),
    floats(1),
    INT,
    changed_floats(2),
)
def settle(
    first: int,
    rotation: Floats,
    translation: Floats,
    rays: Floats,
    metric: Floats,
    weight: Floats,
    options: Floats,
    steps: int,
    points: Floats,
) -> None:
    """Move points `[3, n]` of a block to where they cost least.

    options: the square of the loss scale, the least depth of a point as a share of its size, and
        the gain that ends it.
    """
    views, count = len(rays), points.shape[1]
    square_scale, least, enough = options[0], options[1], options[2]
    lines, of_view = np.empty((views, 3, 3)), np.empty(views)
    point, tried = np.empty(3), np.empty(3)
    square, robust = np.zeros(views), np.zeros(views)
    next_square, next_robust = np.zeros(views), np.zeros(views)
    sums, next_sums = np.empty(9), np.empty(9)
    for n in range(count):
        m = first + n
        for v in range(views):
            of_view[v] = weight[v, m]
            for i in range(3):
                lines[v, 0, i] = rays[v, i, m]
                lines[v, 1, i] = metric[v, 0, i, m]
                lines[v, 2, i] = metric[v, 1, i, m]
        for i in range(3):
            point[i] = points[i, n]
        _pull(
            rotation, translation, lines, of_view, square_scale, least, point, square, robust, sums
        )
        for _ in range(steps):
            x, y, z = _solve(sums)
            gain = sums[6] * x + sums[7] * y + sums[8] * z
            tried[0], tried[1], tried[2] = point[0] - x, point[1] - y, point[2] - z
            _pull(
                rotation,
                translation,
                lines,
                of_view,
                square_scale,
                least,
                tried,
                next_square,
                next_robust,
                next_sums,
            )
            higher = 0.0
            for v in range(views):
                if of_view[v] > 0:
                    higher += robust[v] * (next_square[v] - square[v])
            if not higher <= 0:
                break
            point[:] = tried
            if gain <= enough:
                break
            square[:] = next_square
            robust[:] = next_robust
            sums[:] = next_sums
        for i in range(3):
            points[i, n] = point[i]


@kernel(
    INT,
    floats(3),
    floats(2),
    floats(3),
    floats(4),
    floats(2),
    floats(1),
    floats(2),
    changed_floats(3),
    changed_floats(4),
    changed_floats(3),
)
def weigh(
    first: int,
    rotation: Floats,
    translation: Floats,
    rays: Floats,
    metric: Floats,
    weight: Floats,
    options: Floats,
    points: Floats,
    in_camera: Floats,
    slope: Floats,
    residual: Floats,
) -> float:
    """Set what `settling.Weighed` has of points `[3, n]` of a block; return their cost.

    in_camera: `[view, 3, n]`, slope: `[view, 2, 3, n]` and residual: `[view, 2, n]`. options: the
        square of the loss scale, the least depth of a point as a share of its size, and the least
        curvature of the loss.
    """
    views, count = len(rays), points.shape[1]
    square_scale, least, least_curvature = options[0], options[1], options[2]
    cost = 0.0
    for v in range(views):
        for n in range(count):
            m = first + n
            x, y, z = _look(rotation[v], translation[v], points[0, n], points[1, n], points[2, n])
            in_camera[v, 0, n], in_camera[v, 1, n], in_camera[v, 2, n] = x, y, z
            w = weight[v, m]
            if w == 0.0:
                residual[v, 0, n] = residual[v, 1, n] = 0.0
                for i in range(3):
                    slope[v, 0, i, n] = slope[v, 1, i, n] = 0.0
                continue
            nearest = least * max(abs(x), abs(y), abs(z))
            along = max(rays[v, 0, m] * x + rays[v, 1, m] * y + rays[v, 2, m] * z, nearest)
            r = (metric[v, 0, 0, m] * x + metric[v, 0, 1, m] * y + metric[v, 0, 2, m] * z) / along
            s = (metric[v, 1, 0, m] * x + metric[v, 1, 1, m] * y + metric[v, 1, 2, m] * z) / along
            square = r * r + s * s
            share = square / square_scale
            cost += w * np.log1p(share)
            root = 0.0 if along <= 2 * nearest else np.sqrt(w / (1 + share))
            bend = np.sqrt(max(least_curvature, (1 - share) / (1 + share)))
            less = (1 - bend) / max(square, 1e-300)
            residual[v, 0, n], residual[v, 1, n] = root * r / bend, root * s / bend
            for i in range(3):
                by_r = metric[v, 0, i, m] - r * rays[v, i, m]
                by_s = metric[v, 1, i, m] - s * rays[v, i, m]
                radial = less * (r * by_r + s * by_s)
                slope[v, 0, i, n] = (by_r - r * radial) * (root / along)
                slope[v, 1, i, n] = (by_s - s * radial) * (root / along)
    return cost
