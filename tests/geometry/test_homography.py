"""Whether two images may show a plane."""

import numpy as np
import pytest

from mocap_calib.geometry.homography import plane_errors
from mocap_calib.geometry.rotation import matrix_from_vector

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
    error = np.median(plane_errors(rays_a, rays_b)[outliers:])
    assert 1.2 * NOISE < error < 2.5 * NOISE


def test_bodies_leave_more():
    """Half a unit thick, two wide: measured 27 times the noise."""
    rng = np.random.default_rng(0)
    rays = rays_of(rng.uniform(-1, 1, (300, 3)) * [1, 1, 0.25], rng)
    assert np.median(plane_errors(*rays)) > 18 * NOISE


def test_few_matches_tell_nothing():
    rays = np.tile([0.0, 0.0, 1.0], (19, 1))
    assert len(plane_errors(rays, rays)) == len(plane_errors(rays[:0], rays[:0])) == 0
