"""Symmetric 3 x 3 matrices by entry against numpy."""

import numpy as np

from mocap_calib.geometry import symmetric


def matrices(seed: int = 0) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """Return positive definite matrices `[50, 3, 3]` of very different sizes, and their entries."""
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(50, 3, 4)) * 10.0 ** rng.uniform(-4, 4, size=(50, 1, 1))
    whole = factor @ np.swapaxes(factor, 1, 2)
    return whole, entries(whole)


def entries(whole: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the entries `[N]` each of matrices `[N, 3, 3]`."""
    return tuple(whole[:, i, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))


def test_it_is_numpys_algebra():
    whole, matrix = matrices()
    other, inner = matrices(1)
    vector = np.random.default_rng(2).normal(size=(3, 50))
    product = np.einsum("nij,jn->in", whole, vector)
    np.testing.assert_allclose(symmetric.multiply(matrix, vector), product, rtol=1e-10)
    np.testing.assert_allclose(symmetric.trace(matrix), np.trace(whole.T), rtol=1e-12)
    np.testing.assert_allclose(symmetric.sum_of_squares(matrix), (whole**2).sum((1, 2)), rtol=1e-12)
    found = np.stack(symmetric.sandwich(matrix, inner))
    wanted = np.stack(entries(whole @ other @ whole))
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9 * np.abs(wanted).max())


def test_inverse_and_solution_undo_the_product():
    """To the ridge of 1e-10, which the conditions of these, up to 1e3, make 1e-7 of."""
    whole, matrix = matrices()
    scale = np.trace(whole, axis1=1, axis2=2)
    inverse = np.stack(symmetric.invert(matrix)) * scale
    wanted = np.stack(entries(np.linalg.inv(whole))) * scale
    np.testing.assert_allclose(inverse, wanted, rtol=1e-5, atol=1e-5 * np.abs(wanted).max())
    scaled = tuple(entry / scale for entry in matrix)
    side = np.random.default_rng(2).normal(size=(3, 50))
    np.testing.assert_allclose(
        symmetric.multiply(scaled, symmetric.solve(scaled, side)), side, atol=1e-5
    )


def test_a_singular_matrix_gives_numbers():
    """No warning, which would be an error, and no NaN."""
    nothing = tuple(np.zeros((6, 1)))
    assert np.isfinite(np.stack(symmetric.invert(nothing))).all()
    assert np.isfinite(symmetric.solve(nothing, np.ones((3, 1)))).all()
