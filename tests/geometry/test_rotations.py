"""Laws of rotations, similarities, sizes of bodies and graphs, for any input.

The same examples are drawn in each run; tolerances are a few times the rounding that was measured.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rigs import random_rotations, rig_looking_at_origin, unit
from scenes import similar
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial.transform import Rotation

from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.graphs import connected_parts, fiedler_vector, spanning_tree
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


@law
@given(SEEDS)
def test_sizes_of_bodies_go_with_the_unit_alone(seed):
    rng = np.random.default_rng(seed)
    bodies = rng.normal(size=(7, 9, 3)) * rng.uniform(0.5, 2, (7, 1, 1))
    bodies[rng.random((7, 9)) < 0.2] = np.nan
    turn, factor = random_rotations(rng, 1)[0], rng.uniform(0.1, 10)
    again = factor * bodies[rng.permutation(7)][:, rng.permutation(9)] @ turn.T + rng.normal(size=3)
    close(body_size(again), factor * body_size(bodies), rtol=1e-13)


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


def test_long_chains_are_one_part_and_the_fiedler_vector_follows_a_chain():
    """In any order of the nodes; of a chain the vector is a half of a cosine."""
    order = np.random.default_rng(0).permutation(100_000)
    for nodes in (np.arange(100_000), order):
        assert not connected_parts(nodes[:-1], nodes[1:], 100_000).any()
    order = np.random.default_rng(0).permutation(30)
    weight = np.zeros((30, 30))
    weight[order[1:], order[:-1]] = weight[order[:-1], order[1:]] = 1.0
    found = np.argsort(fiedler_vector(weight))
    assert found.tolist() in (order.tolist(), order[::-1].tolist())
