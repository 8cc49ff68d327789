"""Points from rays, how exact they are, and poses from labels: laws, and scenes with truth."""

import numpy as np
import pytest
from rigs import unit
from scenes import recording, scene, truth

from mocap_calib.config import TriangulateConfig
from mocap_calib.errors import MismatchError
from mocap_calib.geometry.lens import project_views, unproject_views
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.rig import (
    MEDIAN_DISTANCE,
    gather_tracks,
    measure_residuals,
    noise_of_rays,
    view_noise,
)
from mocap_calib.rig.triangulate import (
    frame_blocks,
    observe_points,
    triangulate,
    triangulate_pixels,
    triangulate_rays,
)
from mocap_calib.types import CameraRig

CHI2_95 = 7.815  # of three degrees of freedom
CAMERAS = [2, 3, 5]
CONFIG = TriangulateConfig()
close = np.testing.assert_allclose


def rays_to(rig: CameraRig, points: np.ndarray) -> np.ndarray:
    """Return the rays `[view, 3, N]` to points `[N, 3]`."""
    return unit(rig.rotation @ points.T + rig.translation[:, :, None], 1)


def meet(
    rig: CameraRig, rays: np.ndarray, *, weight=None, noise: float = 1e-3, **changes: float
) -> tuple[np.ndarray, np.ndarray]:
    """Triangulate rays `[view, 3, N]` that all weigh the same."""
    weight = np.ones((len(rig), rays.shape[2])) if weight is None else weight
    config = TriangulateConfig(**changes)
    return triangulate_rays(rig, rays, weight=weight, noise=np.full(len(rig), noise), config=config)


def points_about(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.uniform(-1, 1, (count, 3)) + [0, 0, 1]


# points


@pytest.mark.parametrize("views", [4, 40])
def test_a_rig_triangulates_as_the_views_that_see_a_point_do(views):
    """Blocks of a large rig leave out views that see nothing of them; measured 2e-9 m apart."""
    rig, rng = scene(cameras=views).rig, np.random.default_rng(3)
    points, each = points_about(rng, 1500), min(8, views - 1)
    first = rng.integers(0, views, 1500)  # each point is seen by views that follow each other
    weight = np.zeros((views, 1500))
    for k in range(each):
        weight[(first + k) % views, np.arange(1500)] = 1.0
    exact, used = meet(rig, rays_to(rig, points), weight=weight)
    close(exact.T, points, atol=1e-6)
    np.testing.assert_array_equal(used, weight > 0)
    rays = unit(rays_to(rig, points) + rng.normal(0, 1e-3, (views, 3, 1500)), 1)
    found, used = meet(rig, rays, weight=weight)
    assert not used[weight == 0].any()
    assert used.sum() > 0.95 * weight.sum()
    for start in range(views):
        own, some = first == start, (start + np.arange(each)) % views
        alone, agree = meet(rig.select(some), rays[some][..., own])
        close(found[:, own], alone, atol=1e-8)
        np.testing.assert_array_equal(used[np.ix_(some, own)], agree)


def test_one_outlying_view_is_found_and_left_out():
    rig, points = scene().rig, points_about(np.random.default_rng(1), 300)
    rays = rays_to(rig, points)
    bad, each = np.random.default_rng(2).integers(4, size=300), np.arange(300)
    rays[bad, :, each] = rays[bad, :, each] @ matrix_from_vector(np.array([0.1, 0.05, 0.0])).T
    found, used = meet(rig, rays, noise=2e-3)
    assert np.median(np.linalg.norm(found.T - points, axis=1)) < 2e-3
    assert not used[bad, each].any()
    assert (used.sum(0) == 3).mean() > 0.99


@pytest.mark.parametrize("views", [3, 8])
@pytest.mark.parametrize("outlier", [1.5, 2.5])
def test_a_ray_is_left_out_beyond_the_limit_of_what_a_point_leaves_of_its_error(views, outlier):
    """Of normal errors as many as of a plane; measured within 0.033.

    A point takes three of the 2 V numbers of V rays: without that 0.22 more of three would stay.
    """
    rig, rng = scene(cameras=views).rig, np.random.default_rng(0)
    exact = rays_to(rig, points_about(rng, 4000))
    rays = unit(exact + 1e-3 * rng.normal(size=exact.shape), 1)
    _, used = meet(rig, rays, outlier=outlier)
    assert used.mean() == pytest.approx(1 - np.exp(-(outlier**2) / 2), abs=0.05)


def test_two_views_that_disagree_or_look_alike_give_nothing():
    rig, points = scene(cameras=2).rig, np.array([[0.0, 0.0, 1.0]])
    rays = rays_to(rig, points)
    off = rays.copy()
    off[0, :, 0] += 0.1 * unit(
        np.cross(rig.rotation[0] @ np.diff(rig.centres, axis=0)[0], off[0, :, 0])
    )
    assert np.isnan(meet(rig, unit(off, 1))[0]).all()
    assert np.isnan(meet(rig, rays, least_angle_deg=179.0)[0]).all()
    assert np.isfinite(meet(rig, rays)[0]).all()


def test_a_point_behind_its_views_is_none_however_rough_they_are():
    """Rays the other way meet in the same point; angles of more than half a turn may pass."""
    rig = scene(cameras=3).rig
    found, used = meet(rig, -rays_to(rig, np.array([[0.1, 0.2, 1.0]])), noise=2.0)
    assert np.isnan(found).all()
    assert not used.any()


# the noise of views


def measure(function, **changes):
    """Return what a function measures of a scene, in radians."""
    return function(recording(**changes), scene(**changes).rig, truth(**changes), CONFIG)


def true_points(**changes) -> np.ndarray:
    """Return the true points `[frame, individual, keypoint, 3]`."""
    made = scene(**changes)
    joints = [made.joints.index(name) for name in recording(**changes).keypoints]
    return made.poses[:, :, joints]


def true_noise(**changes) -> np.ndarray:
    """Return the median angle `[view]` of rays from where they should go, as `view_noise` does."""
    rig, found = scene(**changes).rig, recording(**changes)
    seen = gather_tracks(found, truth(**changes), np.arange(len(found.frames)))
    exact = rays_to(rig, true_points(**changes).reshape(-1, 3))
    angle = np.linalg.norm(np.cross(exact, seen.rays, axis=1), axis=1)
    return np.nanmedian(angle, axis=1) / MEDIAN_DISTANCE


@pytest.mark.parametrize("cameras", CAMERAS)
def test_the_noise_is_that_of_the_detections_and_points_leave_less_of_it(cameras):
    """Within 15 %; measured -2 to +11 %. Two rays have one number for the noise of both.

    Of the 2 V numbers of V rays three less are left; what two rays leave has one direction alone.
    """
    noise = measure(view_noise, cameras=cameras)
    close(noise, true_noise(cameras=cameras), rtol=0.15)
    residual, _ = measure(measure_residuals, cameras=cameras)
    expected = np.sqrt(1 - 3 / (2 * cameras)) if cameras > 2 else 0.405
    close((residual / noise).mean(), expected, rtol=0.08)


@pytest.mark.parametrize("cameras", CAMERAS)
def test_regions_of_points_hold_the_truth(cameras):
    """Measured: .91, .91 and .94 of the regions of 95 %.

    The rig is known, but errors are of many sizes, and 2 % of them gross.
    """
    size = {"cameras": cameras}
    poses = triangulate(recording(**size), scene(**size).rig, truth(**size))
    error = poses.positions - true_points(**size)
    known = np.isfinite(error).all(-1)
    entries = poses.covariance[known].astype(np.float64)
    matrix = entries[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    square = (error[known] * np.linalg.solve(matrix, error[known][..., None])[..., 0]).sum(-1)
    assert 0.88 < (square < CHI2_95).mean() < 0.98
    assert (np.isfinite(poses.covariance).all(-1) == known).all()
    close(poses.sigma[known], np.sqrt(np.trace(matrix, axis1=1, axis2=2)), rtol=1e-5)


def test_views_of_few_points_are_as_noisy_as_all_together():
    """One of four errs ten times as much, which 20 points do not tell.

    Some of its error goes into the points: measured 1.7 times that of the worst of the others.
    """
    rig, rng = scene().rig, np.random.default_rng(0)
    points = np.concatenate(true_points()[:8].reshape(8, -1, 3))
    pixels = np.swapaxes(project_views(rig, points.T), 1, 2)
    pixels += np.array([0.5, 0.5, 0.5, 5.0])[:, None, None] * rng.normal(size=pixels.shape)
    focal = np.array([camera.focal for camera in rig.cameras])
    known = np.ones(pixels.shape[:2])
    rays = unproject_views(rig.cameras, pixels, by_component=True)
    noise = noise_of_rays(rig, rays, known, CONFIG)
    assert noise[3] * focal[3] > 1.4 * (noise * focal)[:3].max()
    known[3, 20:] = 0.0
    close(noise_of_rays(rig, rays, known, CONFIG) * focal, 0.5, rtol=0.2)


# poses


def test_poses_of_true_rig_and_labels_are_the_truth():
    """In metres: median 5 mm measured with 2 px noise; and the error says 2 px a coordinate.

    Single pixels give the same points. A rig of other cameras is refused.
    """
    made, found = scene(), recording()
    poses = triangulate(found, made.rig, truth())
    gap = np.linalg.norm(poses.positions - true_points(), axis=-1)
    assert np.nanmedian(gap) < 0.01
    assert np.isfinite(gap).mean() > 0.97
    assert 1.0 < np.nanmedian(poses.error) < 3.5
    assert poses.unit == "m"
    assert set(np.unique(poses.views)) <= {0, 2, 3, 4}
    seen = gather_tracks(found, truth(), np.arange(60))
    points, error = triangulate_pixels(made.rig, np.swapaxes(seen.pixels, 1, 2), seen.weight)
    close(points, poses.positions.reshape(-1, 3), atol=1e-6)
    close(error, poses.error.ravel(), atol=1e-4)
    with pytest.raises(MismatchError):
        triangulate(found, made.rig.select(np.array([1, 0, 2, 3])), truth())


def test_observed_points_are_the_points_and_the_detections_of_the_poses():
    """In several blocks of frames: every point once, a detection for each view that counted."""
    made, found, matches = scene(frames=400), recording(frames=400), truth(frames=400)
    poses = triangulate(found, made.rig, matches)
    points = observe_points(found, made.rig, matches)
    known = np.isfinite(poses.positions[..., 0])
    assert len(frame_blocks(400, known[0].size)) > 1
    np.testing.assert_array_equal(points.positions, poses.positions[known])
    views = np.bincount(points.point, minlength=len(points.positions))
    np.testing.assert_array_equal(views, poses.views[known])
    there = project_views(made.rig, points.positions.T)[points.view, :, points.point]
    square = ((there - points.pixels) ** 2).sum(1)
    close(np.sqrt(np.bincount(points.point, square) / views), poses.error[known], rtol=1e-9)
