"""The factor of confidence regions against scipy's."""

import pytest
from scipy.special import chdtri, fdtri

from mocap_calib.adjust.rig_covariance import hotelling_factor


@pytest.mark.parametrize("degrees", [6.0, 8.0, 12.3, 40.0, 1000.0])
def test_regions_are_as_wide_as_quantiles_of_hotelling_say(degrees):
    left = degrees - 2
    expected = 3 * degrees / left * fdtri(3, left, 0.95) / chdtri(3, 0.05)
    assert hotelling_factor(degrees) == pytest.approx(expected, rel=0.025)


def test_a_covariance_of_many_degrees_hardly_needs_to_grow():
    assert hotelling_factor(1e8) == pytest.approx(1.0, abs=0.006)
