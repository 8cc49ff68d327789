"""Wrong focal lengths, told from what they would change to."""

import numpy as np
import pytest

from mocap_calib.config import Config
from mocap_calib.verdict.verdict import find_wrong_focal

CONFIG = Config()


def found(change, sigma):
    """Return the indices of the cameras whose focal lengths are wrong."""
    change, sigma = np.array(change), np.full(len(change), sigma)
    return np.flatnonzero(find_wrong_focal(change, sigma, CONFIG)).tolist()


def test_a_certain_change_is_wrong_and_a_small_one_never_is():
    assert found([0.0, -0.06, 0.0], 0.01) == [1]
    assert found([0.0, -0.02, 0.0], 1e-4) == []


def test_changes_of_all_cameras_alike_are_wrong():
    """At 2.5 sigma each; not at 1 sigma, and not where one camera contradicts."""
    assert found([-0.11, -0.14, -0.12, -0.13], 0.05) == [0, 1, 2, 3]
    assert found([-0.05, -0.04, -0.06, -0.05], 0.05) == []
    assert found([-0.12, -0.14, -0.12, 0.1], 0.05) == []


@pytest.mark.parametrize("unknown", [0, 2])
def test_focal_lengths_that_are_not_known_are_not_wrong(unknown):
    change = np.array([-0.12, -0.13, -0.12])
    change[unknown] = np.nan
    assert found(change, 0.05) == []
