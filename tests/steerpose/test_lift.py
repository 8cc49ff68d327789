"""Parts of lifting, held to their definitions."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import recording
from scipy.special import erfc

from mocap_calib.errors import MismatchError
from mocap_calib.steerpose.lift import _centre
from mocap_calib.steerpose.lifter import _gelu
from mocap_calib.steerpose.loading import choose_model, load_lifter


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
