"""Laws of rotations, similarities, sizes of bodies and graphs, for any input.

The same examples are drawn in each run; tolerances are a few times the rounding that was measured.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import views as oracle
from rigs import random_rotations, rig_looking_at_origin, unit
from scenes import similar
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial.transform import Rotation

from mocap_calib.config import INTERSECT_LOSS_SCALE, SMALL_RIG
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry import lens
from mocap_calib.geometry.epipolar import (
    depths,
    essential_matrix,
    five_point,
    fundamental_matrix,
    homography_errors,
    pose_from_essential,
    sampson_angle,
)
from mocap_calib.geometry.graphs import connected_parts, fiedler_vector, spanning_tree
from mocap_calib.geometry.intersection import (
    intersect,
    median_angles,
    order_by_views,
    point_covariance,
    view_blocks,
)
from mocap_calib.geometry.lens import agreeing_views, rays_in_world
from mocap_calib.geometry.rotation import (
    align_by_similarity,
    angle_between,
    body_size,
    direction_angle,
    gauge_of,
    looking_along,
    matrix_from_vector,
    mean_of_known,
    nearest_rotation,
    project_out_similarity,
    quaternion_from_matrix,
    rig_change,
    rig_size,
    skew,
    vector_from_matrix,
    with_size_of,
)
from mocap_calib.inspection.view_pairs import sampson_distance
from mocap_calib.types import Camera, CameraRig

SEEDS = st.integers(0, 2**32 - 1)
MIRROR = np.diag([-1.0, 1.0, 1.0])
law = settings(max_examples=20, deadline=None, derandomize=True)
close = np.testing.assert_allclose


@pytest.mark.parametrize("size", [1e-12, 1e-7, 1e-3, 1.0, 3.0, np.pi - 1e-6])
def test_rotation_vectors_and_quaternions_are_those_of_scipy(size):
    """Near zero and near a half turn too, where the formulas break."""
    vector = size * unit(np.random.default_rng(0).normal(size=(50, 3)))
    matrix = matrix_from_vector(vector)
    close(matrix, Rotation.from_rotvec(vector).as_matrix(), atol=1e-15)
    close(vector_from_matrix(matrix), vector, atol=1e-9 * max(size, 1e-3))
    x, y, z, w = Rotation.from_rotvec(vector).as_quat(canonical=True).T
    close(quaternion_from_matrix(matrix).T, [w, x, y, z], atol=2e-15)


def test_quaternions_of_half_turns_have_one_component_alone():
    half = matrix_from_vector(np.pi * np.eye(3))
    close(np.abs(quaternion_from_matrix(half)), np.eye(4)[1:], atol=1e-15)


@law
@given(SEEDS)
def test_vectors_turn_with_their_rotations(seed):
    """R exp(v) R' = exp(R v), and the inverse is exp(-v)."""
    rng = np.random.default_rng(seed)
    vector, turn = rng.normal(size=3), random_rotations(rng, 1)[0]
    matrix = matrix_from_vector(vector)
    close(turn @ matrix @ turn.T, matrix_from_vector(turn @ vector), atol=1e-14)
    close(matrix_from_vector(-vector), matrix.T, atol=1e-15)
    close(skew(vector) @ turn[0], np.cross(vector, turn[0]), atol=1e-15)


@law
@given(SEEDS)
def test_angles_are_a_metric_that_no_frame_and_no_mirror_changes(seed):
    a, b, c, turn = random_rotations(np.random.default_rng(seed), 4)
    angle = angle_between(a, b)
    assert angle == pytest.approx(np.linalg.norm(Rotation.from_matrix(a.T @ b).as_rotvec()))
    exact = 4e-15 / max(np.cos(angle / 2), 1e-7)  # a half turn is the end of the arcsine
    assert abs(angle - angle_between(b, a)) < exact
    assert angle <= angle_between(a, c) + angle_between(c, b) + exact
    mirrored = MIRROR @ a @ MIRROR, MIRROR @ b @ MIRROR
    for first, second in ((turn @ a, turn @ b), (a @ turn, b @ turn), (a.T, b.T), mirrored):
        assert abs(angle_between(first, second) - angle) < exact


def test_angles_are_exact_where_they_are_tiny_and_a_half_turn_where_there_is_no_direction():
    tiny = matrix_from_vector(np.array([0, 0, 1e-9]))
    assert angle_between(np.eye(3), tiny) == pytest.approx(1e-9, rel=1e-6)
    x = np.array([1.0, 0, 0])
    assert direction_angle(x, np.array([5.0, 5e-9, 0])) == pytest.approx(1e-9, rel=1e-6)
    assert direction_angle(x, -3 * x) == direction_angle(np.zeros(3), x) == np.pi


@law
@given(SEEDS)
def test_no_rotation_is_nearer_than_the_nearest(seed):
    """Of a thousand others, for any matrix, mirrored ones too; and it turns with the world."""
    rng = np.random.default_rng(seed)
    matrix, (left, right) = rng.normal(size=(3, 3)), random_rotations(rng, 2)
    best = nearest_rotation(matrix)
    close(np.linalg.det(best), 1, atol=1e-12)
    others = np.einsum("mij,ij->m", random_rotations(rng, 1000), matrix)
    assert (best * matrix).sum() >= others.max() - 1e-12
    gap = np.linalg.svd(matrix)[1]
    sure = gap[1] - gap[2] if np.linalg.det(matrix) < 0 else gap[1] + gap[2]
    close(nearest_rotation(left @ matrix @ right), left @ best @ right, atol=1e-14 / sure)


@law
@given(SEEDS)
def test_who_looks_along_a_direction_has_it_ahead_and_stands_upright(seed):
    """The new y is across the direction, in the plane of `down`; the look turns with the world."""
    rng = np.random.default_rng(seed)
    directions, down, turn = rng.normal(size=(5, 3)), rng.normal(size=3), random_rotations(rng, 1)
    looks = looking_along(directions, down)
    close(np.linalg.det(looks), 1, atol=1e-12)
    ahead = (looks @ unit(directions)[..., None])[..., 0]
    close(ahead, np.tile([0, 0, 1.0], (5, 1)), atol=1e-12)
    x, y, _ = (looks @ down).T
    close(x, 0, atol=1e-12)
    assert (y > 0).all()
    close(looking_along(directions @ turn[0].T, turn[0] @ down), looks @ turn[0].T, atol=1e-12)
    straight = looking_along(np.array([[0, 2.0, 0], [0, -1.0, 0]]), np.array([0, 1.0, 0]))
    close(straight[:, 2], [[0, 1, 0], [0, -1, 0]], atol=1e-15)
    close(np.linalg.det(straight), 1, atol=1e-15)


@law
@given(SEEDS)
def test_alignment_undoes_any_similarity_in_any_order(seed):
    """Of clouds that are not alike: what is done to one of them is done to the answer."""
    rng = np.random.default_rng(seed)
    source, target = rng.normal(size=(2, 12, 3)) + np.arange(12)[:, None] % 3
    target += 2 * source
    scale, rotation, shift = align_by_similarity(source, target)
    factor, turn, moved = rng.uniform(0.1, 10), random_rotations(rng, 1)[0], rng.normal(size=3)
    order = rng.permutation(12)
    found = align_by_similarity(source[order], factor * target[order] @ turn.T + moved)
    close(found.scale, factor * scale, rtol=1e-12)
    close(found.rotation, turn @ rotation, atol=1e-12)
    close(found.shift, factor * turn @ shift + moved, atol=1e-11)
    known = align_by_similarity(source, factor * source @ turn.T + moved)
    close(known.apply(source), factor * source @ turn.T + moved, atol=1e-12)
    close(known.scale, factor, rtol=1e-12)


def test_points_in_one_place_cannot_be_aligned():
    with pytest.raises(DegenerateError):
        align_by_similarity(np.ones((4, 3)), np.zeros((4, 3)))


@law
@given(SEEDS)
def test_a_change_of_a_rig_knows_no_similarity(seed):
    """Of cameras that turn and shift a little: to second order, and without the gauge exactly."""
    rng = np.random.default_rng(seed)
    rig = rig_looking_at_origin(rng.normal(size=(5, 3)) * 3)
    world, move = similar(rig, rng)
    assert rig_size(world) == pytest.approx(move.scale * rig_size(rig))
    first = rig.centres[0]
    larger = rig.stand(rig.rotation, first + 7 * (rig.centres - first))
    close(with_size_of(rig, larger).centres, rig.centres, atol=1e-12)
    change = rng.normal(size=(5, 6, 2))
    left = project_out_similarity(change, rig)
    close(np.einsum("vkg,vkn->gn", gauge_of(rig), left), 0, atol=1e-12)
    close(project_out_similarity(change + gauge_of(rig)[..., :2], rig), left, atol=1e-12)
    turn, shift = 1e-5 * rng.normal(size=(2, 5, 3))
    size = rig_size(rig)
    moved = rig.stand(rig.rotation @ matrix_from_vector(turn), rig.centres + size * shift)
    whole = matrix_from_vector(1e-5 * rng.normal(size=3))
    elsewhere = moved.stand(moved.rotation @ whole.T, 3 * (moved.centres @ whole.T + [1, 2, 3]))
    expected = project_out_similarity(np.concatenate([turn, shift], axis=1), rig)
    close(rig_change(rig, moved), expected, atol=3e-9)
    close(rig_change(rig, elsewhere), expected, atol=3e-9)


def test_the_size_is_of_the_bodies_that_are_most_whole():
    cube = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    bodies = cube * np.array([1.0, 2, 3, 9, 9])[:, None, None]
    bodies[3:, 3:] = np.nan  # three joints of eight
    assert body_size(bodies) == pytest.approx(2 * np.sqrt(3))  # of the median of the three others
    assert body_size(bodies[3:]) > 0  # better than none
    bodies[:, 2:] = np.nan
    assert np.isnan(body_size(bodies))
    assert body_size(bodies[:, :2]) > 0  # that is all there is of them


def test_the_mean_skips_what_is_missing():
    values = np.array([[1.0, np.nan, 3.0], [np.nan, np.nan, np.nan]])
    np.testing.assert_array_equal(mean_of_known(values, 1), [2, np.nan])
    np.testing.assert_array_equal(mean_of_known(values, 0), [1, np.nan, 3])


@law
@given(SEEDS, st.integers(1, 15), st.sampled_from([0.1, 0.3, 1.0]))
def test_trees_and_parts_of_graphs_are_those_of_scipy(seed, nodes, share):
    """Also of graphs in several parts; parents come before their children."""
    rng = np.random.default_rng(seed)
    cost = np.where(rng.random((nodes, nodes)) < share, rng.random((nodes, nodes)), np.inf)
    cost[np.tril_indices(nodes)] = np.inf
    edges = spanning_tree(cost, root=nodes // 2)
    true = minimum_spanning_tree(np.where(np.isinf(cost), 0, cost)).tocoo()
    found = {tuple(sorted(edge)) for edge in edges.tolist()}
    assert found == set(zip(true.row.tolist(), true.col.tolist(), strict=True))
    np.testing.assert_array_equal(spanning_tree(cost.T, root=nodes // 2), edges)
    reached = [child for _, child in edges.tolist()]
    assert len(set(reached)) == len(reached)
    assert nodes // 2 not in reached
    assert all(parent not in reached[k:] for k, (parent, _) in enumerate(edges.tolist()))
    first, second = np.nonzero(np.isfinite(cost))
    graph = coo_array((np.ones(len(first)), (first, second)), shape=(nodes, nodes))
    parts = connected_components(graph, directed=False)[1]
    np.testing.assert_array_equal(connected_parts(second, first, nodes), parts)


MISS = {False: 3e-12, True: 1.3e-15}  # of unit rays; by fisheye
OFF = {False: 7e-10, True: 2.9e-10}


def camera_of(*distortion: float, focal: float = 600, fisheye: bool = False) -> Camera:
    matrix = np.array([[focal, 0, 640], [0, 1.1 * focal, 360], [0, 0, 1]])
    return Camera("a", (1280, 720), matrix, np.array(distortion), fisheye)


CAMERAS = {
    "plain": camera_of(*np.zeros(5)),
    "brown": camera_of(-0.2, 0.15, 0.001, -0.002, -0.02, focal=1100),
    "rational": camera_of(0.3, 0.1, 0.001, 0.0, 0.02, 0.5, 0.2, 0.01),
    "fisheye": camera_of(0.03, 0.02, -0.01, 0.002, focal=450, fisheye=True),
}


def lens_of(seed: int, *, fisheye: bool) -> tuple[Camera, np.ndarray]:
    """Return a camera and points of the plane z = 1 that it sees, up to 37 or 72 degrees off.

    The lens moves them by up to 31 % of the largest radius, a fisheye by 11 % of the largest angle.
    """
    rng = np.random.default_rng(seed)
    radius, angle = np.linspace(0, 3.0 if fisheye else 0.75, 60), rng.uniform(0, 2 * np.pi, 60)
    image = radius * np.stack([np.cos(angle), np.sin(angle)])
    if fisheye:
        distortion = rng.uniform(-0.03, 0.03, 4) / [1, 2, 4, 8]
    else:
        radial, tangential = rng.uniform(-0.2, 0.2, 6), rng.uniform(-0.005, 0.005, 2)
        distortion = np.array([*radial[:2], *tangential, *radial[2:]])
    return camera_of(*distortion, focal=rng.uniform(300, 2000), fisheye=fisheye), image


def on_plane(image: np.ndarray) -> np.ndarray:
    """Return the points `[3, N]` of the plane z = 1."""
    return np.concatenate([image, np.ones((1, image.shape[1]))])


@pytest.mark.parametrize("name", CAMERAS)
def test_lenses_are_those_of_opencv(name):
    camera = CAMERAS[name]
    points = np.random.default_rng(0).uniform([-0.5, -0.3, 1.0], [0.5, 0.3, 1.5], (200, 3))
    project = cv2.fisheye.projectPoints if camera.fisheye else cv2.projectPoints
    still = np.zeros(3)
    expected, _ = project(points[:, None], still, still, camera.matrix, camera.distortion)
    close(lens.pixels_from_points(camera, points), expected[:, 0], atol=1e-9)
    behind = lens.pixels_from_points(camera, np.array([[0, 0, -1.0], [0, 0, 0], [np.nan, 0, 1]]))
    assert np.isnan(behind).all()


@pytest.mark.parametrize("name", CAMERAS)
def test_wild_pixels_have_true_rays_or_none(name):
    """Measured 1e-12 px within the image; far outside within a pixel, or none."""
    rng = np.random.default_rng(6)
    pixels = rng.uniform([0, 0], (1280, 720), (500, 2))
    pixels[0] = np.nan
    rays = lens.rays_from_pixels(CAMERAS[name], pixels)
    close(np.linalg.norm(rays[1:], axis=1), 1, atol=1e-14)
    close(lens.pixels_from_points(CAMERAS[name], 3.0 * rays), pixels, atol=1e-8)
    pixels = rng.normal(size=(300, 2)) * 10.0 ** rng.uniform(2, 9, (300, 1))
    rays = lens.rays_from_pixels(CAMERAS[name], pixels)
    back = lens.pixels_from_points(CAMERAS[name], rays)
    ahead = np.isfinite(back).all(1)
    assert (np.abs(back - pixels)[ahead] < 1).all()
    assert (rays[~ahead, 2][np.isfinite(rays[~ahead, 2])] <= 1e-9).all()


@pytest.mark.parametrize(
    ("k1", "fisheye", "pixel"),
    [(-0.3, False, (1200, 400)), (-0.1, True, (3000, 3000)), (0.0, True, (3000, 360))],
)
def test_a_pixel_that_no_ray_has_is_nan_and_its_neighbours_are_not(k1, fisheye, pixel):
    """Past the fold of the polynomial, or past 180 degrees."""
    camera = camera_of(k1, 0, 0, 0, fisheye=fisheye)
    given = np.array([[pixel, (700.0, 400.0)], [(np.nan, 1.0), (900.0, 200.0)]])
    rays = lens.rays_from_pixels(camera, given)
    np.testing.assert_array_equal(np.isnan(rays).all(-1), [[True, False], [True, False]])
    close(lens.pixels_from_points(camera, rays[:, 1]), [[700, 400], [900, 200]], atol=1e-6)


@pytest.mark.parametrize("degrees", [86, 94, 100])
def test_a_fisheye_sees_past_the_image_plane(degrees):
    """Equidistant: 100 degrees off the axis are f * 1.745 pixels."""
    angle = np.radians(degrees)
    ray = lens.rays_from_pixels(
        camera_of(0, 0, 0, 0, fisheye=True), np.array([640 + 600 * angle, 360])
    )
    close(ray, [np.sin(angle), 0, np.cos(angle)], atol=1e-12)


@law
@given(SEEDS, st.booleans())
def test_a_ray_has_a_pixel_and_the_pixel_has_that_ray(seed, fisheye):
    """At any distance. Measured 2.0e-12 of 600 lenses, and 9e-16 of fisheyes."""
    camera, image = lens_of(seed, fisheye=fisheye)
    rays = lens.unproject(camera, lens.project(camera, 7 * on_plane(image)))
    close(rays, unit(on_plane(image), 0), rtol=0, atol=MISS[fisheye])


def fold_of(camera: Camera) -> float:
    """Return the first squared radius at which the distorted radius does not grow."""
    k1, k2, _, _, k3, k4, k5, k6 = camera.distortion
    radius = np.linspace(0, 10, 4001)
    r2 = radius**2
    below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    lengths = radius * (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / np.where(below > 0, below, np.nan)
    stops = ~(np.diff(lengths) > 0)
    return float(r2[np.argmax(stops)]) if stops.any() else np.inf


@law
@given(SEEDS, st.floats(0, 8))
def test_a_pixel_has_the_ray_that_projects_to_it_or_none(seed, strength):
    """Lenses of no distortion to more than any has, many of which fold within the image.

    Before the first fold each pixel has its ray; beyond, a ray within half a pixel, or none.
    """
    camera, image = lens_of(seed, fisheye=False)
    camera = replace(camera, distortion=strength * camera.distortion)
    rng = np.random.default_rng(seed)
    known = lens.project(camera, on_plane(image))
    before = (image**2).sum(0) < 0.5 * fold_of(camera)
    rays = lens.unproject(camera, known)
    close((rays[:2] / rays[2])[:, before], image[:, before], atol=1e-8)
    pixels = known + rng.normal(size=known.shape) * 50
    pixels[:, rng.random(len(image[0])) < 0.1] = np.nan
    found = lens.unproject(camera, pixels)
    there = np.isfinite(found[0])
    assert not there[np.isnan(pixels[0])].any()
    again = lens.project(camera, found[:, there])
    assert np.abs(again - pixels[:, there]).max(initial=0) < 0.51


@law
@given(SEEDS)
def test_views_have_the_rays_of_each_camera_by_itself(seed):
    """A fisheye among them, pixels that are missing, and both orders in memory."""
    lenses = [lens_of(seed + view, fisheye=view == 1) for view in range(3)]
    cameras = [camera for camera, _ in lenses]
    pixels = np.stack([lens.project(camera, on_plane(image)).T for camera, image in lenses])
    pixels[np.random.default_rng(seed).random(pixels.shape[:2]) < 0.1] = np.nan
    expected = [lens.unproject(*seen) for seen in zip(cameras, pixels.swapaxes(1, 2), strict=True)]
    found = lens.unproject_views(cameras, pixels, by_component=True)
    np.testing.assert_array_equal(found, expected)
    found = lens.unproject_views(cameras, pixels, by_component=False)
    np.testing.assert_array_equal(found.swapaxes(1, 2), expected)


def assert_slopes(camera: Camera, image: np.ndarray, *, nudge: float, off: float) -> None:
    """Hold the slopes of pixels to central differences, within a share of the largest."""
    found = lens.image_slopes(camera, image)

    def hold(slopes: np.ndarray, ahead: np.ndarray, behind: np.ndarray) -> None:
        slope = (ahead - behind) / (2 * nudge)
        close(slopes, slope, atol=off * np.abs(slope).max())

    for axis in range(2):
        step = nudge * np.eye(2)[:, axis, None]
        both = (lens.project(camera, on_plane(image + sign * step)) for sign in (1, -1))
        hold(found.image[:, axis], *both)
    for key in ("log_focal", "k1"):
        changes = ({"log_focal": 0.0, "k1": 0.0, key: sign * nudge} for sign in (1, -1))
        changed = [lens.change_intrinsics(camera, **change) for change in changes]
        hold(getattr(found, key), *(lens.project(each, on_plane(image)) for each in changed))


@law
@given(SEEDS, st.booleans())
def test_slopes_of_any_lens_are_those_of_central_differences(seed, fisheye):
    """Measured 5.0e-10 of the largest slope, and 1.9e-10 of fisheyes: rounding of differences.

    The camera that is changed stays as it was.
    """
    camera, image = lens_of(seed, fisheye=fisheye)
    before = camera.matrix.copy(), camera.distortion.copy()
    assert_slopes(camera, image, nudge=1e-5, off=OFF[fisheye])
    np.testing.assert_array_equal(camera.matrix, before[0])
    np.testing.assert_array_equal(camera.distortion, before[1])


@law
@given(SEEDS, st.integers(2, 6))
def test_what_cameras_see_knows_no_world(seed, views):
    """Rounding: measured 4e-14, 5e-14 and 4e-15, of points at 3. Missing rays are zero."""
    rng = np.random.default_rng(seed)
    rig, points = rig_looking_at_origin(rng.normal(size=(views, 3))), 3 * rng.normal(size=(3, 20))
    world, move = similar(rig, rng)
    there = move.apply(points.T).T
    inside = lens.points_in_cameras(rig, points)
    close(lens.points_in_cameras(world, there) / move.scale, inside, rtol=0, atol=6e-14)
    back = lens.rays_in_world(rig, inside) + rig.centres[:, :, None]
    close(back, np.broadcast_to(points, back.shape), rtol=0, atol=8e-14)
    rays = np.where(rng.random((views, 1, 20)) < 0.2, np.nan, inside)
    in_world = lens.rays_in_world(rig, rays)
    close(lens.rays_in_world(world, rays), move.rotation @ in_world, rtol=0, atol=1e-14)
    assert (in_world[np.isnan(rays)] == 0).all()
    turned = inside + 0.1 * np.cross(rng.normal(size=(views, 3, 20)), inside, axis=1)
    angle, in_front = lens.ray_angles(rig, points, turned)
    expected = np.arccos((unit(turned, 1) * unit(inside, 1)).sum(1))
    close(angle, expected, atol=1e-7)
    close(lens.ray_angles(world, there, turned)[0], angle, atol=1e-13)
    assert in_front.all()
    angle, in_front = lens.ray_angles(rig, points, np.where(rng.random(20) < 0.5, np.nan, -inside))
    assert (angle > np.pi - 1e-7).all()  # missing, or behind
    assert not in_front.any()


def test_reprojection_errors_are_the_rms_of_the_distances_in_the_views_that_are_used():
    """A view that has the point behind it adds no distance."""
    rig = rig_looking_at_origin([(4, 0, 0), (0, 5, 1), (-3, -3, 1)])
    cameras = (*rig.cameras[:2], replace(CAMERAS["fisheye"], name="c"))
    rig = CameraRig(cameras, rig.rotation, rig.translation, "m")
    points = np.random.default_rng(0).normal(size=(3, 7))
    points[:, 3] = 6, 0, 0  # behind the first camera
    off = np.arange(1, 4)[:, None, None] * np.array([[3.0], [4.0]])
    used = np.array([[1, 1, 0, 1, 0, 1, 1], [1, 0, 1, 1, 0, 1, 1], [1, 1, 1, 0, 0, 1, 1]], bool)
    pixels = lens.project_points(rig, points.T).swapaxes(1, 2) + off
    pixels[0, :, 3] = 100.0
    found = lens.reprojection_error(rig, points, pixels=pixels, used=used)
    square = np.where(used, 25.0 * np.arange(1, 4)[:, None] ** 2, 0.0)
    square[0, 3] = 0
    with np.errstate(invalid="ignore"):
        close(found, np.sqrt(square.sum(0) / used.sum(0)), rtol=1e-10)


@law
@given(SEEDS, st.booleans())
def test_a_projection_is_intrinsics_a_rotation_and_a_translation(seed, mirrored):
    """P = K [R t]; of a mirrored image the first focal length is negative."""
    rng = np.random.default_rng(seed)
    rig = rig_looking_at_origin(rng.normal(size=(1, 3)))
    matrix = camera_of(focal=rng.uniform(300, 2000)).matrix * [-1 if mirrored else 1, 1, 1]
    matrix[0, 1] = rng.normal()
    pose = np.concatenate([rig.rotation[0], rig.translation[0][:, None]], axis=1)
    found = lens.decompose_projection(rng.uniform(0.1, 10) * matrix @ pose)
    close(found[0], matrix, atol=1e-9)
    close(found[1], rig.rotation[0], atol=1e-12)
    close(found[2] / np.linalg.norm(found[2]), unit(rig.translation[0]), atol=1e-12)


VIEWS = st.integers(2, 6)
NOISE = 0.003  # radians
FULL = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])  # of xx, xy, xz, yy, yz, zz
# centres of cameras: close together, around, on one side, and one much nearer than the others
PLACES = {
    "stereo": [(4, 0, 2), (3.5, 2, 2)],
    "facing": [(4, 0, 2), (-4, 0.5, 1)],
    "three": [(4, 0, 2), (-2, 3.5, 2), (-2, -3.5, 2)],
    "one near": [(1.5, 0, 1), (-5, 4, 2), (-5, -3, 2)],
    "one side": [(4, 0, 1), (4, 1, 2), (3.7, -1, 1.5), (3, 2.5, 2)],
    "eight": [(4 * np.cos(a), 4 * np.sin(a), 2) for a in np.arange(8) * np.pi / 4],
}


# two views


def two_views(rng: np.random.Generator, noise: float = 1e-3) -> tuple[np.ndarray, ...]:
    """Return R and t (of length 2) of b_from_a, and rays of up to 30 points."""
    rotation, t = random_rotations(rng, 1)[0], 2 * unit(rng.normal(size=3))
    points = rng.normal(size=(30, 3)) * 4
    apart = direction_angle(points, points + t @ rotation)
    points = points[(apart > 0.05) & (apart < 3)]
    off = noise * rng.normal(size=(2, len(points), 3))
    return rotation, t, unit(unit(points) + off[0]), unit(unit(points @ rotation.T + t) + off[1])


@law
@given(SEEDS)
def test_exact_matches_have_no_epipolar_error_and_meet_in_front_of_both_views(seed):
    rotation, t, a, b = two_views(np.random.default_rng(seed), noise=0)
    close(sampson_angle(essential_matrix(rotation, t), a, b), 0, atol=1e-12)
    near_a, near_b = depths(rotation, t, a, b)
    met = near_b[:, None] * b - near_a[:, None] * (a @ rotation.T)
    close(met, np.broadcast_to(t, a.shape), atol=1e-9)
    assert (near_a > 0).all()
    assert (near_b > 0).all()
    turned = depths(rotation, t, a, -b)[1]
    close(turned, -near_b, rtol=1e-9)


def test_sampson_error_is_the_value_by_its_slopes_on_the_sphere():
    """Also far from a match; near one it is the angle to the epipolar plane, by both slopes."""
    rotation, t, a, b = two_views(np.random.default_rng(7), noise=0)
    matrix = essential_matrix(rotation, t)
    moved = np.cos(1e-4) * b + np.sin(1e-4) * unit(np.cross(t, a @ rotation.T))
    slope_a, slope_b = np.linalg.norm(b @ matrix, axis=1), np.linalg.norm(a @ matrix.T, axis=1)
    expected = 1e-4 * slope_b / np.hypot(slope_a, slope_b)
    close(np.abs(sampson_angle(matrix, a, moved)), expected, rtol=2e-3)
    other = np.roll(b, 1, axis=0)
    slopes = np.cross(other @ matrix, a), np.cross(a @ matrix.T, other)
    value = (other @ matrix * a).sum(1)
    close(sampson_angle(matrix, a, other), value / np.linalg.norm(np.hstack(slopes), axis=1))


@law
@given(SEEDS)
def test_two_views_may_be_exchanged_turned_scaled_and_mirrored(seed):
    rng = np.random.default_rng(seed)
    rotation, t, a, b = two_views(rng)
    error = np.abs(sampson_angle(essential_matrix(rotation, t), a, b))
    depth = np.stack(depths(rotation, t, a, b))
    back = rotation.T, -rotation.T @ t
    close(np.abs(sampson_angle(essential_matrix(*back), b, a)), error, atol=1e-13)
    close(np.stack(depths(*back, b, a))[::-1], depth, rtol=1e-9)
    for to_a, to_b in (random_rotations(rng, 2), (MIRROR, MIRROR)):
        turned = to_b @ rotation @ to_a.T, 7 * to_b @ t, a @ to_a.T, b @ to_b.T
        again = sampson_angle(essential_matrix(*turned[:2]), *turned[2:])
        close(np.abs(again), error, atol=1e-13)
        close(np.stack(depths(*turned)), 7 * depth, rtol=1e-9)


@law
@given(SEEDS)
def test_an_essential_matrix_of_any_size_and_sign_has_one_pose(seed):
    rotation, t, a, b = two_views(np.random.default_rng(seed))
    for factor in (1.0, -0.01):
        found = pose_from_essential(factor * essential_matrix(rotation, t), a, b)
        assert angle_between(found[0], rotation) < 1e-7
        assert direction_angle(found[1], t) < 1e-7


@law
@given(SEEDS, st.booleans())
def test_five_points_give_the_true_essential_matrix(seed, mistaken):
    """Of exact rays, a third of which may be of other points; of fewer than 8 rays none.

    Measured 4e-4 at worst, of matrices of length 1, and 7e-7 at the median: OpenCV's last step.
    """
    rng = np.random.default_rng(seed)
    rotation, t = matrix_from_vector(rng.uniform(-0.4, 0.4, 3)), unit(rng.normal(size=3))
    points = rng.uniform([-2, -2, 4], [2, 2, 8], (30, 3))
    a, b = unit(points), unit(points @ rotation.T + t)
    assert five_point(a[:7], b[:7], 1e-4) == []
    if mistaken:
        b[:10] = np.roll(b[:10], 1, axis=0)
    ((turn, direction),) = five_point(a, b, 1e-4)
    true, found = essential_matrix(rotation, t), essential_matrix(turn, direction)
    assert np.abs(unit(np.ravel(true)) - unit(np.ravel(found))).max() < 6e-4
    assert five_point(a * [1, 1, -1], b, 1e-4) == []


def seen_from_two_sides(points: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
    """Return the points of the planes z = 1 of two noisy cameras, 60 degrees apart."""
    seen = []
    for degrees in (0.0, 60.0):
        rays = unit(points @ matrix_from_vector(np.deg2rad([0.0, degrees, 0.0])).T + [0, 0, 4.0])
        rays += rng.normal(0, 1e-3, rays.shape)
        seen.append(rays[:, :2] / rays[:, 2:])
    return seen


# points from many views


def rays_of(
    rng: np.random.Generator, views: int, points: int = 50, noise: float = 0.0
) -> tuple[CameraRig, np.ndarray, np.ndarray]:
    """Return a rig, points `[3, N]`, and the rays `[view, 3, N]` to them in the world's axes."""
    rig = rig_looking_at_origin(rng.normal(size=(views, 3)) * 3)
    position = rng.uniform(-1, 1, (3, points))
    rays = unit(position - rig.centres[:, :, None], 1)
    return rig, position, unit(rays + noise * rng.normal(size=rays.shape), 1)


def noisy_rays(rig: CameraRig, points: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return rays `[view, 3, N]` in the cameras' frames, each turned by chance; noise: `[view]`."""
    rays = unit(rig.rotation @ points + rig.translation[:, :, None], 1)
    turn = np.random.default_rng(0).normal(size=rays.shape) * noise[:, None, None]
    return unit(rays + np.cross(turn, rays, axis=1), 1)


@pytest.mark.parametrize("views", [2, 5, SMALL_RIG, SMALL_RIG + 1])
def test_points_are_those_of_their_definition(views):
    """Where some rays are missing and some are of another point; exact rays meet in their point.

    Two rays that are nearly parallel meet far away, where rounding counts.
    """
    rng = np.random.default_rng(views)
    rig, position, rays = rays_of(rng, views, 300)
    close(intersect(rig, rays, np.full((views, 300), 1e4)), position, atol=1e-9)
    rays += 0.005 * rng.normal(size=rays.shape)
    rays += (rng.random((views, 1, 300)) < 0.2) * rng.normal(size=rays.shape)
    rays = unit(rays, 1)
    precision = np.where(rng.random((views, 300)) < min(0.8, 10 / views), 1e5, 0.0)
    rays[np.broadcast_to(precision[:, None] == 0, rays.shape)] = 0.0
    found = intersect(rig, rays, precision)
    close(found, oracle.intersect(rig, rays, precision), rtol=1e-7, atol=1e-8)
    np.testing.assert_array_equal(np.isnan(found[0]), (precision > 0).sum(0) < 2)


@pytest.mark.parametrize(("views", "wrong"), [(4, 1), (9, 1), (4, 2), (7, 3), (9, 5)])
def test_the_rays_that_agree_decide(views, wrong):
    """Others of each point are wrong: measured 98 to 100 % of the points."""
    rng = np.random.default_rng(16)
    rig, position, rays = rays_of(rng, views, 200)
    columns = np.arange(200)
    for row in np.argsort(rng.random((views, 200)), axis=0)[:wrong]:
        turn = random_rotations(rng, 200, 1.0)
        rays[row, :, columns] = (turn @ rays[row, :, columns][..., None])[..., 0]
    found = intersect(rig, rays, np.full((views, 200), 1e6))
    assert (np.linalg.norm(found - position, axis=0) < 0.01).mean() > 0.95


@law
@given(SEEDS, VIEWS)
def test_points_and_their_covariances_go_with_the_world_and_the_order(seed, views):
    """Covariances as the square of the unit. Measured 1.5e-10 of the largest, of points 3e-8."""
    rng = np.random.default_rng(seed)
    rig, _, rays = rays_of(rng, views, 20, noise=1e-3)
    precision = rng.uniform(2e5, 1e6, (views, 20))
    view, point = rng.permutation(views), rng.permutation(20)
    world, move = similar(rig.select(view), rng)
    turned = (move.rotation @ rays)[view][:, :, point]
    weight, variance = precision[view][:, point], rng.uniform(1, 2, views) / precision.mean(1)
    points = intersect(rig, rays, precision)
    there = move.apply(points.T).T[:, point]
    off = np.abs(intersect(world, turned, weight) - there)
    assert (off / move.scale / (1 + np.linalg.norm(points[:, point], axis=0))).max() < 1e-6
    entries = point_covariance(rig, points, rays, precision=precision, variance=variance)
    again = point_covariance(world, there, turned, precision=weight, variance=variance[view])
    covariance = np.stack(entries)[FULL][..., point]
    expected = move.scale**2 * np.einsum("ij,jkn,lk->iln", move.rotation, covariance, move.rotation)
    gap = np.abs(np.stack(again)[FULL] - expected).max((0, 1)) / np.abs(expected).max((0, 1))
    assert gap.max() < 1e-8
    angles = median_angles(rig, points, precision)
    close(median_angles(world, there, weight), angles[view][:, point], rtol=1e-4)


@pytest.mark.parametrize("name", PLACES)
def test_covariances_are_what_points_scatter_by(name):
    """Within 15 % along each axis of the ellipsoid; the worst was 5 %, of 4000 points."""
    rig, point = rig_looking_at_origin(PLACES[name]), np.array([0.2, -0.3, 0.5])
    noise = np.full(len(rig), NOISE) * np.linspace(1, 2, len(rig))
    many = np.repeat(point[:, None], 4000, axis=1)
    world = rays_in_world(rig, noisy_rays(rig, many, noise))
    precision = np.broadcast_to(1 / noise[:, None] ** 2, (len(rig), 4000))
    points = intersect(rig, world, precision)
    entries = point_covariance(rig, points, world, precision=precision, variance=noise**2)
    ratio = np.linalg.eigvals(np.linalg.solve(np.stack(entries)[FULL].mean(-1), np.cov(points)))
    assert np.sqrt(ratio.real.max()) < 1.15
    assert np.sqrt(ratio.real.min()) > 0.85


def test_a_ray_that_is_off_by_the_scale_of_the_loss_counts_a_quarter():
    """Of Geman and McClure's loss: the same covariance as of a quarter of its weight."""
    rig, point = rig_looking_at_origin(PLACES["one side"]), np.array([[0.1], [0.2], [-0.1]])
    world = unit(point - rig.centres[:, :, None], 1)
    variance, full = np.full(4, NOISE**2), np.full((4, 1), NOISE**-2.0)
    off, less = world.copy(), full.copy()
    across = unit(np.cross(world[3, :, 0], [0.0, 0.0, 1.0]))
    turn = matrix_from_vector(np.arcsin(INTERSECT_LOSS_SCALE * NOISE) * across)
    off[3, :, 0] = turn @ world[3, :, 0]
    less[3] /= 4
    found = point_covariance(rig, point, off, precision=full, variance=variance)
    expected = point_covariance(rig, point, world, precision=less, variance=variance)
    close(np.ravel(found), np.ravel(expected), rtol=1e-6)


@pytest.mark.parametrize("views", [3, 6, 24])
def test_median_angles_are_those_of_their_definition_of_the_views_that_see_a_point(views):
    """In a large rig blocks leave out views; a view that sees nothing has plain noise.

    Two normal errors: sqrt(2 ln 2). Wilson and Hilferty's median is 0.7 % above it.
    """
    rng = np.random.default_rng(3)
    rig, points, _ = rays_of(rng, views, 100)
    weight = np.zeros((views, 100))
    seen = (rng.integers(0, views, 100) + np.arange(3)[:, None]) % views
    weight[seen, np.arange(100)] = rng.uniform(0.01, 1.0, (3, 100)) ** 2
    found = median_angles(rig, points, weight)
    defined = [oracle.median_angles(rig, *each) for each in zip(points.T, weight.T, strict=True)]
    close(found[weight > 0], np.transpose(defined)[weight > 0], rtol=1e-5)
    close(found[weight == 0], np.sqrt(2 * np.log(2)), rtol=0.01)


@pytest.mark.parametrize("least_degrees", [6, 40])
def test_views_agree_whose_rays_pass_near_a_point_in_front_far_enough_apart(least_degrees):
    """Of four cameras 30 degrees apart; the limit is wider where more see a point."""
    angle = np.deg2rad([0, 30, 60, 90])
    rig = rig_looking_at_origin(5 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1))
    limits = np.tile(np.deg2rad([0, 0, 1, 1, 3]), (4, 1))
    rays = np.repeat(unit(-rig.centres)[:, :, None], 9, axis=2)
    weight = np.ones((4, 9))
    off = matrix_from_vector(np.deg2rad([0, 0, 2]))
    expected = np.ones((4, 9), dtype=bool)
    rays[0, :, 1], expected[0, 1] = -rays[0, :, 1], False  # behind
    rays[0, :, 2] = off @ rays[0, :, 2]  # near enough, of four
    rays[0, :, 3], weight[3, 3] = off @ rays[0, :, 3], 0.0  # not of three
    expected[:, 3] = [False, least_degrees < 30, least_degrees < 30, False]
    weight[2:, 4], expected[:, 4] = 0, [least_degrees < 30] * 2 + [False] * 2  # two, 30 degrees
    weight[1:, 5], expected[:, 5] = 0, False  # one alone
    rays[1, :, 6], weight[1, 6], expected[1, 6] = 0, 0, False  # missing
    points = np.zeros((3, 9))
    points[:, 7], expected[:, 7] = np.nan, False
    points[0, 8], expected[:, 8] = 30.0, False  # behind two of them, off the axes of the others
    found = agreeing_views(
        rig, points, rays, weight, limits=limits, least_angle=np.deg2rad(least_degrees)
    )
    np.testing.assert_array_equal(found, expected)


# blocks of points


@pytest.mark.parametrize("views", [2, SMALL_RIG, SMALL_RIG + 1, 60])
def test_every_detection_is_in_one_block_with_few_views_that_see_nothing(views):
    """Along a hall. A small rig is not sorted: its results stay the same to the last bit.

    Measured: 9.6 of 60 views in a block, where 5.2 see a point; all 60 unless it is sorted.
    """
    rng = np.random.default_rng(0)
    place, where = rng.uniform(0, 10, (views, 1)), rng.uniform(0, 10, 20_000)
    seen = (np.abs(place - where) < 0.5) & (rng.random((views, 20_000)) < 0.9)
    times, values = np.zeros(seen.shape, dtype=np.int64), rng.normal(size=(views, 3, 20_000))
    blocks = view_blocks(seen)
    for block in blocks:
        block.put(np.array(block.take(seen), dtype=np.int64) + block.take(times), times)
        expected = values[block.views][..., block.points]
        np.testing.assert_array_equal(block.take(values), expected)
    np.testing.assert_array_equal(times, seen)
    if views <= SMALL_RIG:
        assert all(isinstance(block.points, slice) for block in blocks)
    else:
        assert np.mean([len(block.views) for block in blocks]) < 0.25 * views + 2
    np.testing.assert_array_equal(np.sort(order_by_views(seen)), np.arange(20_000))


def test_the_fiedler_vector_follows_a_chain():
    """In any order of the nodes it is a half of a cosine."""
    order = np.random.default_rng(0).permutation(30)
    weight = np.zeros((30, 30))
    weight[order[1:], order[:-1]] = weight[order[:-1], order[1:]] = 1.0
    found = np.argsort(fiedler_vector(weight))
    assert found.tolist() in (order.tolist(), order[::-1].tolist())


@pytest.mark.parametrize("outliers", [0, 60])
def test_the_fundamental_matrix_of_two_images_is_that_of_their_cameras(outliers):
    """In noise of 0.8 pixels: it leaves 0.7 to 1.2 of them, and 27 mrad of bodies are no plane's.

    Its epipoles are 20 to 140 of 1,386 pixels off.
    """
    rng = np.random.default_rng(0)
    cloud = rng.uniform(-1, 1, (300, 3))
    plane = seen_from_two_sides(cloud * [1, 1, 0] @ random_rotations(rng, 1)[0], rng)
    first, second = (800 * each + [640, 360] for each in seen_from_two_sides(cloud, rng))
    for images in (plane[1], second):
        images[:outliers] = np.roll(images[:outliers], 7, axis=0)
    assert 1.2e-3 < np.median(homography_errors(*plane)[outliers:]) < 2.5e-3
    matrix = fundamental_matrix(first, second)
    error = np.abs(sampson_distance(matrix, first[outliers:], second[outliers:]))
    assert 0.4 < np.median(error) < 1.04  # pixels, of 0.8
    turn = matrix_from_vector(np.deg2rad([0.0, 60.0, 0.0]))
    inverse = np.linalg.inv([[800, 0, 640], [0, 800, 360], [0, 0, 1.0]])
    true = inverse.T @ essential_matrix(turn, np.array([0, 0, 4.0]) - turn @ [0, 0, 4.0]) @ inverse
    for found, expected in ((matrix, true), (matrix.T, true.T)):
        epipoles = [np.linalg.svd(each)[2][2] for each in (found, expected)]
        assert np.linalg.norm(np.subtract(*(each[:2] / each[2] for each in epipoles))) < 200
    assert fundamental_matrix(np.zeros((5, 2)), np.zeros((5, 2))) is None
