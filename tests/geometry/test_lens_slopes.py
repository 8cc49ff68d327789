"""How pixels move with what they are images of, and cameras of other intrinsics."""

import numpy as np
import pytest
from test_geometry import CAMERAS

from mocap_calib.geometry import lens


def pixels(camera, image):
    return lens.project(camera, np.concatenate([image, np.ones((1, image.shape[1]))]))


def assert_slopes(camera, image, *, nudge: float, off: float) -> None:
    """Hold the slopes of pixels to central differences, within a share of the largest."""
    found = lens.image_slopes(camera, image)
    for axis in range(2):
        step = nudge * np.eye(2)[:, axis, None]
        slope = (pixels(camera, image + step) - pixels(camera, image - step)) / (2 * nudge)
        np.testing.assert_allclose(found.image[:, axis], slope, atol=off * np.abs(slope).max())
    for key in ("log_focal", "k1"):
        ahead, behind = (
            lens.change_intrinsics(camera, **{"log_focal": 0.0, "k1": 0.0, key: step})
            for step in (nudge, -nudge)
        )
        slope = (pixels(ahead, image) - pixels(behind, image)) / (2 * nudge)
        np.testing.assert_allclose(
            getattr(found, key), slope, atol=off * np.abs(slope).max(), err_msg=key
        )


@pytest.mark.parametrize("name", CAMERAS)
def test_slopes_are_those_of_central_differences(name):
    """Measured 2e-9 of the largest."""
    image = np.random.default_rng(0).uniform(-0.5, 0.5, (2, 200))
    assert_slopes(CAMERAS[name], image, nudge=1e-6, off=1e-7)


def test_changed_intrinsics_scale_both_focal_lengths_and_add_to_k1():
    camera = CAMERAS["brown"]
    changed = lens.change_intrinsics(camera, log_focal=np.log(2), k1=0.1)
    expected = camera.matrix * [[2, 1, 1], [1, 2, 1], [1, 1, 1]]
    np.testing.assert_allclose(changed.matrix, expected, rtol=1e-15)
    np.testing.assert_allclose(changed.distortion, camera.distortion + [0.1, 0, 0, 0, 0])
    assert camera.distortion[0] == -0.2  # the one that was given is as it was
