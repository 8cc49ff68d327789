"""How many moments frames show, by how far bodies move in the images."""

from dataclasses import replace

import numpy as np
import pytest

from mocap_calib.adjust.bundle_adjustment import AdjustablePoints
from mocap_calib.adjust.distinct_moments import count_moments
from mocap_calib.config import UncertaintyConfig

CONFIG = UncertaintyConfig()
JOINTS = 10


def points_of(place: np.ndarray, views=3, size=50.0, seed=0) -> AdjustablePoints:
    """Return points of bodies whose middles are at places `[frame, body, 2]` in body sizes."""
    rng = np.random.default_rng(seed)
    frames, bodies = place.shape[:2]
    shape = (frames, bodies, JOINTS)
    joints = rng.normal(size=(views, 1, bodies, JOINTS, 2))
    joints -= joints.mean(3, keepdims=True)
    joints /= np.sqrt((joints**2).sum(-1).mean(3))[..., None, None]
    pixels = 500 + size * (joints + place[None, :, :, None])
    frame, individual, keypoint = (axis.ravel() for axis in np.indices(shape))
    count = frames * bodies * JOINTS
    return AdjustablePoints(
        points=np.zeros((3, count)),
        frame=frame,
        individual=individual,
        keypoint=keypoint,
        pixels=np.moveaxis(pixels.reshape(views, count, 2), 2, 1),
        rays=np.zeros((views, 3, count)),
        weight=np.ones((views, count)),
        noise=np.ones(views),
        loss_scale=3.0,
    )


def straight(frames, step):
    """A body that goes on by a step of its size from frame to frame."""
    return step * np.arange(frames)[:, None, None] * np.ones(2)


def test_who_stays_shows_one_moment_and_who_goes_about_as_many_as_frames():
    """Of a detector with errors of a thirtieth of a body."""
    rng = np.random.default_rng(0)
    jitter = 0.033 / np.sqrt(2) * rng.normal(size=(200, 1, 2))
    assert count_moments(points_of(jitter), CONFIG) == pytest.approx(1, abs=0.1)
    assert count_moments(points_of(straight(200, 1.0)), CONFIG) == pytest.approx(200, rel=1e-4)
    assert count_moments(points_of(straight(1, 1.0)), CONFIG) == 1


@pytest.mark.parametrize("places", [2, 4])
def test_places_that_are_taken_in_turns_are_as_many_moments(places):
    """Sixteen of 240 frames are looked at: within a fifth."""
    order = np.random.default_rng(1).integers(places, size=240)
    found = count_moments(points_of(straight(places, 1.0)[order]), CONFIG)
    assert found == pytest.approx(places, rel=0.2)


def test_one_who_goes_about_among_those_who_stay_makes_moments():
    still = np.zeros((100, 20, 2)) + 5 * np.arange(20)[:, None]
    assert count_moments(points_of(still), CONFIG) == pytest.approx(1, abs=0.05)
    still[:, 0] = straight(100, 1.0)[:, 0]
    assert count_moments(points_of(still), CONFIG) == pytest.approx(100, rel=1e-4)


def test_what_is_not_seen_is_not_counted():
    """Half of the points are in one view alone, and another view sees nothing."""
    points = points_of(straight(60, 1.0))
    weight = points.weight.copy()
    weight[0, ::2], weight[2] = 0, 0
    assert count_moments(replace(points, weight=weight), CONFIG) == pytest.approx(60, rel=1e-4)
    assert count_moments(replace(points, weight=np.zeros_like(weight)), CONFIG) == 1
