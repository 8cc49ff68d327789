"""Whether a recording determines its rig."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import calibrated

from mocap_calib.config import Config
from mocap_calib.determinacy import disagreement, verdict
from mocap_calib.frames import sample


def test_moving_people_determine_the_rig_and_a_statue_with_faults_does_not():
    """Measured: 0.3 deg for the scene; far more for one frame of it, repeated with the same errors of 15 px."""
    found = calibrated()
    moving = disagreement(sample(found.recording, slice(None)), found.rig, found.matches, Config(), seed=0)
    assert verdict(moving) == "well determined"
    faults = np.random.default_rng(0).normal(scale=15.0, size=found.recording.positions[:, :1].shape)
    still = found.recording.positions[:, :1] + faults
    count = len(found.recording.frames)
    confidence = np.repeat(found.recording.confidence[:, :1], count, 1)
    statue = sample(replace(found.recording, positions=np.repeat(still, count, 1), confidence=confidence), slice(None))
    labels = replace(found.matches, labels=np.repeat(found.matches.labels[:, :1], count, 1))
    assert np.median(disagreement(statue, found.rig, labels, Config(), seed=0)) > 5 * np.median(moving)


@pytest.mark.parametrize(("degrees", "word"), [(1.0, "well determined"), (5.0, "weak"), (40.0, "not determined")])
def test_verdicts(degrees, word):
    assert verdict(np.deg2rad([degrees, degrees, 0.1])) == word
