"""Unknowns of a camera are no more certain than its leave-one-out rig."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
from scenes import scene

from mocap_calib.adjust.camera_fit import Seen, fit_camera, pose_of, shift_of_unknowns
from mocap_calib.config import CameraFitConfig, Config
from mocap_calib.faults import leave_one_out
from mocap_calib.geometry.rotation import changed_rig, project_out_similarity, rig_change
from mocap_calib.types import CameraRig

FREE = ("log_focal", "x", "y")
NOISE = 5.0


def test_unknowns_follow_their_points_as_if_fitted_again():
    """Measured: 3 % of the largest change; the weights move a little, too."""
    rig, rng = scene().rig, np.random.default_rng(0)
    camera, pose = rig.cameras[0], pose_of(rig, 0)
    points = rng.uniform((-1.5, -1.5, 0.0), (1.5, 1.5, 1.8), size=(400, 3))
    image = points @ pose[:, :3].T + pose[:, 3]
    pixels = (image / image[:, 2:] @ camera.matrix.T)[:, :2] + rng.normal(0, 2.0, size=(400, 2))
    blocks = np.arange(400) // 20
    seen = Seen(points, pixels, block=blocks, keypoint=np.arange(400) % 17)
    config = CameraFitConfig()
    fit = fit_camera(camera, seen, pose, config, noise=NOISE, free=FREE)
    bent = points + 0.002 * points[:, [1, 2, 0]] ** 2
    moved = replace(seen, points=bent)
    again = fit_camera(camera, moved, fit.pose, config, noise=NOISE, free=FREE)
    change = again.unknowns - fit.unknowns
    shift = shift_of_unknowns(camera, moved, fit, config, noise=NOISE, free=FREE)
    assert np.abs(change).max() > 0.5
    # measured: 0.08 of the largest
    np.testing.assert_allclose(shift, change, atol=0.1 * np.abs(change).max())


def test_a_rig_is_changed_by_what_was_found_between_two():
    rig = scene().rig
    change = np.random.default_rng(1).normal(0, 1e-4, size=(len(rig.cameras), 6))
    change = project_out_similarity(change, rig)
    np.testing.assert_allclose(rig_change(rig, changed_rig(rig, change)), change, atol=1e-7)


@dataclass(frozen=True)
class SimplePlaced:
    """Cameras that place bodies, without noise."""

    rig: CameraRig
    matches: None


def test_a_rig_is_bent_along_its_least_certain_axes_first(monkeypatch):
    """Each change is small, and its factor makes it one standard deviation."""
    rig, config, seen = scene().rig, Config(), []
    views = len(rig.cameras)
    sigma = np.full(6 * views, 1e-4)
    sigma[6 * 2 + 3], sigma[6 * 1 + 1] = 0.05, 0.02  # camera 2 along x, camera 1 about y
    matrix = np.diag(sigma**2).reshape(views, 6, views, 6)
    others = SimpleNamespace(
        rig=rig,
        placed=SimplePlaced(rig, None),
        sample=None,
        frames=None,
        covariance=SimpleNamespace(matrix=matrix),
    )
    monkeypatch.setattr(
        leave_one_out, "place_bodies", lambda _, placed, *__: seen.append(placed.rig)
    )
    times = [each for each, _ in leave_one_out.bent_points(others, config)]
    assert len(times) == min(6 * views, 24)
    for order, index in enumerate((6 * 2 + 3, 6 * 1 + 1)):
        change = times[order] * rig_change(rig, seen[order]).ravel()
        expected = project_out_similarity(sigma[index] * np.eye(6 * views)[index], rig).ravel()
        np.testing.assert_allclose(np.sign(change @ expected) * change, expected, atol=1e-4)
