"""The factor of confidence regions against draws."""

import numpy as np
import pytest

from mocap_calib.adjust.covariance import hotelling_factor


def test_regions_hold_as_many_draws_as_they_say():
    """Draws of three normal numbers, with covariances estimated from nine of them."""
    rng, degrees = np.random.default_rng(0), 8
    drawn = rng.normal(size=(20_000, degrees + 2, 3))
    covariance = np.swapaxes(drawn[:, 1:], 1, 2) @ drawn[:, 1:] / (degrees + 1)
    square = np.einsum("ni,nij,nj->n", drawn[:, 0], np.linalg.inv(covariance), drawn[:, 0])
    region = 7.815 * hotelling_factor(degrees + 1)  # 95 % of three squared normal numbers
    assert np.mean(square < region) == pytest.approx(0.95, abs=0.01)


def test_a_covariance_of_many_degrees_hardly_needs_to_grow():
    assert hotelling_factor(1e8) == pytest.approx(1.0, abs=0.006)
