"""How sure points from rays are, compiled: `point_covariance` says the same in numpy.

`LANES` points at once, of all views in turn.
"""

import math

import numpy as np

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.types import Floats

LANES = 64
_RIDGE = 1e-10  # as of `symmetric`


@inlined
def _add_across(share: float, x: float, y: float, z: float, n: int, sums: Floats) -> None:
    """Add a share of I - u u' of a unit vector u to the sums `[6, LANES]` of a lane."""
    sums[0, n] += share * (1 - x * x)
    sums[1, n] -= share * x * y
    sums[2, n] -= share * x * z
    sums[3, n] += share * (1 - y * y)
    sums[4, n] -= share * y * z
    sums[5, n] += share * (1 - z * z)


@inlined
def _add_view(
    centre: Floats,
    points: Floats,
    world: Floats,
    precision: Floats,
    variance: float,
    narrow: float,
    by_weight: Floats,
    by_error: Floats,
) -> None:
    """Add w J'J and w^2 s^2 J'J of a view to sums `[6, LANES]`. Points, world: `[3, LANES]`."""
    from_x, from_y, from_z = centre[0], centre[1], centre[2]
    for n in range(LANES):
        x, y, z = points[0, n] - from_x, points[1, n] - from_y, points[2, n] - from_z
        inverse = 1 / max(x * x + y * y + z * z, 1e-300)
        length = math.sqrt(inverse)
        x, y, z = x * length, y * length, z * length
        along = x * world[0, n] + y * world[1, n] + z * world[2, n]
        loss = 1 + max(1 - along * along, 0.0) * precision[n] * narrow
        weight = precision[n] / (loss * loss)
        share = weight * inverse
        _add_across(share, x, y, z, n, by_weight)
        _add_across(weight * variance * share, x, y, z, n, by_error)


@inlined
def _invert(matrix: Floats) -> None:
    """Put inverses in the place of matrices `[6, LANES]`, as `symmetric.invert` does."""
    for n in range(LANES):
        size = matrix[0, n] + matrix[3, n] + matrix[5, n]
        scale = 1 / size if size != 0 else 0.0
        xx, yy, zz = matrix[0, n] * scale, matrix[3, n] * scale, matrix[5, n] * scale
        xx, yy, zz = xx + _RIDGE, yy + _RIDGE, zz + _RIDGE
        xy, xz, yz = matrix[1, n] * scale, matrix[2, n] * scale, matrix[4, n] * scale
        of_xx, of_xy, of_xz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        determinant = xx * of_xx + xy * of_xy + xz * of_xz
        inverse = scale / determinant if abs(determinant) > 1e-300 else 0.0
        matrix[0, n], matrix[1, n], matrix[2, n] = of_xx * inverse, of_xy * inverse, of_xz * inverse
        matrix[3, n] = (xx * zz - xz * xz) * inverse
        matrix[4, n] = (xy * xz - xx * yz) * inverse
        matrix[5, n] = (xx * yy - xy * xy) * inverse


@inlined
def _sandwich(outer: Floats, inner: Floats, found: Floats) -> None:
    """Set the products A B A `[6, LANES]` of matrices A, outer, and B."""
    for n in range(LANES):
        xx, xy, xz = outer[0, n], outer[1, n], outer[2, n]
        yy, yz, zz = outer[3, n], outer[4, n], outer[5, n]
        a, b, c = inner[0, n], inner[1, n], inner[2, n]
        d, e, f = inner[3, n], inner[4, n], inner[5, n]
        first, second = a * xx + b * xy + c * xz, b * xx + d * xy + e * xz
        third = c * xx + e * xy + f * xz
        found[0, n] = xx * first + xy * second + xz * third
        found[1, n] = xy * first + yy * second + yz * third
        found[2, n] = xz * first + yz * second + zz * third
        first, second = a * xy + b * yy + c * yz, b * xy + d * yy + e * yz
        third = c * xy + e * yy + f * yz
        found[3, n] = xy * first + yy * second + yz * third
        found[4, n] = xz * first + yz * second + zz * third
        first, second = a * xz + b * yz + c * zz, b * xz + d * yz + e * zz
        third = c * xz + e * yz + f * zz
        found[5, n] = xz * first + yz * second + zz * third


@kernel("f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1], f8[::1], f8, f8[:,::1]")
def covariances(
    centres: Floats,
    points: Floats,
    world: Floats,
    precision: Floats,
    variance: Floats,
    loss_scale: float,
    found: Floats,
) -> None:
    """Set the entries `[6, N]` of the covariances of points `[3, N]`.

    centres: `[view, 3]`. world: `[view, 3, N]`. precision: `[view, N]`. variance: `[view]`.
    """
    sums, entries = np.empty((2, 6, LANES)), np.empty((6, LANES))
    by_weight, by_error = sums[0], sums[1]
    place, ray, own = np.zeros((3, LANES)), np.zeros((3, LANES)), np.zeros(LANES)
    narrow = 1 / loss_scale**2
    for start in range(0, points.shape[1], LANES):
        end = min(start + LANES, points.shape[1])
        here = end - start
        place[:, :here] = points[:, start:end]
        sums[:] = 0.0
        for view in range(len(centres)):
            for k in range(3):
                ray[k, :here] = world[view, k, start:end]
            own[:here] = precision[view, start:end]
            _add_view(centres[view], place, ray, own, variance[view], narrow, by_weight, by_error)
        _invert(by_weight)
        _sandwich(by_weight, by_error, entries)
        found[:, start:end] = entries[:, :here]
