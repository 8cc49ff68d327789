"""A subject no model knows: one individual, geometry alone; and cameras too far away for perspective."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import calibrate_group, recording, rotation_errors_deg, scene

from mocap_calib.config import Config
from mocap_calib.geometry.projection import pixels_from_points, rays_from_pixels
from mocap_calib.multi_view.association import single_subject
from mocap_calib.multi_view.factorization import factorise
from mocap_calib.multi_view.fit import measure_fit
from mocap_calib.types import Camera, CameraRig, Recording, Sample

REVERSE = np.diag([1.0, 1.0, -1.0])
ALONE = {"people": 1, "false_detections": 0.0, "outliers": 0.0}


def strangers(found: Recording) -> Recording:
    """The same, with joints that no model knows."""
    return replace(
        found,
        keypoints=tuple(f"marker{k}" for k in range(len(found.keypoints))),
        vocabulary=np.full(len(found.keypoints), -1),
    )


def telescopes(noise: float, focal: float = 40_000.0) -> tuple[Sample, CameraRig]:
    """Three cameras that see a wriggling cloud of 12 markers from a thousand times its size."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(12, 3)) + 0.5 * rng.normal(size=(200, 12, 3))
    angle = np.deg2rad([0.0, 40.0, 85.0])
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros(3), np.ones(3)
    tilt = np.array([[1, 0, 0], [0, np.cos(0.4), -np.sin(0.4)], [0, np.sin(0.4), np.cos(0.4)]])
    turn = np.stack([c, zero, s, zero, one, zero, -s, zero, c], axis=1).reshape(-1, 3, 3)
    rotation = np.stack([turn[0], tilt @ turn[1], turn[2] @ tilt])
    cameras = tuple(
        Camera(
            f"c{k}",
            (800, 600),
            np.array([[focal, 0, 400], [0, focal, 300], [0, 0, 1.0]]),
            np.zeros(5),
            False,
        )
        for k in range(3)
    )
    rig = CameraRig(cameras, rotation, np.array([[0.0, 0.0, 1000.0]] * 3), "arbitrary")
    images = np.stack(
        [
            pixels_from_points(camera, points @ r.T + t)
            for camera, r, t in zip(cameras, rotation, rig.translation, strict=True)
        ]
    )
    images = (images + noise * rng.normal(size=images.shape))[:, :, None]
    rays = np.stack(
        [rays_from_pixels(camera, seen) for camera, seen in zip(cameras, images, strict=True)]
    )
    names = tuple(f"marker{k}" for k in range(12))
    made = Sample(
        cameras,
        names,
        np.arange(200),
        images,
        np.ones(images.shape[:-1]),
        np.ones(3, dtype=bool),
        np.full(12, -1),
        rays,
    )
    return made, rig


def test_factorisation_is_exact_up_to_a_reversal():
    """No noise, 1 / 1000 of perspective: measured 0.02 deg in one of the two, tens of degrees in the other."""
    seen, rig = telescopes(0.0)
    errors = [
        rotation_errors_deg(found, rig).max() for found in factorise(seen, single_subject(seen))
    ]
    assert min(errors) < 0.1
    assert max(errors) > 10.0


def test_the_two_rigs_are_reversals_of_each_other():
    seen, _ = telescopes(1.0)
    first, second = factorise(seen, single_subject(seen))
    assert np.allclose(REVERSE @ first.rotation @ REVERSE, second.rotation, atol=1e-12)
    assert np.allclose(first.translation, second.translation, atol=1e-9)


def test_two_views_are_not_factorised():
    seen, _ = telescopes(0.0)
    two = replace(
        seen,
        cameras=seen.cameras[:2],
        **{
            name: getattr(seen, name)[:2] for name in ("positions", "confidence", "rays", "tracked")
        },
    )
    assert factorise(two, single_subject(two)) == ()


def test_a_single_subject_is_known_without_finding():
    alone = single_subject(recording(**ALONE))
    assert alone is not None
    assert set(np.unique(alone.labels)) <= {-1, 0}
    assert single_subject(recording()) is None


def test_strangers_are_calibrated_by_geometry_alone():
    """One person whose joints have names nobody knows: measured 0.38 deg."""
    found = calibrate_group(strangers(recording(**ALONE)))
    assert rotation_errors_deg(found.rig, scene(**ALONE).rig).max() < 0.8
    assert found.adjusted.depth_reversed_rig is None
    assert not found.uncertainty.weak_perspective.any()


def test_telescopes_are_calibrated_up_to_a_reversal_and_say_so():
    """One pixel of noise, a twentieth of a pixel of perspective: measured 0.17 deg for the better of both rigs."""
    seen, rig = telescopes(1.0)
    found = calibrate_group(seen)
    assert found.adjusted.depth_reversed_rig is not None
    assert (
        min(
            rotation_errors_deg(one, rig).max()
            for one in (found.rig, found.adjusted.depth_reversed_rig)
        )
        < 1.0
    )
    assert found.uncertainty.weak_perspective.all()


@pytest.mark.parametrize("noise", [0.5, 2.0])
def test_the_misfit_is_the_noise(noise):
    """Three views of a point: 6 numbers, 3 unknowns, so an RMS residual of sqrt(2) noise / sqrt(2); margin 15 %."""
    seen, rig = telescopes(noise)
    fit = measure_fit(seen, rig, single_subject(seen), Config())
    assert fit.misfit == pytest.approx(noise, rel=0.15)
