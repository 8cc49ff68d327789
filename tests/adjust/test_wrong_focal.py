"""Wrong focal lengths, told from what they would change to."""

import numpy as np
import pytest

from mocap_calib.config import UncertaintyConfig
from mocap_calib.geometry.lens import change_intrinsics
from mocap_calib.types import Camera
from mocap_calib.verdict.uncertainty import find_wrong_focal

CONFIG = UncertaintyConfig()


def cameras_with(*log_focal):
    """Return cameras of one image size with the logarithms of focal lengths against 1000 px."""
    plain = Camera("c", (1000, 800), np.array([[1000, 0, 500], [0, 1000, 400], [0, 0, 1.0]]))
    return tuple(change_intrinsics(plain, log_focal=each, k1=0.0) for each in log_focal)


def found(log_focal, change, sigma):
    """Return the indices of the cameras whose focal lengths are wrong."""
    change, sigma = np.array(change), np.full(len(change), sigma)
    return np.flatnonzero(
        find_wrong_focal(cameras_with(*log_focal), change, sigma, CONFIG)
    ).tolist()


def test_a_certain_change_is_wrong_and_a_small_one_never_is():
    assert found([0, 0.1, 0.2], [0.0, -0.06, 0.0], 0.01) == [1]
    assert found([0, 0.1, 0.2], [0.0, -0.02, 0.0], 1e-4) == []


def test_a_likely_change_to_the_focal_length_of_the_equals_is_wrong():
    """At 3.4 sigma; not where the camera would change away, or the others differ by themselves."""
    assert found([0, 0.18, 0.01, 0], [0.06, -0.17, 0.04, -0.01], 0.05) == [1]
    assert found([0, 0.18, 0.01, 0], [0.06, 0.17, 0.04, -0.01], 0.05) == []
    assert found([0, 0.18, 0.1, 0.3], [0.06, -0.17, 0.04, -0.01], 0.05) == []


def test_a_camera_with_another_lens_is_not_accused():
    """What it has fits, within 1.5 sigma either way."""
    for change in (-0.07, 0.0, 0.07):
        assert found([0, 0.18, 0.01, 0], [0.02, change, 0.01, -0.01], 0.05) == []


def test_changes_of_all_cameras_alike_are_wrong():
    """At 3 sigma each; not at 1 sigma, and not where one camera contradicts."""
    assert found([0, 0, 0, 0], [-0.13, -0.17, -0.15, -0.16], 0.05) == [0, 1, 2, 3]
    assert found([0, 0, 0, 0], [-0.05, -0.04, -0.06, -0.05], 0.05) == []
    assert found([0, 0, 0, 0], [-0.15, -0.17, -0.15, 0.1], 0.05) == []


@pytest.mark.parametrize("unknown", [0, 2])
def test_focal_lengths_that_are_not_known_are_not_wrong(unknown):
    change = np.array([-0.15, -0.16, -0.15])
    change[unknown] = np.nan
    assert found([0, 0, 0], change, 0.05) == []
