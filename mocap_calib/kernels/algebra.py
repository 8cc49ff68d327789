"""Symmetric 3 x 3 matrices, by their entries xx, xy, xz, yy, yz, zz."""

import numpy as np

from mocap_calib.kernels.jit import inlined
from mocap_calib.types import Floats

RIDGE = 1e-10  # added to the diagonal of matrices that are scaled to about 1


@inlined
def add_across(matrix: Floats, share: float, x: float, y: float, z: float) -> None:
    """Add a share of I - u u' of a unit vector u to a matrix."""
    matrix[0] += share * (1 - x * x)
    matrix[1] -= share * x * y
    matrix[2] -= share * x * z
    matrix[3] += share * (1 - y * y)
    matrix[4] -= share * y * z
    matrix[5] += share * (1 - z * z)


@inlined
def multiply(matrix: Floats, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the product of a matrix and a vector."""
    return (
        matrix[0] * x + matrix[1] * y + matrix[2] * z,
        matrix[1] * x + matrix[3] * y + matrix[4] * z,
        matrix[2] * x + matrix[4] * y + matrix[5] * z,
    )


@inlined
def invert(matrix: Floats, inverse: Floats) -> None:
    """Set the inverse of a matrix that is not negative, by cofactors; of zero it is zero."""
    size = matrix[0] + matrix[3] + matrix[5]
    if size == 0:
        inverse[:] = 0.0
        return
    xx, yy, zz = matrix[0] / size + RIDGE, matrix[3] / size + RIDGE, matrix[5] / size + RIDGE
    xy, xz, yz = matrix[1] / size, matrix[2] / size, matrix[4] / size
    inverse[0], inverse[1], inverse[2] = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    inverse[3], inverse[4], inverse[5] = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    determinant = xx * inverse[0] + xy * inverse[1] + xz * inverse[2]
    scale = 1 / (determinant * size) if abs(determinant) > 1e-300 else 0.0
    for k in range(6):
        inverse[k] *= scale


@inlined
def turn(matrix: Floats, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the product of a matrix `[3, 3]` and a vector."""
    return (
        matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z,
        matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z,
        matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z,
    )


@inlined
def cross(a: float, b: float, c: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the cross product of two vectors."""
    return b * z - c * y, c * x - a * z, a * y - b * x


@inlined
def is_number(x: float, y: float, z: float) -> bool:
    """Return whether a vector is known."""
    return not np.isnan(x + y + z)
