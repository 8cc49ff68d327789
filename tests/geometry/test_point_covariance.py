"""How sure points are, and what they take up of the errors: against what chance does to them."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from oracles import rays as oracle

from mocap_calib.config import INTERSECT_LOSS_SCALE
from mocap_calib.geometry.intersection import (
    _LEAST_SHARE,
    intersect,
    median_angles,
    point_covariance,
)
from mocap_calib.geometry.lens import (
    agreeing_views,
    ray_angles,
    rays_in_world,
)
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.types import Camera, CameraRig

NOISE = 0.003  # radians
UPPER = (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)  # xx xy xz yy yz zz
# where cameras stand: close together, around, on one side, and one much nearer than the others
PLACES = {
    "stereo": [(4, 0, 2), (3.5, 2, 2)],
    "facing": [(4, 0, 2), (-4, 0.5, 1)],
    "three": [(4, 0, 2), (-2, 3.5, 2), (-2, -3.5, 2)],
    "one near": [(1.5, 0, 1), (-5, 4, 2), (-5, -3, 2)],
    "one side": [(4, 0, 1), (4, 1, 2), (3.7, -1, 1.5), (3, 2.5, 2)],
    "eight": [(4 * np.cos(a), 4 * np.sin(a), 2) for a in np.arange(8) * np.pi / 4],
}


def rig_at(places) -> CameraRig:
    """Return cameras at places, that look at the middle."""
    centres = np.array(places, dtype=np.float64)
    forward = -centres / np.linalg.norm(centres, axis=1, keepdims=True)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    matrix = np.array([[1000.0, 0, 500], [0, 1000, 500], [0, 0, 1]])
    cameras = tuple(Camera(str(k), (1000, 1000), matrix) for k in range(len(centres)))
    return CameraRig(cameras, rotation, -np.einsum("vij,vj->vi", rotation, centres), "m")


def noisy_rays(rig: CameraRig, points: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return rays `[view, 3, N]` in the cameras' frames, each turned by chance; noise: `[view]`."""
    in_camera = rig.rotation @ points + rig.translation[:, :, None]
    rays = in_camera / np.linalg.norm(in_camera, axis=1, keepdims=True)
    turn = np.random.default_rng(0).normal(size=rays.shape) * noise[:, None, None]
    rays = rays + np.cross(turn, rays, axis=1)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def covariance_at(rig: CameraRig, point: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return the covariance `[3, 3]` of a point that all cameras see; noise: `[view]`."""
    precision = 1 / noise[:, None] ** 2
    exact = rays_in_world(rig, noisy_rays(rig, point[:, None], 0 * noise))
    found = point_covariance(rig, point[:, None], exact, precision=precision, variance=noise**2)
    xx, xy, xz, yy, yz, zz = np.concatenate(found)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@pytest.mark.parametrize("name", PLACES)
def test_covariances_are_what_points_scatter_by(name):
    """Within 15 % along each axis of the ellipsoid; the worst was 5 %, of 4000 points."""
    rig, point = rig_at(PLACES[name]), np.array([0.2, -0.3, 0.5])
    noise = np.full(len(rig), NOISE) * np.linspace(1, 2, len(rig))
    many = np.repeat(point[:, None], 4000, axis=1)
    world = rays_in_world(rig, noisy_rays(rig, many, noise))
    precision = np.broadcast_to(1 / noise[:, None] ** 2, (len(rig), 4000))
    points = intersect(rig, world, precision)
    entries = point_covariance(rig, points, world, precision=precision, variance=noise**2)
    xx, xy, xz, yy, yz, zz = (entry.mean() for entry in entries)
    stated = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    true = np.cov(points)
    ratio = np.linalg.eigvals(np.linalg.solve(stated, true)).real
    assert np.sqrt(ratio.max()) < 1.15
    assert np.sqrt(ratio.min()) > 0.85


@pytest.mark.parametrize("name", PLACES)
def test_the_kernel_gives_the_covariances_of_its_definition(name):
    """Of 200 points, some of which one view alone sees, or none."""
    rig, rng = rig_at(PLACES[name]), np.random.default_rng(len(name))
    points = rng.normal(size=(3, 200))
    world = rays_in_world(rig, noisy_rays(rig, points, np.full(len(rig), 10 * NOISE)))
    variance = rng.uniform(1, 4, len(rig)) * NOISE**2
    precision = (rng.random((len(rig), 200)) < 0.8) * rng.uniform(0.5, 1, 200) / variance[:, None]
    world[np.broadcast_to(precision[:, None] == 0, world.shape)] = 0.0
    given = {"precision": precision, "variance": variance}
    found = np.stack(point_covariance(rig, points, world, **given))
    sure = (precision > 0).sum(0) > 1
    assert sure.sum() > 50
    each = zip(points.T[sure], world.T[sure], precision.T[sure], strict=True)
    expected = np.transpose(
        [
            oracle.point_covariance(rig, point, rays.T, weight, variance)[UPPER]
            for point, rays, weight in each
        ]
    )
    relative = (found[:, sure] - expected) / np.abs(expected).max(0)
    # 4e-7 where the two views that see a point are nearly in line with it
    assert np.abs(relative).max() < 1e-5
    assert not found[:, precision.sum(0) == 0].any()


def test_covariances_grow_with_the_square_of_noise_and_size():
    rig, point = rig_at(PLACES["three"]), np.array([0.2, -0.3, 0.5])
    noise = np.array([1.0, 2.0, 3.0]) * NOISE
    one = covariance_at(rig, point, noise)
    np.testing.assert_allclose(covariance_at(rig, point, 3 * noise), 9 * one, rtol=1e-6)
    larger = replace(rig, translation=1000 * rig.translation)
    np.testing.assert_allclose(covariance_at(larger, 1000 * point, noise), 1e6 * one, rtol=1e-6)


def test_covariances_turn_with_the_world():
    rig, point = rig_at(PLACES["one side"]), np.array([0.2, -0.3, 0.5])
    turn = matrix_from_vector(np.array([0.3, -1.0, 0.7]))
    noise = np.full(4, NOISE)
    turned = covariance_at(replace(rig, rotation=rig.rotation @ turn.T), turn @ point, noise)
    np.testing.assert_allclose(
        turned, turn @ covariance_at(rig, point, noise) @ turn.T, atol=1e-6 * turned.max()
    )


def test_more_views_make_a_point_surer_in_every_direction():
    whole, point = rig_at(PLACES["eight"]), np.array([0.2, -0.3, 0.5])
    noise = np.full(8, NOISE)
    found = [covariance_at(whole.select(np.arange(n)), point, noise[:n]) for n in (2, 3, 5, 8)]
    for fewer, more in pairwise(found):
        assert np.linalg.eigvalsh(fewer - more).min() > -1e-6 * fewer.max()
        assert np.trace(more) < 0.9 * np.trace(fewer)


def test_a_ray_that_is_not_used_does_not_count():
    rig, point = rig_at(PLACES["three"]), np.array([0.2, -0.3, 0.5])
    noise = np.full(3, NOISE)
    variance = np.full(3, NOISE**2)
    world = rays_in_world(rig, noisy_rays(rig, point[:, None], 0 * noise))
    used = np.array([[1.0], [0.0], [1.0]])
    found = point_covariance(
        rig, point[:, None], world, precision=used / NOISE**2, variance=variance
    )
    two = covariance_at(rig.select(np.array([0, 2])), point, noise[:2])
    np.testing.assert_allclose(found[0], two[0, 0], rtol=1e-9)


@pytest.mark.parametrize("name", PLACES)
def test_median_angles_tell_the_noise_in_any_rig(name):
    """Within 6 % in each view, the worst was 3 %.

    The plain factor sqrt(1 - 3 / (2 V)) would err by 44 % in the near camera of `one near`.
    """
    rig = rig_at(PLACES[name])
    points = np.random.default_rng(1).normal(size=(3, 4000)) * 0.3
    rays = noisy_rays(rig, points, np.full(len(rig), NOISE))
    weight = np.ones((len(rig), 4000))
    found = intersect(rig, rays_in_world(rig, rays), weight * 1e4)
    angle, _ = ray_angles(rig, found, rays)
    noise = np.median(angle / median_angles(rig, found, weight), axis=1)
    np.testing.assert_allclose(noise, NOISE, rtol=0.06)


def test_the_median_angle_of_a_view_that_hardly_counts_is_that_of_plain_noise():
    """Two normal errors: sqrt(2 ln 2). Wilson and Hilferty's median is 0.7 % above it."""
    rig, points = rig_at(PLACES["three"]), np.array([[0.2], [-0.3], [0.5]])
    weight = np.array([[1e-9], [1.0], [1.0]])
    median = median_angles(rig, points, weight)[0, 0]
    assert median == pytest.approx(np.sqrt(2 * np.log(2)), rel=0.01)


def test_a_view_that_sees_nothing_of_a_point_changes_nothing_for_the_others():
    """Of 24 cameras each point is seen by three neighbours: blocks leave out the others."""
    angle = np.arange(24) * np.pi / 12
    rig = rig_at(np.column_stack([4 * np.cos(angle), 4 * np.sin(angle), 1 + 0.05 * angle]))
    rng = np.random.default_rng(3)
    points = 0.3 * rng.normal(size=(3, 50))
    weight = np.zeros((24, 50))
    views = (rng.integers(0, 24, 50) + np.arange(3)[:, None]) % 24
    weight[views, np.arange(50)] = rng.uniform(0.2, 1.0, (3, 50))
    found = median_angles(rig, points, weight)
    for point, of_point in enumerate(views.T):
        alone = median_angles(
            rig.select(of_point), points[:, [point]], weight[of_point][:, [point]]
        )
        np.testing.assert_allclose(found[of_point, point], alone[:, 0], rtol=1e-9)
    np.testing.assert_allclose(found[weight == 0], np.sqrt(2 * np.log(2)), rtol=0.01)


def test_a_ray_that_is_off_by_the_scale_of_the_loss_counts_a_quarter():
    """Of Geman and McClure's loss: the same covariance as of a quarter of its weight."""
    rig, point = rig_at(PLACES["one side"]), np.array([[0.1], [0.2], [-0.1]])
    world = point - rig.centres[:, :, None]
    world /= np.linalg.norm(world, axis=1, keepdims=True)
    variance, full = np.full(4, NOISE**2), np.full((4, 1), NOISE**-2.0)
    off, less = world.copy(), full.copy()
    across = np.cross(world[3, :, 0], [0.0, 0.0, 1.0])
    angle = np.arcsin(INTERSECT_LOSS_SCALE * NOISE)
    off[3, :, 0] = matrix_from_vector(angle * across / np.linalg.norm(across)) @ world[3, :, 0]
    less[3] /= 4
    found = point_covariance(rig, point, off, precision=full, variance=variance)
    expected = point_covariance(rig, point, world, precision=less, variance=variance)
    np.testing.assert_allclose(np.ravel(found), np.ravel(expected), rtol=1e-6)


@pytest.mark.parametrize("name", PLACES)
def test_angles_are_compiled_as_they_are_defined(name):
    """Of rays that are missing, too, and of points that are not known."""
    rig, rng = rig_at(PLACES[name]), np.random.default_rng(4)
    points = 0.5 * rng.normal(size=(3, 300))
    rays = noisy_rays(rig, points, np.full(len(rig), 0.3))
    points[:, :20], rays[0, :, 30:40], rays[1, :, 50] = np.nan, np.nan, -rays[1, :, 50]
    weight = np.where(rng.random((len(rig), 300)) < 0.3, 0.0, rng.uniform(0, 2, (len(rig), 300)))

    world = rays_in_world(rig, rays)
    expected = np.swapaxes(rig.rotation, 1, 2) @ np.nan_to_num(rays)
    np.testing.assert_allclose(world, expected, atol=1e-15)
    assert not world[0, :, 30:40].any()
    angle, in_front = ray_angles(rig, points, rays)
    in_camera = rig.rotation @ points + rig.translation[:, :, None]
    expected, along = oracle.ray_angles(in_camera, rays)
    np.testing.assert_allclose(angle, expected, atol=1e-12)
    np.testing.assert_array_equal(in_front, along > 0)
    assert (angle[:, :20] == np.pi).all()
    assert (angle[0, 30:40] == np.pi).all()
    assert in_front[1].any()
    assert not in_front[1, 50]

    known = (weight > 0).sum(0) >= 2  # along a single ray the covariance is a matter of rounding
    known &= np.isfinite(points[0])
    found = median_angles(rig, points, weight)[:, known]
    each = zip(points.T[known], weight.T[known], strict=True)
    defined = np.transpose([oracle.median_angles(rig, *given, _LEAST_SHARE) for given in each])
    seen = weight[:, known] > 0
    # of two rays that are nearly in line the ridge counts
    np.testing.assert_allclose(found[seen], defined[seen], rtol=1e-5)


@pytest.mark.parametrize("name", PLACES)
def test_agreement_is_compiled_as_it_is_defined(name):
    """Of points that are unknown, rays that are missing, behind, or of another point, too."""
    rig, rng = rig_at(PLACES[name]), np.random.default_rng(5)
    views, points = len(rig), 0.5 * rng.normal(size=(3, 500))
    rays = noisy_rays(rig, points, np.full(views, NOISE))
    rays *= np.where(rng.random((views, 1, 500)) < 0.05, -1, 1)
    rays[0, :, 30:40] = np.nan
    world, points[:, :20] = rays_in_world(rig, rays), np.nan
    weight = np.where(rng.random((views, 500)) < 0.2, 0.0, rng.uniform(0, 2, (views, 500)))
    limits = 2 * NOISE * np.linspace(1.0, 1.5, views + 1) * np.ones((views, 1))
    limits[1] = 2.0  # wider than a right angle: whatever is in front
    for least_angle in (0.1, 0.7):
        given = {"limits": limits, "least_angle": least_angle}
        found = agreeing_views(rig, points, world, weight, **given)
        expected = oracle.agreeing_views(rig, points, world, weight, **given)
        np.testing.assert_array_equal(found, expected)
        assert not found[:, :20].any()
        assert not found[0, 30:40].any()
        assert not found[weight == 0].any()
        assert (found.sum(0) != 1).all()
    narrow = agreeing_views(rig, points, world, weight, limits=limits, least_angle=0.1)
    assert 0.2 < narrow.any(0).mean() < 1.0
