"""Quantiles against scipy's."""

import pytest
from scipy.special import chdtri, fdtri

from mocap_calib.adjust.regions import widening


@pytest.mark.parametrize("degrees", [3.5, 6.0, 12.3, 40.0, 1000.0])
def test_regions_are_as_wide_as_quantiles_of_hotelling_say(degrees):
    left = degrees - 2
    expected = 3 * degrees / left * fdtri(3, left, 0.95) / chdtri(3, 0.05)
    assert widening(degrees) == pytest.approx(expected, rel=1e-11)


def test_a_covariance_of_many_degrees_hardly_needs_to_grow():
    assert widening(1e8) == pytest.approx(1.0, abs=1e-5)
