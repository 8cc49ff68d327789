"""The pose and the projection of a camera from points that others know."""

import numpy as np
import pytest
from oracles import views as oracle
from rigs import unit

from mocap_calib.adjust.camera_fit import (
    CameraFit,
    Seen,
    Unknowns,
    cauchy_loss,
    fit_camera,
    linearise_camera,
)
from mocap_calib.adjust.resection import (
    Sightings,
    compare_projections,
    exchanged_share,
    match,
    refine_poses,
    resect,
    sightings_of,
)
from mocap_calib.config import LEAST_JOINTS, CameraFitConfig, ResectionConfig
from mocap_calib.geometry.lens import decompose_projection, pixels_from_points
from mocap_calib.geometry.rotation import angle_between, matrix_from_vector
from mocap_calib.types import Camera

MATRIX = np.array([[900.0, 0.0, 630.0], [0.0, 910.0, 350.0], [0.0, 0.0, 1.0]])
MIRRORED = MATRIX * [-1.0, 1.0, 1.0]
CAMERA = Camera("c", (1280, 720), MATRIX, np.array([-0.2, 0.1, 0.001, -0.002, 0.0]))
ROTATION = matrix_from_vector(np.array([0.1, 0.7, -0.2]))
TRANSLATION = np.array([0.3, -0.1, 5.0])
POSE = np.column_stack([ROTATION, TRANSLATION])
SIZE = (1280, 720)
close = np.testing.assert_allclose


def bodies(frames=40, individuals=1, keypoints=12, seed=0):
    rng = np.random.default_rng(seed)
    body = 0.5 * rng.normal(size=(individuals, keypoints, 3))
    place = rng.uniform(-1.2, 1.2, size=(frames, individuals, 1, 3))
    return body + place + 0.1 * rng.normal(size=(frames, individuals, keypoints, 3))


def project(points, matrix=MATRIX):
    seen = (points @ ROTATION.T + TRANSLATION) @ matrix.T
    return seen[..., :2] / seen[..., 2:]


def sighting(points, image) -> Sightings:
    """Return the detections `[frame, instance, keypoint, 2]` that show anything."""
    frame, instance = np.nonzero(np.isfinite(image[..., 0]).any(-1))
    return Sightings(frame, instance, image[frame, instance], points)


def in_order(image: np.ndarray, order: np.ndarray) -> np.ndarray:
    return np.take_along_axis(image, order[..., None, None], axis=1)


# any projection, and no identity


@pytest.mark.parametrize("individuals", [1, 3])
@pytest.mark.parametrize("matrix", [MATRIX, MIRRORED])
def test_exact_points_give_the_exact_projection_whoever_is_who(individuals, matrix):
    points, rng = bodies(individuals=individuals), np.random.default_rng(1)
    order = np.array([rng.permutation(individuals) for _ in points])
    image = in_order(project(points, matrix), order)
    found = resect(sighting(points, image), ResectionConfig(), seed=0)
    parts, rotation, translation = decompose_projection(found.projection)
    close(parts, matrix, rtol=1e-4, atol=0.1)
    assert angle_between(rotation, ROTATION) < 1e-4
    close(translation, TRANSLATION, rtol=1e-3, atol=1e-3)
    np.testing.assert_array_equal(found.individual, order.ravel())
    assert found.cost < 1e-3


def test_wrong_detections_noise_and_frames_that_do_not_show_everybody_do_not_matter():
    """One of three subjects is seen in each frame, a third of the frames shows something else.

    Measured: 0.14 deg and 0.1 %.
    """
    points, rng = bodies(frames=120, individuals=3), np.random.default_rng(3)
    shown = rng.integers(3, size=120)
    image = np.full((120, 2, 12, 2), np.nan)
    image[:, 0] = project(points)[np.arange(120), shown] + 2 * rng.normal(size=(120, 12, 2))
    image[::3, 0] = rng.uniform((0, 0), SIZE, size=(40, 12, 2))
    found = resect(sighting(points, image), ResectionConfig(), seed=0)
    matrix, rotation, _ = decompose_projection(found.projection)
    assert np.degrees(angle_between(rotation, ROTATION)) < 0.4
    close(np.diag(matrix)[:2], [900, 910], rtol=0.005)
    np.testing.assert_array_equal(found.individual[1::3], shown[1::3])


def test_without_enough_frames_there_is_no_projection():
    points = bodies(frames=1)
    nothing = np.full((1, 1, 12, 2), np.nan)
    for image in (project(points), nothing):
        assert resect(sighting(points, image), ResectionConfig(), seed=0) is None


def test_detections_show_whom_they_fit_or_nobody():
    """Two of three are detected in each frame, and once somebody who is not known."""
    points = bodies(frames=6, individuals=3)
    shown = np.array([[2, 0]] * 5 + [[1, -1]])
    image = in_order(project(points), shown)
    image[5, 1] += 400.0
    found, cost = match(sighting(points, image), MATRIX @ POSE, tolerance=5.0)
    assert found.tolist() == shown.ravel().tolist()
    assert cost == pytest.approx(1 / 12, abs=0.01)


def test_the_share_of_exchanged_sides_is_counted():
    points = bodies(frames=80)
    order = np.array([1, 0, 3, 2, 5, 4, *range(6, 12)])
    image = project(points)
    image[::4] = image[::4][:, :, order]
    given, exchanged = sighting(points, image), sighting(points, image[:, :, order])
    found = resect(given, ResectionConfig(), seed=0)
    share = exchanged_share(given, exchanged, found.projection, found.tolerance)
    assert share == pytest.approx(0.25, abs=0.03)


def test_costs_of_detections_are_those_of_numpy():
    """Joints missing on either side, behind the camera, bodies that are not there or show few."""
    rng = np.random.default_rng(7)
    points = bodies(individuals=3, keypoints=6)
    points[..., 2] -= 4.0  # some of them behind the camera
    whole = points @ ROTATION.T + TRANSLATION
    image = whole[..., :2] / whole[..., 2:] + 0.05 * rng.normal(size=(*points.shape[:3], 2))
    for array in (points, image):
        array[rng.random(array.shape[:3]) < 0.3] = np.nan
    points[3], points[5, 1:] = np.nan, np.nan
    seen = sighting(points, image[:, ::-1])
    turns = matrix_from_vector(rng.normal(0, 0.05, (4, 3))) @ ROTATION
    poses = np.concatenate([turns, np.tile(TRANSLATION[:, None], (4, 1, 1))], axis=-1)
    tolerance = rng.uniform(0.02, 0.1, len(seen.frame))
    found = compare_projections(poses, seen, tolerance)
    cost, body = oracle.compare_projections(poses, seen, tolerance, LEAST_JOINTS)
    close(found.cost, cost, rtol=1e-9)
    np.testing.assert_array_equal(found.body, body)
    assert np.isnan(cost).any()
    assert 0 < (whole[..., 2] < 0).mean() < 1
    assert 0.05 < (cost < 0.9).mean() < 0.95


def test_poses_are_refined_among_strangers():
    """Of two epochs each has its own detections, and a third of all is of nobody that is known."""
    points, rng = bodies(frames=60, individuals=2), np.random.default_rng(4)
    image = project(points, np.eye(3))
    image[::3] = rng.uniform(-0.7, 0.7, size=image[::3].shape)
    rays = unit(np.concatenate([image, np.ones_like(image[..., :1])], axis=-1))
    seen = sightings_of(rays, points)
    turns = matrix_from_vector(np.array([[0.0, 0.05, 0.0], [0.02, 0.0, -0.03]])) @ ROTATION
    start = np.concatenate([turns, np.tile(TRANSLATION[:, None] + 0.1, (2, 1, 1))], axis=-1)
    counted = np.stack([seen.frame < 30, seen.frame >= 30])
    tolerances = np.geomspace(0.1, 0.003, 8)
    found, _ = refine_poses(start, seen, counted=counted, tolerances=tolerances)
    assert np.degrees(angle_between(found[..., :3], ROTATION)).max() < 0.05
    close(found[..., 3], np.tile(TRANSLATION, (2, 1)), atol=0.01)


# a known camera, and what its images may hide


def fit(points, pixels, start=POSE, *, noise: float, free: tuple[str, ...]) -> CameraFit:
    return fit_camera(
        CAMERA, seen_of(points, pixels), start, CameraFitConfig(), noise=noise, free=free
    )


def seen_of(points, pixels) -> Seen:
    number = np.arange(len(points))
    return Seen(points, pixels, number * 10 // len(points), number % 12)


@pytest.mark.parametrize(
    ("free", "values", "tolerance"),
    [
        (("log_scale",), [np.log(0.5)], 1e-6),
        (("x", "y"), [-150.0, -80.0], 1e-3),
        (("log_focal",), [0.3], 1e-6),
        ((), [], 1e-12),
    ],
)
def test_what_images_hide_is_found_from_exact_points(free, values, tolerance):
    points = bodies().reshape(-1, 3)
    value = dict(zip(free, values, strict=True))
    matrix = MATRIX.copy()
    matrix[[0, 1], [0, 1]] *= np.exp(value.get("log_focal", 0.0))
    taken = Camera("c", CAMERA.size, matrix, CAMERA.distortion)
    pixels = pixels_from_points(taken, points @ ROTATION.T + TRANSLATION)
    pixels = np.exp(value.get("log_scale", 0.0)) * pixels
    pixels += (value.get("x", 0.0), value.get("y", 0.0))
    turned = matrix_from_vector(np.array([0.0, 0.1, 0.05])) @ ROTATION
    start = np.column_stack([turned, TRANSLATION + (0.1, 0.0, 0.3)])
    found = fit(points, pixels, start, noise=20.0, free=free)
    close(found.unknowns, values, atol=tolerance)
    assert angle_between(found.pose[:, :3], ROTATION) < 1e-6
    assert found.error.max() < 1e-3


def test_the_uncertainty_of_a_crop_covers_its_error():
    """Wald's statistic of the errors of two unknowns is 2 on average; 30 draws: 2 +- 0.4."""
    points = bodies().reshape(-1, 3)
    exact = pixels_from_points(CAMERA, points @ ROTATION.T + TRANSLATION)
    statistics = []
    for seed in range(30):
        pixels = exact + 2 * np.random.default_rng(seed).normal(size=exact.shape)
        found = fit(points, pixels, noise=2.0, free=("x", "y"))
        statistics.append(found.unknowns @ np.linalg.solve(found.covariance, found.unknowns))
    assert 0.8 < np.mean(statistics) < 4.0


def test_slopes_of_what_a_camera_sees_are_those_of_differences():
    """Of a turn, a shift, and all that its images may hide; pixels by radians, metres and so on."""
    points = bodies(frames=3).reshape(-1, 3)
    seen, free = seen_of(points, np.zeros((len(points), 2))), ("log_scale", "x", "y", "log_focal")
    at, step = np.array([0.1, 20.0, -30.0, 0.05]), 1e-5

    def linearised(change):
        turn = matrix_from_vector(change[:3])
        pose = np.column_stack([turn @ ROTATION, TRANSLATION + change[3:6]])
        return linearise_camera(CAMERA, seen, Unknowns(pose, at + change[6:]), free)

    for slope, change in zip(linearised(np.zeros(10))[1], step * np.eye(10), strict=True):
        expected = (linearised(change)[0] - linearised(-change)[0]) / (2 * step)
        close(slope, expected, rtol=1e-6, atol=1e-3)


def test_an_error_of_a_fit_weighs_as_its_cost_grows():
    """Of both, the slopes by the squared error in units of the scale."""
    squares, scale, step = np.array([0.0, 0.25, 1.0, 9.0]), 3.0, 1e-6

    def costs(square):
        return cauchy_loss(scale * np.sqrt([square, 0 * square]), scale)

    expected = [(costs(squares + step * e)[0] - costs(squares)[0]) / step for e in np.eye(4)]
    close(costs(squares)[1], np.array(expected) / scale**2, atol=1e-5)
