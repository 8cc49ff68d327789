"""What detections say about a relative pose, held to its definitions."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from oracles import pairs as oracle
from scenes import lifted, recording, scene

from mocap_calib.config import PairwiseConfig
from mocap_calib.geometry.epipolar import depths, essential_matrix, sampson_angle
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.kernels.association import share_in_front
from mocap_calib.pairs.affinity import (
    body_agreement,
    epipolar_affinity,
    epipolar_fit,
    match_affinity,
    mutual_best,
    pose_error,
    pose_variance,
)
from mocap_calib.pairs.view_pair import (
    body_sizes_per_radian,
    distance_ratios,
    distances,
    distances_by_size,
    gather_view_pair,
)
from mocap_calib.results import LiftedPoses


def ten_frames_of_two_views():
    bodies = LiftedPoses(*(each[:, :10] for each in vars(lifted()).values()))
    sample = recording().select(frames=np.arange(10))
    rng = np.random.default_rng(0)
    pair = gather_view_pair(sample, bodies, (0, 1), config=PairwiseConfig(), rng=rng)
    assert len(pair.frames) == 10
    return pair


def body_distance(pair, rotation):
    """The mean squared joint distance `[M, frame, I, J]` of lifted bodies, 0 if not lifted."""
    every, shape = np.arange(pair.lifted.size), pair.lifted.shape
    error = pose_error(pair, rotation, every, PairwiseConfig()).reshape(-1, *shape)
    return error * pose_variance(pair, PairwiseConfig())


def test_pose_error_is_the_weighted_distance_of_turned_bodies():
    pair, bodies = ten_frames_of_two_views(), lifted()
    rotation = matrix_from_vector(np.array([[0.3, -1.0, 0.2]]))
    fast = body_distance(pair, rotation)[0]
    weight = np.nan_to_num([1 / (bodies.spread[v, :10] ** 2 + 0.05**2) for v in (0, 1)])
    w = weight[0][:, :, None] * weight[1][:, None]
    gap = (np.nan_to_num(bodies.body[0, :10]) @ rotation[0].T)[:, :, None] - np.nan_to_num(
        bodies.body[1, :10]
    )[:, None]
    slow = (w * (gap**2).sum(-1)).sum(-1) / np.maximum(w.sum(-1), 1e-12)
    np.testing.assert_allclose(fast, slow, atol=1e-10)


def test_bodies_agree_by_pose_and_place_as_far_as_the_network_is_sure():
    """The doubt is the expected squared distance of two lifts, with the weights of the error."""
    pair, config, bodies = ten_frames_of_two_views(), PairwiseConfig(), lifted()
    rotation = matrix_from_vector(np.array([[0.3, -1.0, 0.2], [0.1, 0.5, 0.0]]))
    translation = np.array([[1.0, 1.0, 1.0], [1.0, 2.0, 3.0]])
    variance = [np.nan_to_num(bodies.spread[v, :10]) ** 2 for v in (0, 1)]
    weight = [np.nan_to_num(1 / (bodies.spread[v, :10] ** 2 + 0.05**2)) for v in (0, 1)]
    w = weight[0][:, :, None] * weight[1][:, None]
    doubt = (w * (variance[0][:, :, None] + variance[1][:, None])).sum(-1)
    doubt *= config.pose_doubt**2 / np.maximum(w.sum(-1), 1e-12)
    tolerance = np.maximum(config.pose_tolerance**2, doubt)
    pose = body_distance(pair, rotation) / tolerance
    turned = np.einsum("mij,faj->mfai", rotation, pair.a.centre) + translation[:, None, None]
    place = ((turned[:, :, :, None] - pair.b.centre[:, None]) ** 2).sum(-1)
    place /= pair.a.distance[:, :, None] ** 2 + pair.b.distance[:, None] ** 2
    place /= config.centre_tolerance**2
    slow = (w.sum(-1) > 0) * np.exp(-pose / 2) / (1 + place / 2)
    found = body_agreement(pair, rotation, translation, config)
    np.testing.assert_allclose(found, slow, atol=1e-12)
    assert (doubt > config.pose_tolerance**2).any()


def test_epipolar_error_is_sampsons_at_the_body():
    pair = ten_frames_of_two_views()
    rotation, translation = matrix_from_vector(np.array([0.1, 0.5, 0.0])), np.array([0.6, 0.0, 0.8])
    error, weight = oracle.epipolar_error(pair, rotation[None], translation[None])
    matrix = essential_matrix(rotation, translation)
    angle = sampson_angle(matrix, pair.a.rays[3, 1], pair.b.rays[3, 2])
    slow = np.abs(angle) * body_sizes_per_radian(pair)[3, 1, 2]
    known = weight[3, 1, 2] > 0
    assert known.any()
    np.testing.assert_allclose(error[0, 3, 1, 2][known], slow[known], atol=1e-12)


def poses_of_some_hypotheses():
    rng = np.random.default_rng(4)
    rotation = matrix_from_vector(rng.normal(size=(5, 3)))
    return SimpleNamespace(rotation=rotation, translation=rng.normal(size=(5, 3)))


def test_the_compiled_fit_of_matches_is_that_of_the_definition():
    pair, config, poses = ten_frames_of_two_views(), PairwiseConfig(), poses_of_some_hypotheses()
    fit = epipolar_fit(pair, poses.rotation, poses.translation, config)
    defined, weight = oracle.epipolar_error(pair, poses.rotation, poses.translation)
    np.testing.assert_allclose(fit, oracle.epipolar_fit(defined, weight, config), rtol=1e-9)
    assert 0 < (fit > 0).mean() < 1


def test_affinity_is_the_epipolar_fit_times_the_root_of_the_agreement_of_bodies():
    pair, config, poses = ten_frames_of_two_views(), PairwiseConfig(), poses_of_some_hypotheses()
    affinity, fit, pose = match_affinity(pair, poses.rotation, poses.translation, config)
    bodies = body_agreement(pair, poses.rotation, poses.translation, config)
    expected = np.where(pair.lifted > 0, np.sqrt(bodies), 1.0)
    np.testing.assert_allclose(affinity, fit * expected, rtol=1e-9)
    assert (pose[:, pair.lifted == 0] == 1).all()


def test_the_compiled_share_in_front_is_that_of_the_depths():
    pair, poses = ten_frames_of_two_views(), poses_of_some_hypotheses()
    rng = np.random.default_rng(6)
    matched = rng.random((5, *pair.lifted.shape)) < 0.3
    matched[3] = False
    found = np.zeros(5)
    of_views = (pair.a.rays, pair.b.rays, pair.a.weight, pair.b.weight)
    share_in_front(poses.rotation, poses.translation, *of_views, matched, found)
    np.testing.assert_allclose(found, oracle.share_of_depths(pair, poses, matched), rtol=1e-12)
    assert found[3] == 0
    assert np.unique(found).size > 2


def test_the_affinity_by_a_rig_is_the_epipolar_fit_of_its_pairs():
    """Both say the same of a pair of views, given the same distances of the bodies."""
    sample, rig, config = recording(), scene().rig, PairwiseConfig()
    rng = np.random.default_rng(0)
    pair = gather_view_pair(sample, lifted(), (0, 2), config=config, rng=rng)
    error, weight = oracle.epipolar_error(pair, *(part[None] for part in rig.relative(0, 2)))
    distance = distances(lifted().centre, sample.rays)
    affinity, comparable = epipolar_affinity(sample, rig, distance, config)
    instances = sample.positions.shape[2]
    rows, columns = slice(0, instances), slice(2 * instances, 3 * instances)
    fit = oracle.epipolar_fit(error, weight, config)[0]
    assert len(pair.frames) > 50
    np.testing.assert_allclose(affinity[pair.frames, rows, columns], fit, atol=1e-9)
    assert ((comparable[pair.frames, rows, columns] > 0) | (fit == 0)).all()
    np.testing.assert_array_equal(affinity, np.swapaxes(affinity, 1, 2))


@pytest.mark.parametrize("frames", [1, 19, 20, 21])
def test_the_affinity_of_a_frame_does_not_depend_on_those_beside_it(frames):
    """Kernels look at several side by side; a frame without detections has none."""
    rig, config = scene().rig, PairwiseConfig()
    sample = recording().select(frames=np.arange(frames))
    confidence = sample.confidence.copy()
    confidence[:, frames // 2] = 0.0
    sample = replace(sample, confidence=confidence)
    distance = distances(lifted().centre[:, :frames], sample.rays)
    together = epipolar_affinity(sample, rig, distance, config)
    for frame in range(frames):
        alone = sample.select(frames=np.array([frame]))
        found = epipolar_affinity(alone, rig, distance[:, [frame]], config)
        for one, all in zip(found, together, strict=True):
            np.testing.assert_array_equal(one[0], all[frame])
    assert not together[1][frames // 2].any()
    assert frames == 1 or together[1].any()


@pytest.mark.parametrize("shape", [(0, 17), (1, 1), (4, 6, 17)])
def test_the_compiled_distances_by_size_are_those_of_the_definition(shape):
    """Of bodies with joints that are missing, and of one without any."""
    rng = np.random.default_rng(0)
    rays = 0.05 * rng.normal(size=(*shape, 3)) + [0, 0, 1]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    rays[rng.random(shape) < 0.3] = np.nan
    rays[:1, :1] = np.nan
    found, expected = distances_by_size(rays), oracle.distances_by_size(rays)
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert found.shape == shape[:-1]


def test_distances_are_compared_where_joints_are_in_front_of_both_views():
    """Under a wrong pose, by which some joints are behind one of them."""
    pair, matched = ten_frames_of_two_views(), np.zeros((10, 3, 3), dtype=bool)
    matched[:, :2, 1:] = True
    shape = pair.lifted.shape
    matched = np.pad(matched, [(0, 0), (0, shape[1] - 3), (0, shape[2] - 3)])
    rotation, translation = matrix_from_vector(np.array([0.1, 1.0, 0.0])), np.array([1.0, 0.0, 2.0])
    expected, one_sided = [], 0
    for frame, i, j in zip(*np.nonzero(matched), strict=True):
        seen = (pair.a.weight[frame, i] > 0) & (pair.b.weight[frame, j] > 0)
        rays_a, rays_b = pair.a.rays[frame, i, seen], pair.b.rays[frame, j, seen]
        ahead_a, ahead_b = depths(rotation, translation, rays_a, rays_b)
        one_sided += int(((ahead_a > 0) ^ (ahead_b > 0)).sum())
        both = (ahead_a > 0) & (ahead_b > 0)
        body = pair.a.distance[frame, i] + pair.b.distance[frame, j]
        expected.append(body / (ahead_a + ahead_b)[both])
    assert one_sided > 0
    found = distance_ratios(pair.a, pair.b, rotation, translation, matched)
    np.testing.assert_allclose(found, np.concatenate(expected), rtol=1e-9)


def test_the_unlike_stay_alone():
    affinity = np.array([[0.9, 0.0], [0.0, 0.0]])
    assert mutual_best(affinity).tolist() == [[True, False], [False, False]]


def test_no_detection_is_matched_twice_where_affinities_tie():
    """As of a detection that a file has twice: its second row or column stays unmatched."""
    affinity = np.array([[0.9, 0.9, 0.1], [0.1, 0.1, 0.8], [0.1, 0.1, 0.8]])
    matched = mutual_best(affinity)
    assert matched.tolist() == [[True, False, False], [False, False, True], [False] * 3]
    both = mutual_best(np.full((4, 2, 2), 0.5))
    np.testing.assert_array_equal(both, np.tile([[True, False], [False, False]], (4, 1, 1)))
