"""Laws of the geometry. Tolerances are a few times the rounding error measured."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.epipolar import (
    depths,
    essential_matrix,
    five_point,
    sampson_angle,
)
from mocap_calib.geometry.intersection import intersect
from mocap_calib.geometry.lens import pixels_from_points, rays_from_pixels
from mocap_calib.geometry.rotation import (
    align_by_similarity,
    angle_between,
    direction_angle,
    looking_along,
    matrix_from_vector,
    nearest_rotation,
    quaternion_from_matrix,
    skew,
    vector_from_matrix,
)
from mocap_calib.types import Camera, CameraRig

MATRIX = np.array([[1100.0, 0.0, 640.0], [0.0, 1105.0, 355.0], [0.0, 0.0, 1.0]])
CAMERAS = {
    "plain": Camera("plain", (1280, 720), MATRIX, np.zeros(5), False),
    "brown": Camera(
        "brown", (1280, 720), MATRIX, np.array([-0.2, 0.15, 0.001, -0.002, -0.02]), False
    ),
    "rational": Camera(
        "rational",
        (1280, 720),
        MATRIX,
        np.array([0.3, 0.1, 0.001, 0.0, 0.02, 0.5, 0.2, 0.01]),
        False,
    ),
    "fisheye": Camera(
        "fisheye",
        (1280, 720),
        MATRIX * [[0.4], [0.4], [1]] + [[0, 0, 384], [0, 0, 213], [0, 0, 0]],
        np.array([0.03, 0.02, -0.01, 0.002]),
        True,
    ),
}


def rotations(rng: np.random.Generator, count: int, largest: float = np.pi) -> np.ndarray:
    axis = rng.normal(size=(count, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    return matrix_from_vector(axis * rng.uniform(0, largest, (count, 1)))


def two_views(
    rng: np.random.Generator, points: int = 200
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """R, t of b_from_a and exact rays of points in front of both."""
    rotation, translation = rotations(rng, 1, 1.0)[0], rng.normal(size=3)
    in_a = rng.uniform(-1, 1, (points, 3)) + [0, 0, 6.0]
    in_b = in_a @ rotation.T + translation
    in_front = in_b[:, 2] > 0.1
    in_a, in_b = in_a[in_front], in_b[in_front]
    return (
        rotation,
        translation,
        in_a / np.linalg.norm(in_a, axis=1, keepdims=True),
        in_b / np.linalg.norm(in_b, axis=1, keepdims=True),
    )


@pytest.mark.parametrize("size", [1e-12, 1e-7, 1e-3, 1.0, 3.0, np.pi - 1e-6])
def test_rotation_vector_round_trip(size):
    """Near zero and near a half turn too, where the formulas break."""
    axis = np.random.default_rng(0).normal(size=(50, 3))
    vector = size * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    matrix = matrix_from_vector(vector)
    np.testing.assert_allclose(
        matrix @ np.swapaxes(matrix, 1, 2), np.broadcast_to(np.eye(3), matrix.shape), atol=1e-14
    )
    np.testing.assert_allclose(vector_from_matrix(matrix), vector, atol=1e-9 * max(size, 1e-3))


def test_quaternion_reproduces_the_rotation_of_every_octant():
    matrix = rotations(np.random.default_rng(1), 500)
    w, x, y, z = quaternion_from_matrix(matrix).T
    np.testing.assert_allclose(w**2 + x**2 + y**2 + z**2, 1, atol=1e-14)
    np.testing.assert_allclose(matrix[:, 0, 1], 2 * (x * y - w * z), atol=1e-14)
    np.testing.assert_allclose(matrix[:, 2, 2], 1 - 2 * (x**2 + y**2), atol=1e-14)


def test_quaternions_of_turns_about_the_axes():
    """Half turns have one component alone, so that each row of the table counts."""
    half = matrix_from_vector(np.pi * np.eye(3))
    np.testing.assert_allclose(np.abs(quaternion_from_matrix(half)), np.eye(4)[1:], atol=1e-15)
    third = matrix_from_vector(2 * np.pi / 3 * np.eye(3))
    expected = np.column_stack([np.full(3, 0.5), np.sqrt(0.75) * np.eye(3)])
    np.testing.assert_allclose(quaternion_from_matrix(third), expected, atol=1e-15)


def test_angle_is_exact_for_tiny_rotations():
    assert angle_between(np.eye(3), matrix_from_vector(np.array([0, 0, 1e-9]))) == pytest.approx(
        1e-9, rel=1e-6
    )


def test_angle_is_invariant_to_the_frame():
    a, b, c = (rotations(np.random.default_rng(k), 20) for k in range(3))
    np.testing.assert_allclose(angle_between(c @ a, c @ b), angle_between(a, b), atol=1e-7)


def test_direction_angle_of_nothing_is_a_half_turn():
    assert direction_angle(np.zeros(3), np.array([1.0, 0, 0])) == np.pi


def test_skew_is_the_cross_product():
    a, b = np.random.default_rng(2).normal(size=(2, 10, 3))
    np.testing.assert_allclose((skew(a) @ b[..., None])[..., 0], np.cross(a, b), atol=1e-15)


def test_nearest_rotation_is_proper_and_optimal():
    """No rotation of a thousand does better, for any matrix, mirrored ones too."""
    rng = np.random.default_rng(3)
    matrix = rng.normal(size=(30, 3, 3))
    best = nearest_rotation(matrix)
    np.testing.assert_allclose(np.linalg.det(best), 1, atol=1e-12)
    value = np.einsum("nij,nij->n", best, matrix)
    others = np.einsum("mij,nij->nm", rotations(rng, 1000), matrix)
    assert (value[:, None] >= others - 1e-12).all()


def test_nearest_rotation_of_a_positive_diagonal_is_none():
    diagonals = np.random.default_rng(4).permuted(np.tile([1.0, 2.0, 3.0], (20, 1)), axis=1)
    found = nearest_rotation(diagonals[:, :, None] * np.eye(3))
    np.testing.assert_allclose(found, np.broadcast_to(np.eye(3), found.shape), atol=1e-14)


def test_looking_along_is_a_rotation_that_looks_along():
    direction = np.concatenate(
        [np.random.default_rng(4).normal(size=(100, 3)), [[0, 1.0, 0], [0, -1.0, 0]]]
    )
    turn = looking_along(direction, np.array([0.0, 1.0, 0.0]))
    np.testing.assert_allclose(np.linalg.det(turn), 1, atol=1e-12)
    ahead = (turn @ direction[..., None])[..., 0]
    np.testing.assert_allclose(ahead[:, :2], 0, atol=1e-12)
    assert (ahead[:, 2] > 0).all()


@pytest.mark.parametrize("name", CAMERAS)
def test_pixel_ray_pixel_round_trip(name):
    """Measured 1e-12 px; 1e-8 leaves room for other processors."""
    camera = CAMERAS[name]
    pixels = np.random.default_rng(5).uniform([0, 0], camera.size, (500, 2))
    pixels[0] = np.nan
    rays = rays_from_pixels(camera, pixels)
    np.testing.assert_allclose(np.linalg.norm(rays[1:], axis=1), 1, atol=1e-14)
    assert np.isnan(rays[0]).all()
    np.testing.assert_allclose(pixels_from_points(camera, 3.0 * rays), pixels, atol=1e-8)


@pytest.mark.parametrize(
    ("k", "fisheye", "pixel"),
    [
        ([-0.3, 0, 0, 0], False, (1200.0, 400.0)),
        ([-0.1, 0, 0, 0], True, (3000.0, 3000.0)),
        ([0.0, 0, 0, 0], True, (3000.0, 360.0)),
    ],
)
def test_a_pixel_that_no_ray_has_is_nan_and_its_neighbours_are_not(k, fisheye, pixel):
    """Past the fold of the polynomial, or past 180 degrees."""
    camera = Camera(
        "fold",
        (1280, 720),
        np.array([[600.0, 0, 640], [0, 600, 360], [0, 0, 1]]),
        np.array(k),
        fisheye,
    )
    rays = rays_from_pixels(
        camera, np.array([[pixel, (700.0, 400.0)], [(np.nan, 1.0), (900.0, 200.0)]])
    )
    np.testing.assert_array_equal(np.isnan(rays).all(-1), [[True, False], [True, False]])
    np.testing.assert_allclose(
        pixels_from_points(camera, rays[:, 1]), [[700, 400], [900, 200]], atol=1e-6
    )


@pytest.mark.parametrize("name", CAMERAS)
def test_lenses_are_those_of_opencv(name):
    camera = CAMERAS[name]
    points = np.random.default_rng(0).uniform([-0.5, -0.3, 1.0], [0.5, 0.3, 1.5], (200, 3))
    project = cv2.fisheye.projectPoints if camera.fisheye else cv2.projectPoints
    still = np.zeros(3)
    expected, _ = project(points[:, None], still, still, camera.matrix, camera.distortion)
    np.testing.assert_allclose(pixels_from_points(camera, points), expected[:, 0], atol=1e-9)


@pytest.mark.parametrize("name", CAMERAS)
def test_wild_pixels_have_true_rays_or_none(name):
    pixels = np.random.default_rng(6).normal(size=(300, 2)) * 10.0 ** np.random.default_rng(
        7
    ).uniform(2, 9, (300, 1))
    rays = rays_from_pixels(CAMERAS[name], pixels)
    back = pixels_from_points(CAMERAS[name], rays)
    ahead = np.isfinite(back).all(1)
    assert (np.abs(back - pixels)[ahead] < 1).all()
    assert (rays[~ahead, 2][np.isfinite(rays[~ahead, 2])] <= 1e-9).all()


def test_fisheye_sees_behind_itself():
    """Equidistant: 100 degrees off the axis are f * 1.745 pixels."""
    camera = Camera(
        "wide",
        (1280, 720),
        np.array([[300.0, 0, 640], [0, 300, 360], [0, 0, 1]]),
        np.zeros(4),
        True,
    )
    angle = np.radians(100)
    np.testing.assert_allclose(
        rays_from_pixels(camera, np.array([640 + 300 * angle, 360])),
        [np.sin(angle), 0, np.cos(angle)],
        atol=1e-12,
    )


def test_a_point_behind_the_camera_has_no_pixel():
    assert np.isnan(
        pixels_from_points(CAMERAS["plain"], np.array([[0, 0, -1.0], [0, 0, 0.0]]))
    ).all()


def test_fisheye_sees_past_the_image_plane():
    """Kannala-Brandt has no tangent: rays near 90 degrees are as good as any."""
    ray = np.array([np.sin(1.5), 0, np.cos(1.5)])
    np.testing.assert_allclose(
        rays_from_pixels(CAMERAS["fisheye"], pixels_from_points(CAMERAS["fisheye"], ray[None])),
        ray[None],
        atol=1e-9,
    )


def test_exact_matches_have_no_epipolar_error_and_positive_depths():
    for seed in range(5):
        rotation, translation, a, b = two_views(np.random.default_rng(seed))
        np.testing.assert_allclose(
            sampson_angle(essential_matrix(rotation, translation), a, b), 0, atol=1e-12
        )
        near_a, near_b = depths(rotation, translation, a, b)
        np.testing.assert_allclose(
            near_b[:, None] * b - near_a[:, None] * (a @ rotation.T),
            np.broadcast_to(translation, a.shape),
            atol=1e-9,
        )
        assert (near_a > 0).all()
        assert (near_b > 0).all()


def test_sampson_error_is_the_angle_to_the_epipolar_plane():
    """A ray turned out of its plane by e has an error of e shared by two views: e / sqrt(2)."""
    rotation, translation, a, b = two_views(np.random.default_rng(7))
    plane = np.cross(translation, a @ rotation.T)
    plane /= np.linalg.norm(plane, axis=1, keepdims=True)
    moved = np.cos(1e-4) * b + np.sin(1e-4) * plane
    matrix = essential_matrix(rotation, translation)
    slope_a = np.linalg.norm(moved @ matrix, axis=1)
    slope_b = np.linalg.norm(a @ matrix.T, axis=1)
    expected = 1e-4 * slope_b / np.hypot(slope_a, slope_b)
    np.testing.assert_allclose(np.abs(sampson_angle(matrix, a, moved)), expected, rtol=1e-3)


def translation_system(rotation: np.ndarray, rays_a: np.ndarray, rays_b: np.ndarray) -> np.ndarray:
    """M(R) = sum n n', n = (R u_a) x u_b: its smallest eigenvector is the direction of t.

    The paper's stacked collinearity and coplanarity system with the points eliminated (the matrix
    of Kneip and Lynen 2013). rotation: `[3, 3]`; rays: `[N, 3]`. Returns `[3, 3]`.
    """
    normal = np.cross(rays_a @ rotation.T, rays_b)
    return normal.T @ normal


def test_translation_system_agrees_with_the_full_collinearity_and_coplanarity_system():
    """The paper's A [x_1 .. x_N t] = 0 and the small system agree at the true rotation.

    Both have t as the vector of their smallest singular value.
    """
    rotation, translation, a, b = two_views(np.random.default_rng(8), points=12)
    _, vectors = np.linalg.eigh(translation_system(rotation, a, b))
    n = len(a)
    rows = np.zeros((6 * n, 3 * n + 3))
    for k in range(n):  # u_a x x = 0 and u_b x (R x + t) = 0
        rows[6 * k : 6 * k + 3, 3 * k : 3 * k + 3] = skew(a[k])
        rows[6 * k + 3 : 6 * k + 6, 3 * k : 3 * k + 3] = skew(b[k]) @ rotation
        rows[6 * k + 3 : 6 * k + 6, -3:] = skew(b[k])
    full = np.linalg.svd(rows)[2][-1, -3:]
    unit = translation / np.linalg.norm(translation)
    assert abs(vectors[:, 0] @ unit) == pytest.approx(1, abs=1e-12)
    assert abs(full @ unit) / np.linalg.norm(full) == pytest.approx(1, abs=1e-9)


def test_five_point_finds_the_pose_among_outliers():
    rng = np.random.default_rng(9)
    rotation, translation, a, b = two_views(rng)
    b[:40] = rng.permutation(b[:40])
    ((found, direction),) = five_point(a, b, 1e-4)
    assert np.degrees(angle_between(found, rotation)) < 0.01
    assert np.degrees(direction_angle(direction, translation)) < 0.05


def test_five_point_declines_too_few_points():
    _, _, a, b = two_views(np.random.default_rng(10), points=6)
    assert five_point(a, b, 1e-3) == []


def test_similarity_recovers_what_was_applied():
    rng = np.random.default_rng(11)
    source, rotation = rng.normal(size=(7, 3)), rotations(rng, 1)[0]
    scale, found, shift = align_by_similarity(source, 2.5 * source @ rotation.T + [1.0, -2.0, 3.0])
    assert scale == pytest.approx(2.5)
    np.testing.assert_allclose(found, rotation, atol=1e-12)
    np.testing.assert_allclose(shift, [1, -2, 3], atol=1e-12)


def test_similarity_of_one_place_is_degenerate():
    with pytest.raises(DegenerateError, match="different places"):
        align_by_similarity(np.ones((4, 3)), np.zeros((4, 3)))


@pytest.mark.parametrize(
    ("k", "radius"),
    [([-0.44, 0.21, 0, 0, -0.05], 0.85), ([0.297, -0.095, 0, 0, 0.006], 1.85)],
)
def test_a_strong_lens_is_undone_up_to_its_fold(k, radius):
    """It folds at 0.9 or 1.92: beyond, another point is put at the same pixel."""
    matrix = np.array([[1290.0, 0, 1024], [0, 1290, 768], [0, 0, 1]])
    camera = Camera("a", (2048, 1536), matrix, np.array(k), False)
    angle, radius = np.random.default_rng(12).uniform([0, 0], [2 * np.pi, radius], (500, 2)).T
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.ones(500)], axis=1)
    rays = rays_from_pixels(camera, pixels_from_points(camera, points))
    np.testing.assert_allclose(
        rays, points / np.linalg.norm(points, axis=1, keepdims=True), atol=1e-5
    )


def rays_of_many_views(
    rng: np.random.Generator, views: int, points: int = 50
) -> tuple[CameraRig, np.ndarray, np.ndarray]:
    """A rig, points `[3, N]`, and the exact rays `[view, 3, N]` to them in the world's axes."""
    cameras = tuple(replace(CAMERAS["plain"], name=f"cam{view}") for view in range(views))
    rig = CameraRig(cameras, rotations(rng, views), rng.normal(size=(views, 3)) * 3, "m")
    position = rng.uniform(-1, 1, (3, points))
    offset = position - rig.centres[:, :, None]
    return rig, position, offset / np.linalg.norm(offset, axis=1, keepdims=True)


@pytest.mark.parametrize("views", [2, 3, 8])
def test_exact_rays_meet_in_their_point(views):
    """Measured 1e-12; 1e-9 leaves room for other processors."""
    rig, position, rays = rays_of_many_views(np.random.default_rng(13), views)
    found = intersect(rig, rays, np.full((views, rays.shape[2]), 1e4))
    np.testing.assert_allclose(found, position, atol=1e-9)


@pytest.mark.parametrize("views", [4, 9])
def test_a_wrong_ray_does_not_move_a_point(views):
    """Another wrong ray for each point, in a small and in a large rig.

    Measured: 98 % of the points, and half of them to 1e-8.
    """
    rng = np.random.default_rng(14)
    rig, position, rays = rays_of_many_views(rng, views)
    wrong = rng.integers(0, views, rays.shape[2])
    columns = np.arange(rays.shape[2])
    turn = rotations(rng, rays.shape[2], 1.0)
    rays[wrong, :, columns] = (turn @ rays[wrong, :, columns][..., None])[..., 0]
    found = intersect(rig, rays, np.full((views, rays.shape[2]), 1e6))
    assert (np.linalg.norm(found - position, axis=0) < 0.01).mean() > 0.9


@pytest.mark.parametrize(("views", "wrong"), [(4, 2), (7, 3), (9, 5)])
def test_the_rays_that_agree_decide_where_many_are_wrong(views, wrong):
    """Others of each point are wrong: measured 99.5 to 100 % of the points."""
    rng = np.random.default_rng(16)
    rig, position, rays = rays_of_many_views(rng, views, 200)
    columns = np.arange(200)
    for row in np.argsort(rng.random((views, 200)), axis=0)[:wrong]:
        turn = rotations(rng, 200, 1.0)
        rays[row, :, columns] = (turn @ rays[row, :, columns][..., None])[..., 0]
    found = intersect(rig, rays, np.full((views, 200), 1e6))
    assert (np.linalg.norm(found - position, axis=0) < 0.01).mean() > 0.98


def test_a_point_that_one_view_sees_has_no_place():
    rig, _, rays = rays_of_many_views(np.random.default_rng(15), 3)
    precision = np.full((3, rays.shape[2]), 1e4)
    precision[1:, 5] = 0
    found = intersect(rig, rays, precision)
    assert np.isnan(found[:, 5]).all()
    assert np.isfinite(np.delete(found, 5, axis=1)).all()
