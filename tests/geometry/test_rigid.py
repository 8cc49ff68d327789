"""Laws of rigid transforms."""

import numpy as np
import pytest

from mocap_calib.geometry.rigid import Rigid
from mocap_calib.geometry.rotation import matrix_from_vector


@pytest.fixture(name="transforms")
def random_transforms() -> Rigid:
    generator = np.random.default_rng(3)
    vectors = generator.normal(size=(4, 3))
    return Rigid(matrix_from_vector(vectors), generator.normal(size=(4, 3)))


def test_composition_applies_the_right_one_first(transforms):
    first, second = transforms[:2], transforms[2:]
    points = np.random.default_rng(4).normal(size=(2, 3))
    np.testing.assert_allclose(
        (second @ first).apply(points), second.apply(first.apply(points)), atol=1e-14
    )


def test_inverse_undoes_a_transform(transforms):
    unchanged = transforms.inverse @ transforms
    np.testing.assert_allclose(unchanged.rotation, np.tile(np.eye(3), (4, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(unchanged.translation, 0, atol=1e-14)


def test_centre_is_mapped_to_the_origin(transforms):
    np.testing.assert_allclose(transforms.apply(transforms.centre), 0, atol=1e-14)


def test_points_broadcast_over_an_axis_of_their_own(transforms):
    points = np.random.default_rng(5).normal(size=(7, 3))
    found = transforms[:, None].apply(points)
    assert found.shape == (4, 7, 3)
    np.testing.assert_allclose(found[2, 5], transforms[2].apply(points[5]), atol=1e-14)
