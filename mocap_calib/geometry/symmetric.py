"""Many symmetric 3 x 3 matrices at once, kept by entry: xx, xy, xz, yy, yz, zz, each `[N]`."""

import numpy as np

from mocap_calib.types import Floats

Entries = tuple[Floats, ...]

_RIDGE = 1e-10  # added to the diagonal of matrices that are scaled to about 1
# of the entries: those of the diagonal, and how often each is in the whole matrix
_DIAGONAL = (0, 3, 5)
_TIMES = (1, 2, 2, 1, 2, 1)


def solve(matrix: Entries, side: Floats) -> Floats:
    """Return the solutions `[3, N]` of systems, by cofactors.

    matrix: scaled to about 1. side: `[3, N]`. What a singular matrix leaves open is zero.
    """
    cofactors, determinant = _cofactors(matrix)
    return multiply(cofactors, side) / determinant


def invert(matrix: Entries) -> Entries:
    """Return the inverses of matrices that are not negative.

    Of a singular matrix it is something large, and of zero zero.
    """
    size = trace(matrix)
    size = np.where(size == 0, np.inf, size)
    cofactors, determinant = _cofactors(tuple(entry / size for entry in matrix))
    return tuple(entry / determinant / size for entry in cofactors)


def multiply(matrix: Entries, vector: Floats) -> Floats:
    """Return the products `[3, N]` of the matrices and vectors `[3, N]`."""
    xx, xy, xz, yy, yz, zz = matrix
    x = xx * vector[0] + xy * vector[1] + xz * vector[2]
    y = xy * vector[0] + yy * vector[1] + yz * vector[2]
    z = xz * vector[0] + yz * vector[1] + zz * vector[2]
    return np.stack([x, y, z])


def sandwich(outer: Entries, inner: Entries) -> Entries:
    """Return the symmetric products A B A of matrices A, `outer`, and B, `inner`."""
    rows = ((0, 1, 2), (1, 3, 4), (2, 4, 5))
    columns = [multiply(inner, np.stack([outer[k] for k in row])) for row in rows]  # of B A
    half = [multiply(outer, column) for column in columns]  # the columns of A B A
    return (half[0][0], half[0][1], half[0][2], half[1][1], half[1][2], half[2][2])


def trace(matrix: Entries) -> Floats:
    """Return the sums `[N]` of the diagonals."""
    return np.asarray(sum(matrix[k] for k in _DIAGONAL))


def sum_of_squares(matrix: Entries) -> Floats:
    """Return the sums `[N]` of the squares of all nine elements, the trace of A A."""
    return np.asarray(sum(n * entry * entry for n, entry in zip(_TIMES, matrix, strict=True)))


def _cofactors(matrix: Entries) -> tuple[Entries, Floats]:
    """Return the matrices of cofactors, and the determinants `[N]`, infinite where these are 0."""
    xx, xy, xz, yy, yz, zz = matrix
    xx, yy, zz = xx + _RIDGE, yy + _RIDGE, zz + _RIDGE
    cofactors = (
        yy * zz - yz * yz,
        xz * yz - xy * zz,
        xy * yz - xz * yy,
        xx * zz - xz * xz,
        xy * xz - xx * yz,
        xx * yy - xy * xy,
    )
    determinant = xx * cofactors[0] + xy * cofactors[1] + xz * cofactors[2]
    return cofactors, np.where(np.abs(determinant) > 1e-300, determinant, np.inf)
