"""Laws of the geometry for any input: gauges, mirrors, orders, scales. Bounds are as measured."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap_calib.geometry.epipolar import (
    depths,
    essential_matrix,
    pose_from_essential,
    sampson_angle,
)
from mocap_calib.geometry.graphs import connected_parts, spanning_tree
from mocap_calib.geometry.intersection import intersect, median_angles
from mocap_calib.geometry.lens import pixels_from_points, project, ray_angles
from mocap_calib.geometry.rotation import (
    align_by_similarity,
    angle_between,
    body_size,
    direction_angle,
    looking_along,
    matrix_from_vector,
    nearest_rotation,
    quaternion_from_matrix,
    vector_from_matrix,
)
from mocap_calib.io.poses.axes import turn_between
from mocap_calib.types import Camera, CameraRig

SEEDS = st.integers(0, 2**32 - 1)
MIRROR = np.diag([-1.0, 1.0, 1.0])
law = settings(max_examples=20, deadline=None)


def rotations(rng: np.random.Generator, count: int) -> np.ndarray:
    return nearest_rotation(rng.normal(size=(count, 3, 3)))


def unit(vectors: np.ndarray, axis: int = -1) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=axis, keepdims=True)


def rig_of(rng: np.random.Generator, views: int) -> CameraRig:
    matrix = np.array([[1000.0, 0, 500], [0, 1000.0, 400], [0, 0, 1]])
    cameras = tuple(Camera(f"c{k}", (1000, 800), matrix) for k in range(views))
    return CameraRig(cameras, rotations(rng, views), rng.normal(size=(views, 3)), "m")


def seen_by(rng: np.random.Generator, rig: CameraRig, count: int = 20) -> np.ndarray:
    """Return rays `[view, 3, N]` in the world's axes to points, a milliradian off."""
    offset = 3 * rng.normal(size=(3, count)) - rig.centres[:, :, None]
    return unit(unit(offset, 1) + 1e-3 * rng.normal(size=offset.shape), 1)


def two_views(rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Return R and t of b_from_a, and rays of 30 points, all but exact."""
    rotation, t = rotations(rng, 1)[0], 2 * unit(rng.normal(size=3))
    points = rng.normal(size=(30, 3)) * 4
    noise = 1e-3 * rng.normal(size=(2, 30, 3))
    points = points[direction_angle(points, points @ rotation.T @ rotation + t @ rotation) > 0.05]
    noise = noise[:, : len(points)]
    return (
        rotation,
        t,
        unit(unit(points) + noise[0]),
        unit(unit(points @ rotation.T + t) + noise[1]),
    )


# rotations


@law
@given(SEEDS)
def test_angles_are_a_metric_that_no_frame_and_no_mirror_changes(seed):
    a, b, c, turn = rotations(np.random.default_rng(seed), 4)
    angle = angle_between(a, b)
    exact = 4e-15 / max(np.cos(angle / 2), 1e-7)  # a half turn is the end of the arcsine
    assert abs(angle - angle_between(b, a)) < exact
    assert angle <= angle_between(a, c) + angle_between(c, b) + exact
    for first, second in ((turn @ a, turn @ b), (a @ turn, b @ turn), (a.T, b.T)):
        assert abs(angle_between(first, second) - angle) < exact
    mirrored = angle_between(MIRROR @ a @ MIRROR, MIRROR @ b @ MIRROR)
    assert abs(mirrored - angle) < exact


@law
@given(SEEDS)
def test_vectors_turn_with_their_rotations(seed):
    """R exp(v) R' = exp(R v); the inverse is exp(-v); quaternions of both signs are one."""
    rng = np.random.default_rng(seed)
    vector, turn = rng.normal(size=3), rotations(rng, 1)[0]
    matrix = matrix_from_vector(vector)
    np.testing.assert_allclose(
        turn @ matrix @ turn.T, matrix_from_vector(turn @ vector), atol=1e-14
    )
    np.testing.assert_allclose(matrix_from_vector(-vector), matrix.T, atol=1e-15)
    if np.linalg.norm(vector) < 3.1:
        turned = vector_from_matrix(turn @ matrix @ turn.T)
        np.testing.assert_allclose(turned, turn @ vector, atol=1e-13)
    w, *xyz = quaternion_from_matrix(matrix)
    np.testing.assert_allclose(quaternion_from_matrix(matrix.T), [w, *np.negative(xyz)], atol=1e-14)


@law
@given(SEEDS)
def test_the_smallest_turn_is_across_and_back(seed):
    rng = np.random.default_rng(seed)
    first, second = rng.normal(size=(2, 50, 3))
    second[direction_angle(first, second) > 3] *= -1  # nearly a half turn: the axis is rounding
    second[:10] = -3 * first[:10]
    turn = turn_between(first, second)
    np.testing.assert_allclose(
        turn @ np.swapaxes(turn, 1, 2), np.tile(np.eye(3), (50, 1, 1)), atol=1e-13
    )
    turned = (turn @ unit(first)[..., None])[..., 0]
    np.testing.assert_allclose(turned, unit(second), atol=1e-13)
    angle = angle_between(turn, np.eye(3))
    np.testing.assert_allclose(angle, direction_angle(first, second), atol=1e-7)
    back = turn_between(second[10:], first[10:])
    np.testing.assert_allclose(back, np.swapaxes(turn[10:], 1, 2), atol=1e-12)


@law
@given(SEEDS)
def test_the_nearest_rotation_and_the_look_turn_with_the_world(seed):
    rng = np.random.default_rng(seed)
    matrix, (left, right) = rng.normal(size=(3, 3)), rotations(rng, 2)
    expected = left @ nearest_rotation(matrix) @ right
    gap = np.linalg.svd(matrix)[1]
    sure = gap[1] - gap[2] if np.linalg.det(matrix) < 0 else gap[1] + gap[2]
    np.testing.assert_allclose(nearest_rotation(left @ matrix @ right), expected, atol=1e-14 / sure)
    directions, down = rng.normal(size=(5, 3)), rng.normal(size=3)
    looks = looking_along(directions @ left.T, left @ down)
    np.testing.assert_allclose(looks, looking_along(directions, down) @ left.T, atol=1e-13)


@law
@given(SEEDS)
def test_alignment_undoes_any_similarity_in_any_order(seed):
    """Of clouds that are not alike: what is done to one of them is done to the answer."""
    rng = np.random.default_rng(seed)
    source, target = rng.normal(size=(2, 12, 3)) + np.arange(12)[:, None] % 3
    target += 2 * source
    scale, rotation, shift = align_by_similarity(source, target)
    factor, turn, moved = rng.uniform(0.1, 10), rotations(rng, 1)[0], rng.normal(size=3)
    order = rng.permutation(12)
    found = align_by_similarity(source[order], factor * target[order] @ turn.T + moved)
    np.testing.assert_allclose(found[0], factor * scale, rtol=1e-12)
    np.testing.assert_allclose(found[1], turn @ rotation, atol=1e-12)
    np.testing.assert_allclose(found[2], factor * turn @ shift + moved, atol=1e-11)


# two views


@law
@given(SEEDS)
def test_two_views_may_be_exchanged(seed):
    rotation, t, rays_a, rays_b = two_views(np.random.default_rng(seed))
    matrix = essential_matrix(rotation, t)
    error = sampson_angle(matrix, rays_a, rays_b)
    back_rotation, back_t = rotation.T, -rotation.T @ t
    back = essential_matrix(back_rotation, back_t)
    np.testing.assert_allclose(
        np.abs(sampson_angle(back, rays_b, rays_a)), np.abs(error), atol=1e-13
    )
    found = depths(rotation, t, rays_a, rays_b)
    exchanged = depths(back_rotation, back_t, rays_b, rays_a)
    for one, other in zip(found, reversed(exchanged), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9)


@law
@given(SEEDS)
def test_two_views_in_any_axes_and_unit_and_in_a_mirror(seed):
    rng = np.random.default_rng(seed)
    rotation, t, rays_a, rays_b = two_views(rng)
    error = sampson_angle(essential_matrix(rotation, t), rays_a, rays_b)
    depth = np.stack(depths(rotation, t, rays_a, rays_b))
    turn_a, turn_b = rotations(rng, 2)
    for to_a, to_b in ((turn_a, turn_b), (MIRROR, MIRROR)):
        turned = to_b @ rotation @ to_a.T, 7 * to_b @ t, rays_a @ to_a.T, rays_b @ to_b.T
        again = sampson_angle(essential_matrix(*turned[:2]), *turned[2:])
        np.testing.assert_allclose(np.abs(again), np.abs(error), atol=1e-13)
        np.testing.assert_allclose(np.stack(depths(*turned)), 7 * depth, rtol=1e-9)


@law
@given(SEEDS)
def test_an_essential_matrix_of_any_size_and_sign_has_one_pose(seed):
    rng = np.random.default_rng(seed)
    rotation, t, rays_a, rays_b = two_views(rng)
    matrix = essential_matrix(rotation, t)
    order = rng.permutation(len(rays_a))
    for factor in (1.0, -0.01):
        found = pose_from_essential(factor * matrix, rays_a[order], rays_b[order])
        assert angle_between(found[0], rotation) < 1e-7
        assert direction_angle(found[1], t) < 1e-7


# many views


@law
@given(SEEDS, st.integers(2, 6))
def test_points_go_with_the_world_and_its_unit(seed, views):
    rng = np.random.default_rng(seed)
    rig = rig_of(rng, views)
    rays, precision = seen_by(rng, rig), np.full((views, 20), 1e6)
    points = intersect(rig, rays, precision)
    turn, factor, shift = rotations(rng, 1)[0], rng.uniform(0.1, 10), rng.normal(size=3)
    rotation = rig.rotation @ turn.T
    moved = replace(rig, rotation=rotation, translation=factor * rig.translation - rotation @ shift)
    turned = np.einsum("ij,vjn->vin", turn, rays)
    size = 1 + np.linalg.norm(points, axis=0)
    gap = intersect(moved, turned, precision) - (factor * turn @ points + shift[:, None])
    assert (np.abs(gap) / size).max() < 1e-6
    angles = ray_angles(rig, points, np.einsum("vij,vjn->vin", rig.rotation, rays))
    found = factor * turn @ points + shift[:, None]
    again = ray_angles(moved, found, np.einsum("vij,vjn->vin", moved.rotation, turned))
    np.testing.assert_allclose(again[0], angles[0], atol=1e-13)
    np.testing.assert_array_equal(again[1], angles[1])


@law
@given(SEEDS, st.integers(2, 6))
def test_the_order_of_views_and_points_does_not_matter(seed, views):
    rng = np.random.default_rng(seed)
    rig = rig_of(rng, views)
    rays, precision = seen_by(rng, rig), rng.uniform(1e5, 1e6, (views, 20))
    points = intersect(rig, rays, precision)
    view, point = rng.permutation(views), rng.permutation(20)
    found = intersect(rig.select(view), rays[view][:, :, point], precision[view][:, point])
    np.testing.assert_allclose(found, points[:, point], rtol=1e-6, atol=1e-6)
    weight = precision / 1e6
    angles = median_angles(rig, points, weight)
    again = median_angles(rig.select(view), points[:, point], weight[view][:, point])
    np.testing.assert_allclose(again, angles[view][:, point], rtol=1e-4)


# lenses, bodies, graphs


@law
@given(SEEDS)
def test_lenses_in_a_mirror_and_turned_about_their_axis(seed):
    """A mirror changes the sign of the tangential p2; radial lenses know no axis."""
    rng = np.random.default_rng(seed)
    image, angle = rng.uniform(-0.7, 0.7, (2, 30)), rng.uniform(0, 2 * np.pi)
    turn = matrix_from_vector(np.array([0.0, 0.0, angle]))[:2, :2]
    k1, k2, p1, p2, *more = 0.1 * rng.normal(size=8)

    def distort(points: np.ndarray, *distortion: float, fisheye: bool = False) -> np.ndarray:
        camera = Camera("a", (1, 1), np.eye(3), np.array(distortion), fisheye)
        return project(camera, np.concatenate([points, np.ones((1, 30))]))

    mirrored = distort(MIRROR[:2, :2] @ image, k1, k2, p1, -p2, *more)
    expected = MIRROR[:2, :2] @ distort(image, k1, k2, p1, p2, *more)
    np.testing.assert_allclose(mirrored, expected, atol=1e-14)
    for lens, fisheye in (((k1, k2, 0.0, 0.0, *more), False), ((k1, k2, p1, p2), True)):
        turned = distort(turn @ image, *lens, fisheye=fisheye)
        expected = turn @ distort(image, *lens, fisheye=fisheye)
        np.testing.assert_allclose(turned, expected, atol=1e-14)


@law
@given(SEEDS, st.booleans())
def test_a_pixel_knows_no_distance(seed, fisheye):
    rng = np.random.default_rng(seed)
    matrix = np.array([[1000.0, 0, 500], [0, 900.0, 400], [0, 0, 1]])
    lens = 0.05 * rng.normal(size=4)
    camera = Camera("a", (1000, 800), matrix, lens, fisheye)
    points = rng.uniform(-1, 1, (30, 3)) + [0, 0, 3]
    pixels = pixels_from_points(camera, points)
    farther = pixels_from_points(camera, points * rng.uniform(0.1, 10, (30, 1)))
    np.testing.assert_allclose(farther, pixels, atol=1e-10)


@law
@given(SEEDS)
def test_sizes_of_bodies_go_with_the_unit_alone(seed):
    rng = np.random.default_rng(seed)
    bodies = rng.normal(size=(7, 9, 3)) * rng.uniform(0.5, 2, (7, 1, 1))
    bodies[rng.random((7, 9)) < 0.2] = np.nan
    turn, factor = rotations(rng, 1)[0], rng.uniform(0.1, 10)
    again = factor * bodies[rng.permutation(7)][:, rng.permutation(9)] @ turn.T + rng.normal(size=3)
    np.testing.assert_allclose(body_size(again), factor * body_size(bodies), rtol=1e-13)


@law
@given(SEEDS, st.integers(2, 12))
def test_graphs_know_no_names_of_nodes(seed, nodes):
    rng = np.random.default_rng(seed)
    order = rng.permutation(nodes)
    cost = np.where(rng.random((nodes, nodes)) < 0.4, rng.random((nodes, nodes)), np.inf)
    cost = np.minimum(cost, cost.T)
    renamed = cost[np.ix_(order, order)]
    total = cost[tuple(spanning_tree(cost).T)].sum()
    tree = spanning_tree(renamed, root=int(rng.integers(nodes)))
    np.testing.assert_allclose(renamed[tuple(tree.T)].sum(), total, rtol=1e-13)
    first, second = np.nonzero(np.isfinite(cost))
    part = connected_parts(first, second, nodes)
    parts = connected_parts(*np.nonzero(np.isfinite(renamed)), nodes)
    same = part[order][:, None] == part[order]
    np.testing.assert_array_equal(parts[:, None] == parts, same)
    assert len(tree) == nodes - len(np.unique(part))
