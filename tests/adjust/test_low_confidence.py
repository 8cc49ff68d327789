"""The least confident detections of each view take no part in the adjustment."""

import numpy as np

from mocap_calib.adjust.problem import drop_low_confidence
from mocap_calib.config import AdjustConfig

CONFIG = AdjustConfig()


def kept(confidence: np.ndarray) -> np.ndarray:
    """Return which detections of one view are kept."""
    found = drop_low_confidence(confidence[None], CONFIG)[0]
    assert set(found[found > 0]) <= set(confidence)
    return found > 0


def test_the_least_confident_share_is_left_out():
    confidence = np.random.default_rng(0).permutation(np.linspace(0.1, 1.0, 2000))
    np.testing.assert_array_equal(kept(confidence), confidence >= np.quantile(confidence, 0.3))


def test_all_detections_of_a_view_with_few_are_kept():
    assert kept(np.linspace(0.1, 1.0, CONFIG.enough_detections)).all()
    assert (
        kept(np.linspace(0.1, 1.0, CONFIG.enough_detections + 50)).sum() >= CONFIG.enough_detections
    )


def test_equal_confidences_are_all_kept_and_missing_detections_stay_missing():
    confidence = np.where(np.arange(3000) % 3 == 0, 0.0, 1.0)
    np.testing.assert_array_equal(kept(confidence), confidence > 0)
