"""Parts of lifting, held to their definitions."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scenes import lifted, recording
from scipy.special import erfc

from mocap_calib.config import COMPLETION_CONFIDENCE, COMPLETION_SPREAD
from mocap_calib.errors import MismatchError
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.steerpose.completion import _confidence_of_lifted
from mocap_calib.steerpose.lift import _DOWN, _centre, _lift_rays, lift
from mocap_calib.steerpose.lifter import _gelu
from mocap_calib.steerpose.loading import choose_model, load_lifter
from mocap_calib.steerpose.training.evaluation import _project_turned
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


def test_the_activation_is_that_of_its_definition():
    """To what its approximation of erfc is good for, 1.5e-7, and single precision."""
    x = np.linspace(-6, 6, 2001)
    expected = x * erfc(-x / np.sqrt(2)) / 2
    found = _gelu(x.astype(np.float32))
    np.testing.assert_allclose(found, expected, rtol=3e-7, atol=4e-7)


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
    less = COMPLETION_CONFIDENCE * np.exp(-bodies.spread / COMPLETION_SPREAD)
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
