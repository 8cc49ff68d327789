"""Whether two images may show a plane, and where each camera has the other, without intrinsics."""

import numpy as np
import pytest

from mocap_calib.geometry.epipolar import essential_matrix, fundamental_matrix
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.inspection.view_pairs import homography_errors, sampson_distance

NOISE = 1e-3  # radians


def rays_of(points: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return what two cameras, 60 degrees apart, see of points `[N, 3]` about the origin."""
    seen = []
    for degrees in (0.0, 60.0):
        turn = matrix_from_vector(np.deg2rad([0.0, degrees, 0.0]))
        rays = points @ turn.T + [0, 0, 4.0]
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        rays += rng.normal(0, NOISE, rays.shape)
        seen.append(rays / np.linalg.norm(rays, axis=1, keepdims=True))
    return seen[0], seen[1]


@pytest.mark.parametrize("outliers", [0, 60])
def test_a_plane_leaves_the_noise_alone(outliers):
    """Both images err; measured 1.6 to 1.9 times the noise of one coordinate."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (300, 3)) * [1, 1, 0] @ matrix_from_vector(rng.normal(size=3)).T
    rays_a, rays_b = rays_of(points, rng)
    rays_b[:outliers] = rays_b[rng.permutation(outliers)] if outliers else rays_b[:0]
    first, second = (each[:, :2] / each[:, 2:] for each in (rays_a, rays_b))
    error = np.median(homography_errors(first, second)[outliers:])
    assert 1.2 * NOISE < error < 2.5 * NOISE


def test_bodies_leave_more():
    """Half a unit thick, two wide: measured 27 times the noise."""
    rng = np.random.default_rng(0)
    rays = rays_of(rng.uniform(-1, 1, (300, 3)) * [1, 1, 0.25], rng)
    first, second = (each[:, :2] / each[:, 2:] for each in rays)
    assert np.median(homography_errors(first, second)) > 18 * NOISE


@pytest.mark.parametrize("outliers", [0, 60])
def test_the_fundamental_matrix_leaves_the_noise_alone_and_has_the_epipoles(outliers):
    """Measured: 0.7 to 1.2 of the noise in the median, epipoles 20 to 140 of 1,386 pixels off."""
    rng = np.random.default_rng(0)
    noise = 800 * NOISE
    rays = rays_of(rng.uniform(-1, 1, (300, 3)), rng)
    first, second = (800 * each[:, :2] / each[:, 2:] + [640, 360] for each in rays)
    second[:outliers] = second[rng.permutation(outliers)] if outliers else second[:0]
    matrix = fundamental_matrix(first, second)
    error = np.abs(sampson_distance(matrix, first[outliers:], second[outliers:]))
    assert 0.5 * noise < np.median(error) < 1.3 * noise
    turn = matrix_from_vector(np.deg2rad([0.0, 60.0, 0.0]))
    shift = np.array([0, 0, 4.0]) - turn @ [0, 0, 4.0]
    intrinsics = np.array([[800, 0, 640], [0, 800, 360], [0, 0, 1.0]])
    inverse = np.linalg.inv(intrinsics)
    true = inverse.T @ essential_matrix(turn, shift) @ inverse
    for found, expected in ((matrix, true), (matrix.T, true.T)):
        epipoles = [np.linalg.svd(each)[2][2] for each in (found, expected)]
        gap = np.subtract(*(each[:2] / each[2] for each in epipoles))
        assert np.linalg.norm(gap) < 200


def test_few_matches_tell_nothing():
    assert fundamental_matrix(np.zeros((5, 2)), np.zeros((5, 2))) is None
