"""Points from rays, and poses from labels."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scenes import recording, scene, truth

from mocap_calib.config import TriangulateConfig
from mocap_calib.geometry.lens import project_views, reprojection_error
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.rig.triangulate import (
    frame_blocks,
    observe_points,
    triangulate,
    triangulate_rays,
)
from mocap_calib.types import CameraRig, silent


def ring(views: int) -> CameraRig:
    """Return cameras on a ring, without distortion."""
    rig = scene(cameras=views).rig
    cameras = tuple(replace(camera, distortion=np.zeros(5)) for camera in rig.cameras)
    return replace(rig, cameras=cameras)


def rays_to(rig: CameraRig, points: np.ndarray) -> np.ndarray:
    """Return the rays `[view, 3, N]` to points `[N, 3]`."""
    in_camera = rig.rotation @ points.T + rig.translation[:, :, None]
    return in_camera / np.linalg.norm(in_camera, axis=1, keepdims=True)


def meet(
    rig: CameraRig, rays: np.ndarray, *, weight=None, noise: float = 1e-3, **changes: float
) -> tuple[np.ndarray, np.ndarray]:
    """Triangulate rays `[view, 3, N]` that all weigh the same."""
    views, _, count = rays.shape
    return triangulate_rays(
        rig,
        rays,
        weight=np.ones((views, count)) if weight is None else weight,
        noise=np.full(views, noise),
        config=TriangulateConfig(**changes),
    )


@pytest.mark.parametrize("views", [2, 4, 9])
def test_exact_rays_meet_in_their_point(views):
    rig, points = ring(views), np.random.default_rng(0).uniform(-1, 1, (300, 3)) + [0, 0, 1]
    found, used = meet(rig, rays_to(rig, points))
    np.testing.assert_allclose(found.T, points, atol=1e-6)
    assert used.all()


@pytest.mark.parametrize("views", [8, 10, 13])
def test_any_two_or_three_views_of_a_large_rig_will_do(views):
    """Not only those that are neighbours; two views may face each other, so 0.1 mm."""
    rig, point = ring(views), np.array([[0.1, -0.2, 1.1]])
    subsets = [*combinations(range(views), 2), *combinations(range(views), 3)]
    weight = np.zeros((views, len(subsets)))
    for n, subset in enumerate(subsets):
        weight[list(subset), n] = 1.0
    rays = np.repeat(rays_to(rig, point), len(subsets), axis=2)
    found, _ = meet(rig, rays, weight=weight)
    np.testing.assert_allclose(found.T, np.broadcast_to(point, (len(subsets), 3)), atol=1e-4)


def test_a_large_rig_triangulates_as_its_parts_do():
    """Its blocks leave out views that see nothing of them; measured 2e-9 m apart."""
    rig, rng = ring(40), np.random.default_rng(3)
    points = rng.uniform(-1, 1, (1500, 3)) + [0, 0, 1]
    first = rng.integers(0, 40, 1500)  # each point is seen by eight views that follow each other
    rays, weight = rays_to(rig, points), np.zeros((40, 1500))
    for k in range(8):
        weight[(first + k) % 40, np.arange(1500)] = 1.0
    rays += rng.normal(0, 1e-3, rays.shape)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    found, used = meet(rig, rays, weight=weight)
    assert not used[weight == 0].any()
    assert used.sum() > 0.95 * weight.sum()
    for start in range(40):
        own, views = first == start, (start + np.arange(8)) % 40
        alone, agree = meet(rig.select(views), rays[views][..., own])
        np.testing.assert_allclose(found[:, own], alone, atol=1e-8)
        np.testing.assert_array_equal(used[np.ix_(views, own)], agree)


def test_one_outlying_view_is_found_and_left_out():
    rig, points = ring(4), np.random.default_rng(1).uniform(-1, 1, (300, 3)) + [0, 0, 1]
    rays = rays_to(rig, points)
    bad, each = np.random.default_rng(2).integers(4, size=300), np.arange(300)
    rays[bad, :, each] = rays[bad, :, each] @ matrix_from_vector(np.array([0.1, 0.05, 0.0])).T
    found, used = meet(rig, rays, noise=2e-3)
    assert np.median(np.linalg.norm(found.T - points, axis=1)) < 2e-3
    assert not used[bad, each].any()
    assert (used.sum(0) == 3).mean() > 0.99


def test_two_views_that_disagree_or_look_alike_give_nothing():
    rig, points = ring(2), np.array([[0.0, 0.0, 1.0]])
    rays = rays_to(rig, points)
    off = rays.copy()
    normal = np.cross(rig.rotation[0] @ (rig.centres[1] - rig.centres[0]), rays[0, :, 0])
    off[0, :, 0] += 0.1 * normal / np.linalg.norm(normal)
    off[0] /= np.linalg.norm(off[0])
    assert np.isnan(meet(rig, off)[0]).all()
    assert np.isnan(meet(rig, rays, least_angle_deg=179.0)[0]).all()
    assert np.isfinite(meet(rig, rays)[0]).all()


def test_a_point_behind_its_views_is_none_however_rough_they_are():
    """Rays the other way meet in the same point; angles of more than half a turn may pass."""
    rig, points = ring(3), np.array([[0.1, 0.2, 1.0]])
    found, used = meet(rig, -rays_to(rig, points), noise=2.0)
    assert np.isnan(found).all()
    assert not used.any()


def test_reprojection_error_is_the_rms_over_the_used_views():
    """Detections 3, 4 and 300 pixels off, the last not used: sqrt((9 + 16) / 2)."""
    rig, points = ring(3), np.array([[0.1, 0.2, 1.0]]).T
    pixels = project_views(rig, points)
    pixels[:, 0, 0] += [3.0, 4.0, 300.0]
    used = np.array([[True], [True], [False]])
    error = reprojection_error(rig, points, pixels=pixels, used=used)
    assert error == pytest.approx([np.sqrt(12.5)])


def test_poses_of_true_rig_and_labels_are_the_truth():
    """In metres: median 5 mm measured with 2 px noise; and the error says 2 px a coordinate."""
    made, found = scene(), recording()
    poses = triangulate(found, made.rig, truth(), TriangulateConfig(), progress=silent)
    joints = [made.joints.index(name) for name in found.keypoints]
    gap = np.linalg.norm(poses.positions[:, :3] - made.poses[:, :3, joints], axis=-1)
    assert np.nanmedian(gap) < 0.01
    assert np.isfinite(gap).mean() > 0.97
    assert 1.0 < np.nanmedian(poses.error) < 3.5
    assert poses.unit == "m"
    assert set(np.unique(poses.views)) <= {0, 2, 3, 4}


def test_observed_points_are_the_points_and_the_detections_of_the_poses():
    """In several blocks of frames: every point once, a detection for each view that counted."""
    made, found = scene(frames=400), recording(frames=400)
    matches = truth(frames=400)
    poses = triangulate(found, made.rig, matches)
    points = observe_points(found, made.rig, matches)
    known = np.isfinite(poses.positions[..., 0])
    assert len(frame_blocks(400, known[0].size)) > 1
    np.testing.assert_array_equal(points.positions, poses.positions[known])
    views = np.bincount(points.point, minlength=len(points.positions))
    np.testing.assert_array_equal(views, poses.views[known])
    there = project_views(made.rig, points.positions.T)[points.view, :, points.point]
    square = ((there - points.pixels) ** 2).sum(1)
    error = np.sqrt(np.bincount(points.point, square) / views)
    np.testing.assert_allclose(error, poses.error[known], rtol=1e-9)
