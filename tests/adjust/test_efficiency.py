"""How wide the loss is: as the errors say, and what a rig gains by that."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scenes import recording, rotation_errors_deg, scene, truth

from mocap_calib.adjust.bundle_adjustment import adjust_once
from mocap_calib.adjust.efficiency import choose_loss_scale
from mocap_calib.config import AdjustConfig, Config
from mocap_calib.geometry.reprojection import project
from mocap_calib.recording.sampling import take_sample
from mocap_calib.rig.noise import measure_sample
from mocap_calib.types import Floats, Sample

CONFIG = Config()
WIDE, NARROW = CONFIG.adjust.loss_scales[-1], CONFIG.adjust.narrow_loss_scale
FIVE = {"cameras": 5}


@lru_cache
def exact_pixels() -> Floats:
    """Return where the detections `[view, frame, instance, keypoint, 2]` should be."""
    made, found = scene(**FIVE), recording(**FIVE)
    joints = [made.joints.index(name) for name in found.keypoints]
    points = made.poses[:, :, joints]
    pixels = project(made.rig, points.reshape(-1, 3).T).reshape(5, 2, *points.shape[:3])
    who = np.maximum(truth(**FIVE).labels, 0)[..., None, None]
    return np.take_along_axis(np.moveaxis(pixels, 1, -1), who, axis=2)


def with_errors(sizes: Floats) -> Sample:
    """Return the recording with normal errors of 2 px, each as many times as large."""
    found = recording(**FIVE)
    error = 2.0 * np.random.default_rng(0).normal(size=found.positions.shape) * sizes[..., None]
    positions = np.where(np.isfinite(found.positions), exact_pixels() + error, np.nan)
    return take_sample(replace(found, positions=positions), slice(None))


def chosen(sample: Sample) -> float:
    """Return the scale of the loss that the true rig is adjusted with."""
    rig = scene(**FIVE).rig
    measured = measure_sample(sample, rig, truth(**FIVE), CONFIG.triangulate)
    return choose_loss_scale(rig, measured, CONFIG)


def of_many_sizes(degrees: float) -> Floats:
    """Return the sizes of errors whose distribution is Student's t."""
    shape = recording(**FIVE).confidence.shape
    return np.sqrt(degrees / np.random.default_rng(1).chisquare(degrees, size=shape))


@pytest.mark.parametrize(("degrees", "scale"), [(1e6, WIDE), (8.0, WIDE), (1.5, NARROW)])
def test_the_loss_is_as_wide_as_the_errors_allow(degrees, scale):
    """Of normal errors, of nearly such, and of ones most of which are far from usual."""
    assert chosen(with_errors(of_many_sizes(degrees))) == scale


def test_gross_errors_that_are_few_do_not_narrow_it():
    """1 % of detections, 50 times as far off as the others, change little at either width."""
    shape = recording(**FIVE).confidence.shape
    gross = np.random.default_rng(1).random(shape) < 0.01
    assert chosen(with_errors(np.where(gross, 50.0, 1.0))) == WIDE


def test_without_points_it_is_narrow():
    """Two of five views see each point, which is no measure of their errors."""
    found = recording(**FIVE)
    confidence = np.where(np.arange(5)[:, None, None, None] < 2, found.confidence, 0.0)
    assert chosen(replace(found, confidence=confidence)) == NARROW


def test_rigs_of_normal_errors_are_better():
    """Than by the narrow loss alone: mean squared errors are 0.87 times as large."""
    rig, normal = scene(**FIVE).rig, with_errors(np.ones(recording(**FIVE).confidence.shape))
    narrow = replace(CONFIG, adjust=AdjustConfig(loss_scales=(NARROW,)))
    errors = []
    for start in range(0, 60, 6):
        some = np.arange(start, start + 6)
        sample = take_sample(normal, some)
        instances = sample.positions.shape[2]
        matches = truth(**FIVE).select(frames=some, instances=instances)
        found = (adjust_once(sample, rig, matches, each) for each in (CONFIG, narrow))
        errors.append([(rotation_errors_deg(each, rig) ** 2).mean() for each in found])
    by_choice, by_narrow = np.mean(errors, axis=0)
    assert by_choice < 0.93 * by_narrow, (by_choice, by_narrow)
