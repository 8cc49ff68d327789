"""Parts of lifting, held to their definitions."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scenes import lifted, recording
from scipy.special import erfc

from mocap_calib.config import LEAST_LIFT_SPREAD
from mocap_calib.errors import MismatchError
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.kernels.lifter import activate
from mocap_calib.lift import (
    _DOWN,
    _centre,
    _confidence_of_lifted,
    _confident_rays,
    _lift_rays,
    lift,
)
from mocap_calib.lift.lifter import choose_model, load_lifter
from mocap_calib.training import train
from mocap_calib.training.train import _project_turned
from mocap_calib.types import silent


def test_the_centre_puts_a_body_where_its_joints_are_seen():
    """Exactly, also where it is far from the middle of the image and joints are not seen."""
    rng = np.random.default_rng(0)
    body = rng.normal(0, 0.5, (20, 13, 3))
    centre = rng.uniform([-4, -3, 4], [4, 3, 12], (20, 3))
    points = body + centre[:, None]
    seen = rng.random((20, 13)) < 0.7
    image = np.where(seen[..., None], points[..., :2] / points[..., 2:], 0.0)
    np.testing.assert_allclose(_centre(body, image, seen), centre, atol=1e-9)


def test_the_kernel_of_the_activation_is_that_of_its_definition():
    """To what the approximation of erf is good for, 2e-7, and single precision."""
    x = np.linspace(-6, 6, 2001)
    expected = x * erfc(-x / np.sqrt(2)) / 2
    bias = np.array([0.5, -2.0], dtype=np.float32)
    compiled = (x[:, None] - bias).astype(np.float32)
    activate(compiled, bias)
    np.testing.assert_allclose(compiled, np.column_stack([expected] * 2), rtol=3e-7, atol=8e-7)


def test_a_network_of_too_few_joints_is_refused():
    found, lifter = recording(), load_lifter()[0]
    assert choose_model(found, lifter)[1] is lifter
    few = replace(lifter, config=replace(lifter.config, joints=int(found.vocabulary.max())))
    with pytest.raises(MismatchError, match="expected a network of the"):
        choose_model(found, few)


def test_several_subjects_without_joints_that_the_network_knows_are_refused():
    found = recording()
    unknown = replace(found, vocabulary=np.full_like(found.vocabulary, -1))
    with pytest.raises(MismatchError, match="joint names that the model knows"):
        lift(unknown, load_lifter()[0], progress=silent)


def test_a_joint_deserves_the_mean_confidence_of_the_detection_and_less():
    found, bodies = recording(), lifted()
    seen = found.confidence > 0
    mean = np.where(seen, found.confidence, 0).sum(-1) / np.maximum(seen.sum(-1), 1)
    spread = np.maximum(bodies.spread, LEAST_LIFT_SPREAD)
    less = LEAST_LIFT_SPREAD / (LEAST_LIFT_SPREAD + spread)
    assert np.nanmax(less) <= 0.5
    np.testing.assert_allclose(_confidence_of_lifted(found, bodies), mean[..., None] * less)


def test_the_directions_that_may_be_down_are_the_four_sides_of_an_image():
    sides = [[0, 1, 0], [1, 0, 0], [0, -1, 0], [-1, 0, 0]]
    np.testing.assert_array_equal(_DOWN, sides)


def test_a_body_turns_with_the_camera_that_sees_it():
    """A detection to the left and the same to the right: one body, turned by that angle."""
    rng = np.random.default_rng(0)
    lifter = load_lifter()[0]
    points = rng.normal(0, 0.4, (1, lifter.config.joints, 3)) + [0, 0, 6.0]
    rays = points / np.linalg.norm(points, axis=-1, keepdims=True)
    rays[:, 3] = np.nan
    turn = matrix_from_vector(np.array([0.0, 0.5, 0.0]))
    first, second = (_lift_rays(each, _DOWN[0], lifter) for each in (rays, rays @ turn.T))
    np.testing.assert_allclose(second.body, first.body @ turn.T, atol=1e-5)
    np.testing.assert_allclose(second.centre, first.centre @ turn.T, atol=1e-4)


def test_errors_seen_from_aside_keep_their_height():
    error = torch.randn(50, 7, 3, generator=torch.Generator().manual_seed(0))
    seen = _project_turned(error)
    assert torch.equal(seen[..., 1], error[..., 1])
    assert (seen[..., 0].abs() <= error[..., ::2].norm(dim=-1) + 1e-6).all()


def test_a_network_is_as_wrong_as_its_mean_joint(monkeypatch):
    """A lifter whose joints are all too low by 1, of which some are hidden."""
    pose, seen = torch.zeros(3, 5, 2), torch.ones(3, 5, dtype=torch.bool)
    seen[0, 1] = seen[2, 3:] = False
    target = torch.rand(3, 5, 3, generator=torch.Generator().manual_seed(0))
    batch = SimpleNamespace(pose=pose, seen=seen, target=target)
    made = SimpleNamespace(batch=lambda _: batch)
    monkeypatch.setattr(train, "Synthesiser", lambda *_, **__: made)
    found = train.held_out_error(
        lambda *_: (target + torch.tensor([0.0, 1.0, 0.0]), None), None, None, None
    )
    assert found == pytest.approx({"joint_3d": 1.0, "steered_2d": 1.0, "completed_2d": 1.0})


def test_joints_are_lifted_by_the_confidence_that_their_view_reaches_at_its_best():
    """So a detector whose confidences are a tenth of another's has the same ones lifted."""
    sample = recording()
    small = replace(sample, confidence=0.1 * sample.confidence)
    rays = _confident_rays(sample)
    np.testing.assert_array_equal(_confident_rays(small), rays)
    assert np.isfinite(rays).sum() > 0.9 * np.isfinite(sample.rays).sum()


def test_views_that_see_nobody_are_not_lifted():
    found, lifter = recording(), load_lifter()[0]
    nobody = replace(found, confidence=np.zeros_like(found.confidence))
    assert np.isnan(lift(nobody, lifter, progress=silent).body).all()
    hidden = found.confidence.copy()
    hidden[0] = 0
    part = lift(replace(found, confidence=hidden), lifter, progress=silent)
    assert np.isnan(part.body[0]).all()
    np.testing.assert_allclose(part.body[1:], lifted().body[1:], atol=1e-5)


def test_cameras_on_their_sides_lift_the_same_bodies_turned():
    """Each view finds its own direction of down; measured 3e-6."""
    found = recording()
    rays = found.rays.copy()
    turns = {view: matrix_from_vector(np.array([0.0, 0.0, view * np.pi / 2])) for view in range(4)}
    for view, turn in turns.items():
        rays[view] = found.rays[view] @ turn.T
    bodies = lift(replace(found, rays=rays), load_lifter()[0], progress=silent)
    for view, turn in turns.items():
        np.testing.assert_allclose(bodies.body[view], lifted().body[view] @ turn.T, atol=3e-5)
        np.testing.assert_allclose(bodies.spread[view], lifted().spread[view], atol=3e-5)
