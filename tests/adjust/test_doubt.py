"""Detections that their detector doubts: left out where their errors repeat, kept where not."""

from dataclasses import replace

import numpy as np
from scenes import recording, scene, truth

from mocap_calib.adjust.bundle_adjustment import choose_points
from mocap_calib.config import Config
from mocap_calib.recording.sampling import take_sample
from mocap_calib.types import Floats, Matches, Sample

FEW = 50  # that are enough of a view, so that the share may go


def share_used(sample: Sample, matches: Matches) -> Floats:
    """Return the share `[view]` of the detections that the true rig would be built on."""
    config = Config(adjust=replace(Config().adjust, enough_detections=FEW))
    points = choose_points(sample, scene().rig, matches, config)
    return points.used.sum(1) / np.isfinite(points.pixels[:, 0]).sum(1)


def with_repeated_errors() -> Sample:
    """Return a recording whose less confident half is off by 6 px, in a direction that each
    joint of each person keeps; those of the three persons cancel.
    """
    sample = recording()
    third = truth().labels[..., None] * 2 * np.pi / 3
    angle = third + np.arange(len(sample.keypoints))
    aside = 6.0 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    seen = sample.confidence > 0
    low = seen & (sample.confidence < np.median(sample.confidence[seen]))
    positions = sample.positions + low[..., None] * aside
    return take_sample(replace(sample, positions=positions), slice(None))


def test_errors_of_chance_cost_no_detection():
    """Where noise is new in each frame all count but gross errors (1 % of them)."""
    assert share_used(recording(), truth()).min() > 0.95


def test_errors_that_repeat_cost_the_doubtful_ones():
    """As they follow each person, whose detections come in any order (measured 0.76 left)."""
    assert share_used(with_repeated_errors(), truth()).max() < 0.85


def test_where_little_follows_the_doubtful_ones_are_left_out():
    """Six frames are too few to tell whether errors repeat."""
    some = np.arange(0, 60, 10)
    sample = take_sample(recording(), some)
    assert share_used(sample, truth().select(frames=some)).max() < 0.9
