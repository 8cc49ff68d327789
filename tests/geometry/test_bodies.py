"""Middles and sizes of bodies of which joints are missing."""

import numpy as np
import pytest

from mocap_calib.geometry.rotation import body_size, mean_of_known


def test_the_mean_skips_what_is_missing():
    values = np.array([[1.0, np.nan, 3.0], [np.nan, np.nan, np.nan]])
    assert mean_of_known(values, 1)[0] == 2
    assert np.isnan(mean_of_known(values, 1)[1])
    assert np.array_equal(mean_of_known(values, 0), [1, np.nan, 3], equal_nan=True)


def test_the_size_is_of_the_bodies_that_are_most_whole():
    bodies = np.random.default_rng(0).normal(size=(5, 8, 3))
    whole = body_size(bodies[:2])
    assert body_size(3 * bodies[:2]) == pytest.approx(3 * whole)
    assert body_size(bodies[:2] + 7) == pytest.approx(whole)
    bodies[2:, 3:] = np.nan  # three joints of eight
    assert body_size(bodies) == whole
    assert body_size(bodies[None]) == whole
    assert body_size(bodies[2:]) > 0  # better than none
    bodies[:, 2:] = np.nan
    assert np.isnan(body_size(bodies))
    assert body_size(bodies[:, :2]) > 0  # that is all there is of them
