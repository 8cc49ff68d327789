"""Pairs of views: affinities held to their definitions, refinement, and scenes with truth."""

import pickle
from dataclasses import replace
from itertools import combinations, product

import numpy as np
import pytest
from rigs import unit
from scenes import lifted, precision, recording, scene

from mocap_calib.config import Config, PairwiseConfig
from mocap_calib.geometry.epipolar import depths, essential_matrix, sampson_angle
from mocap_calib.geometry.rotation import angle_between, direction_angle, matrix_from_vector
from mocap_calib.kernels.lens import LANES
from mocap_calib.pairs.affinity import (
    body_agreement,
    epipolar_affinity,
    epipolar_fit,
    match_affinity,
    mutual_best,
    pose_error,
    refine_poses,
    score_hypotheses,
)
from mocap_calib.pairs.solve import calibrate_pair, calibrate_pairs, search_hypotheses
from mocap_calib.pairs.view_pair import (
    ViewPair,
    are_flat,
    distance_ratios,
    distances,
    distances_by_size,
    gather_view_pair,
    in_blocks,
)
from mocap_calib.results import LiftedPoses, PairwiseCalibration
from mocap_calib.rig.associate import associate
from mocap_calib.types import Sample, silent

CONFIG = PairwiseConfig()
VIEWS, FEW = (0, 1), np.arange(6)
close = np.testing.assert_allclose


def gather(
    sample: Sample,
    bodies: LiftedPoses,
    views: tuple[int, int] = VIEWS,
    config: PairwiseConfig = CONFIG,
) -> ViewPair:
    rng = np.random.default_rng(0)
    return gather_view_pair(sample, bodies, views, config=config, rng=rng)


def few_frames() -> tuple[Sample, LiftedPoses, ViewPair]:
    bodies = LiftedPoses(*(each[:, FEW] for each in vars(lifted()).values()))
    sample = recording().select(frames=FEW)
    pair = gather(sample, bodies)
    assert len(pair.frames) == len(FEW)
    return sample, bodies, pair


def some_poses() -> tuple[np.ndarray, np.ndarray]:
    """Return the true relative pose in some unit, and two others."""
    rng = np.random.default_rng(4)
    turn, shift = scene().rig.relative(*VIEWS)
    rotation = np.concatenate([turn[None], matrix_from_vector(rng.normal(size=(2, 3)))])
    return rotation, np.concatenate([5 * shift[None], rng.normal(size=(2, 3))])


# affinities


def defined_affinity(sample: Sample, bodies: LiftedPoses, rotation, translation) -> np.ndarray:
    """Return `[fit, agreement, pose][frame, I, J]` of two views, one match after the other.

    The weighted share of joints that fit; how well bodies and their centres agree, and bodies
    alone, both 1 where one of them was not lifted.
    """
    matrix = essential_matrix(rotation, unit(translation))
    found = np.zeros((3, *bodies.centre.shape[1:3], bodies.centre.shape[2]))
    found[1:] = 1.0
    far = distances(bodies.centre, sample.rays)
    for frame, i, j in np.ndindex(found.shape[1:]):
        (rays_a, body_a, doubt_a, centre_a, far_a), (rays_b, body_b, doubt_b, centre_b, far_b) = (
            (sample.rays[at], bodies.body[at], bodies.spread[at], bodies.centre[at], far[at])
            for at in ((0, frame, i), (1, frame, j))
        )
        weight = sample.confidence[0, frame, i] * sample.confidence[1, frame, j]
        seen = weight > 0
        if seen.sum() >= CONFIG.least_joints:
            error = sampson_angle(matrix, rays_a[seen], rays_b[seen])
            error *= np.sqrt(2 / (far_a**-2 + far_b**-2)) / CONFIG.inlier
            found[0, frame, i, j] = (weight[seen] / (1 + error**2)).sum() / weight.sum()
        if np.isfinite([centre_a, centre_b]).all():
            sure = 1 / (doubt_a**2 + 0.05**2) / (doubt_b**2 + 0.05**2)
            gap = ((body_a @ rotation.T - body_b) ** 2).sum(-1)
            expected = (sure * (doubt_a**2 + doubt_b**2)).sum() / sure.sum()
            tolerance = max(CONFIG.pose_tolerance**2, CONFIG.pose_doubt**2 * expected)
            pose = np.exp(-(sure * gap).sum() / sure.sum() / tolerance / 2)
            off = ((rotation @ centre_a + translation - centre_b) ** 2).sum()
            off /= (far_a**2 + far_b**2) * CONFIG.centre_tolerance**2
            found[1:, frame, i, j] = pose / (1 + off / 2), pose
    return found


def test_affinities_are_those_of_their_definition():
    """Epipolar fit times the root of the agreement of bodies, whose poses and places count."""
    sample, bodies, pair = few_frames()
    rotation, translation = some_poses()
    defined = [
        defined_affinity(sample, bodies, *each) for each in zip(rotation, translation, strict=True)
    ]
    fit, agreement, pose = np.moveaxis(defined, 1, 0)
    assert 0.1 < (fit > 0).mean() < 0.9
    assert 0.1 < pair.lifted.mean() < 0.9
    close(epipolar_fit(pair, rotation, translation, CONFIG), fit, rtol=1e-9)
    found = body_agreement(pair, rotation, translation, CONFIG)
    close(found, agreement * pair.lifted, atol=1e-12)
    affinity = match_affinity(pair, rotation, translation, CONFIG)
    for one, expected in zip(affinity, (fit * np.sqrt(agreement), fit, pose), strict=True):
        close(one, expected, atol=1e-11)


def test_scores_are_of_the_mutual_matches_in_front_of_both_views():
    """The share of possible matches by their fit, x the share in front, x the root of the poses."""
    _, _, pair = few_frames()
    rotation, translation = some_poses()
    source = np.array(["made"] * 3)
    found = score_hypotheses(pair, rotation, translation, source, CONFIG)
    affinity, fit, pose = match_affinity(pair, rotation, translation, CONFIG)
    for m, matched in enumerate(found.matched):
        np.testing.assert_array_equal(matched, mutual_best(affinity[m]))
        frame, i, j = np.nonzero(matched)
        seen = (pair.a.weight[frame, i] > 0) & (pair.b.weight[frame, j] > 0)
        rays = pair.a.rays[frame, i][seen], pair.b.rays[frame, j][seen]
        ahead = (np.stack(depths(rotation[m], translation[m], *rays)) > 0).all(0).mean()
        assert found.in_front[m] == pytest.approx(ahead)
        possible = np.minimum(pair.a.present.sum(1), pair.b.present.sum(1)).sum()
        score = fit[m][matched].sum() / possible * ahead * np.sqrt(pose[m][matched].mean())
        assert found.score[m] == pytest.approx(score)
    assert found.in_front[0] == 1
    assert (found.in_front[1:] < 1).any()


@pytest.mark.parametrize("frames", [1, 20, 21])
def test_the_affinity_by_a_rig_is_that_of_its_pairs_and_of_each_frame(frames):
    """Kernels look at several frames side by side; a frame without detections has none."""
    rig, sample = scene().rig, recording().select(frames=np.arange(frames))
    confidence = sample.confidence.copy()  # the scene is that of other tests, too
    confidence[:, frames // 2] = 0.0
    sample = replace(sample, confidence=confidence)
    bodies = LiftedPoses(*(each[:, :frames] for each in vars(lifted()).values()))
    distance = distances(bodies.centre, sample.rays)
    affinity, comparable = together = epipolar_affinity(sample, rig, distance, CONFIG)
    for frame in range(frames):
        alone = sample.select(frames=np.array([frame]))
        found = epipolar_affinity(alone, rig, distance[:, [frame]], CONFIG)
        for one, all in zip(found, together, strict=True):
            np.testing.assert_array_equal(one[0], all[frame])
    assert not comparable[frames // 2].any()
    np.testing.assert_array_equal(affinity, np.swapaxes(affinity, 1, 2))
    pair = gather(sample, bodies, (0, 2))
    fit = epipolar_fit(pair, *(part[None] for part in rig.relative(0, 2)), CONFIG)[0]
    instances = sample.positions.shape[2]
    block = np.s_[pair.frames, :instances, 2 * instances : 3 * instances]
    close(affinity[block], fit, atol=1e-9)
    assert ((comparable[block] > 0) | (fit == 0)).all()
    assert frames == 1 or fit.any()


def test_a_body_is_as_far_as_it_looks_small():
    """By the centre of a lifted body, else by the spread of the rays (within 4 %, in any pose)."""
    rng = np.random.default_rng(0)
    bodies = rng.normal(size=(2000, 17, 3))
    bodies -= bodies.mean(1, keepdims=True)
    bodies /= np.sqrt((bodies**2).sum(-1).mean(-1))[:, None, None]
    far = rng.uniform(5, 50, 2000)
    rays = unit(bodies + far[:, None, None] * unit(rng.normal(size=(2000, 1, 3))))
    assert np.sqrt(((distances_by_size(rays) / far) ** -2).mean()) == pytest.approx(1, rel=0.04)
    rays[0, 5:] = np.nan
    assert distances_by_size(rays)[0] == pytest.approx(distances_by_size(rays[:1, :5])[0])
    centre = np.full((2000, 3), np.nan)
    centre[1] = 3.0, 0.0, 4.0
    close(distances(centre, rays), np.where(np.arange(2000) == 1, 5.0, distances_by_size(rays)))


def test_no_detection_is_matched_twice_or_with_what_is_unlike():
    """Where affinities tie, as of a detection that a file has twice, the first counts."""
    affinity = np.array([[0.9, 0.9, 0.1], [0.1, 0.1, 0.8], [0.1, 0.1, 0.8]])
    matched = mutual_best(affinity)
    assert matched.tolist() == [[True, False, False], [False, False, True], [False] * 3]
    both = mutual_best(np.full((4, 2, 2), 0.5))
    np.testing.assert_array_equal(both, np.tile([[True, False], [False, False]], (4, 1, 1)))
    alone = mutual_best(np.array([[0.9, 0.0], [0.0, 0.0]]))
    assert alone.tolist() == [[True, False], [False, False]]


# bodies too flat for their front and back to be determined


def reversed_in_depth(bodies: LiftedPoses, which: np.ndarray) -> LiftedPoses:
    """Return the bodies mirrored along their line of sight, of those `[view, frame, instance]`."""
    sight = unit(bodies.centre)
    depth = (bodies.body * sight[..., None, :]).sum(-1, keepdims=True)
    mirrored = bodies.body - 2 * depth * sight[..., None, :]
    return replace(bodies, body=np.where(which[..., None, None], mirrored, bodies.body))


def exact_scene(thickness: float = 1.0) -> tuple[Sample, LiftedPoses]:
    """Return two frames of people, seen exactly and lifted exactly, whose unit is their size.

    thickness: what is left of it. The network states a spread of 0.1 body sizes.
    """
    made, seen = scene(), recording().select(frames=np.arange(2))
    poses, who = made.poses[:2], made.identity[:, :2]
    middle = poses.mean(-2, keepdims=True)
    _, _, axes = np.linalg.svd(poses - middle, full_matrices=False)
    across = ((poses - middle) @ axes[..., 2, :, None]) * axes[..., None, 2, :]
    poses = poses - (1 - thickness) * across
    turn, shift = (x[:, None, None] for x in (made.rig.rotation, made.rig.translation))
    inside = np.stack([poses[np.arange(2)[:, None], of_view] for of_view in who])
    inside = inside @ np.swapaxes(turn, -1, -2) + shift[..., None, :]
    inside[who < 0] = np.nan
    centre = inside.mean(-2)
    body = inside - centre[..., None, :]
    size = np.sqrt((body**2).sum(-1).mean(-1))
    rays = unit(inside[..., seen.vocabulary, :])
    bodies = LiftedPoses(
        body=body / size[..., None, None],
        centre=centre / size[..., None],
        spread=np.where(np.isfinite(body[..., 0]), 0.1, np.nan),
    )
    known = np.isfinite(rays[..., 0]).astype(float)
    return replace(seen, rays=rays, positions=rays[..., :2], confidence=known), bodies


def test_only_flat_bodies_may_be_reversed():
    """A reversal moves people by 0.3 body sizes; the network is sure of them to 0.1."""
    frames = np.arange(2)
    assert not are_flat(recording(), lifted(), VIEWS, np.arange(60))
    assert not are_flat(*exact_scene(), VIEWS, frames)
    sample, bodies = exact_scene(0.1)
    assert are_flat(sample, bodies, VIEWS, frames)
    assert not are_flat(sample, replace(bodies, spread=bodies.spread / 20), VIEWS, frames)
    none = LiftedPoses(*(np.full_like(x, np.nan) for x in vars(bodies).values()))
    assert not are_flat(sample, none, VIEWS, frames)


def test_the_nearest_reading_counts():
    sample, bodies = exact_scene(0.1)
    pair = gather(sample, bodies)
    rotation, translation = some_poses()
    errors, agreements = [], []
    every = np.arange(pair.lifted.size)
    for of_both in product((False, True), repeat=2):
        which = np.zeros(bodies.centre.shape[:3], dtype=bool)
        which[0], which[1] = of_both
        mirrored = gather(sample, reversed_in_depth(bodies, which))
        one = replace(mirrored, cross=mirrored.cross[:1])
        errors.append(pose_error(one, rotation, every, CONFIG))
        agreements.append(body_agreement(one, rotation, translation, CONFIG))
    close(pose_error(pair, rotation, every, CONFIG), np.min(errors, 0), atol=1e-9)
    close(body_agreement(pair, rotation, translation, CONFIG), np.max(agreements, 0), atol=1e-9)


def test_flat_bodies_lifted_the_wrong_way_round_give_the_right_pose_and_identities():
    """Without both readings 43 degrees off, score 0.30, and 4 of 24 detections unmatched."""
    sample, bodies = exact_scene(0.1)
    wrong = np.random.default_rng(3).random(bodies.centre.shape[:3]) < 0.5
    bodies = reversed_in_depth(bodies, wrong)
    found = calibrate_pair(gather(sample, bodies), CONFIG)
    assert max(errors_deg(found)) < 0.01
    assert found.score > 0.99
    labels = associate(sample, bodies, scene().rig, Config(), progress=silent).labels
    who = scene().identity[:, :2]
    assert precision(labels, who) == 1
    assert ((labels >= 0) == (who >= 0)).all()


# refinement


ROTATION, BASELINE = matrix_from_vector(np.array([0.2, 1.0, -0.1])), np.array([-3.0, 0.2, 2.0])


def refined(turn, start, config=CONFIG, **known) -> tuple[np.ndarray, np.ndarray]:
    """Refine a pose off by a turn in degrees; by default of no rays and no bodies."""
    usual = {
        "rays": np.zeros((1, 1, 8, LANES)),
        "cross": np.zeros((1, 3, 3)),
        "inertia": np.zeros(1),
    }
    rotation = matrix_from_vector(np.radians([turn])) @ ROTATION
    return refine_poses(rotation, np.array([start]), config, **usual | known)


def test_refinement_finds_the_pose_among_gross_outliers():
    """From 6 degrees off, with 20 % outliers and 1 mrad of noise: measured 0.02 degrees."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-1.5, 1.5, (2000, 3)) + [0, 0, 5.0]
    both = (points, points @ ROTATION.T + BASELINE)
    a, b = (unit(unit(x) + rng.normal(0, 1e-3, x.shape)) for x in both)
    b[:400] = rng.permutation(b[:400])
    rays = np.column_stack([a, b, np.ones(2000), np.full(2000, 5.0)])
    given = {"rays": in_blocks(rays, 2000)[None], "config": PairwiseConfig(inlier=0.05)}
    found, direction = refined([3.0, -4.0, 3.0], BASELINE + 0.3, **given)
    assert np.degrees(angle_between(found[0], ROTATION)) < 0.1
    assert np.degrees(direction_angle(direction[0], BASELINE)) < 0.2
    assert np.linalg.norm(direction) == pytest.approx(np.linalg.norm(BASELINE + 0.3))


def test_lifted_bodies_determine_a_rotation_that_rays_leave_open():
    """Nine bodies, no ray, 30 degrees off: to 0.01 degrees after eight steps."""
    bodies = np.random.default_rng(1).normal(size=(9, 17, 3))
    cross = np.einsum("nkx,nky->xy", bodies, bodies @ ROTATION.T)[None]
    inertia = np.array([(bodies**2).sum()])
    found, direction = refined([0, 30.0, 0], [1.0, 0, 0], cross=cross, inertia=inertia)
    assert np.degrees(angle_between(found[0], ROTATION)) < 0.05
    close(direction, [[1.0, 0.0, 0.0]])


# scenes with truth


def errors_deg(pair: PairwiseCalibration) -> tuple[float, float]:
    """Return the errors of the rotation and of the direction of the baseline."""
    rotation, translation = scene().rig.relative(pair.a, pair.b)
    turned = angle_between(pair.rotation, rotation)
    return np.degrees(turned), np.degrees(direction_angle(pair.translation, translation))


def away(function, items):
    """Calibrate pairs in another process, as it were, and in another order."""
    sent = (pickle.loads(pickle.dumps((function, item))) for item in items)
    return reversed([call(item) for call, item in sent])


def test_pairs_of_a_ring_of_strangers():
    """Three people, order shuffled: measured 0.1 to 0.4 degrees, no wrong match.

    Baselines come in one unit: body sizes over metres are within 3 % of each other. The same is
    found elsewhere, in any order and of a pair alone.
    """
    made, rng = scene(), np.random.default_rng(0)
    pairs = calibrate_pairs(recording(), lifted(), CONFIG, rng=rng, progress=silent)
    assert [(p.a, p.b) for p in pairs] == list(combinations(range(4), 2))
    for pair in pairs:
        assert max(np.array(errors_deg(pair)) / [1.5, 2.0]) < 1
        frame, i, j = pair.matches.T
        who_a, who_b = made.identity[pair.a, frame, i], made.identity[pair.b, frame, j]
        known = (who_a >= 0) & (who_b >= 0)
        assert (who_a == who_b)[known].mean() > 0.99
        assert pair.in_front > 0.99
        assert 0.5 < pair.score < 1
    lengths = [np.linalg.norm(made.rig.relative(p.a, p.b)[1]) for p in pairs]
    ratio = [np.linalg.norm(p.translation) for p in pairs] / np.array(lengths)
    assert np.ptp(ratio) / ratio.mean() < 0.12
    options = {"rng": np.random.default_rng(0), "progress": silent, "mapper": away}
    some = calibrate_pairs(recording(), lifted(), CONFIG, pairs=[(1, 3), (0, 2)], **options)
    assert some == (pairs[1], pairs[4])


def test_a_pair_is_its_own_inverse():
    """b_from_a of (a, b) and of (b, a): the search is not symmetric, its answer is to 0.15 deg."""
    forth, back = (
        calibrate_pair(gather(recording(), lifted(), views), CONFIG) for views in ((0, 2), (2, 0))
    )
    assert np.degrees(angle_between(forth.rotation, back.rotation.T)) < 0.6
    assert np.degrees(direction_angle(forth.translation, -forth.rotation @ back.translation)) < 0.6


def test_refinement_is_guarded():
    """A round that lowers its own score is not kept: more rounds end with no less.

    But for other draws of rays (4e-8).
    """
    configs = [PairwiseConfig(rounds=rounds) for rounds in (0, 1, 3)]
    pairs = (gather(recording(), lifted(), (1, 3), config) for config in configs)
    scores = [calibrate_pair(*each).score for each in zip(pairs, configs, strict=True)]
    assert np.diff(scores).min() > -1e-5


def test_exact_bodies_give_the_baseline_in_their_unit():
    """Two bodies of one size: lifted distances over those by the true pose; none from behind."""
    sample, bodies = exact_scene()
    pair, who = gather(sample, bodies), scene().identity[:, :2]
    same = (who[0][:, :, None] == who[1][:, None]) & (who[0] >= 0)[:, :, None]
    rotation, translation = scene().rig.relative(*VIEWS)
    ratios = distance_ratios(pair.a, pair.b, rotation, translation, same)
    sizes = scene().poses[:2] - scene().poses[:2].mean(-2, keepdims=True)
    size = np.sqrt((sizes**2).sum(-1).mean(-1))
    assert 1 / size.max() * 0.9 < np.median(ratios) < 1 / size.min() * 1.1
    assert not len(distance_ratios(pair.a, pair.b, rotation, -translation, same))
    frame, i, j = np.nonzero(same)
    rays = pair.a.rays[frame, i].reshape(-1, 3), pair.b.rays[frame, j].reshape(-1, 3)
    other = matrix_from_vector(np.array([0.1, 1.0, 0.0])), np.array([1.0, 0.0, 2.0])
    ahead = np.stack(depths(*other, *rays)) > 0
    found = len(distance_ratios(pair.a, pair.b, *other, same))
    assert found == ahead.all(0).sum() < ahead.any(0).sum()
    length = np.linalg.norm(calibrate_pair(pair, CONFIG).translation)
    assert length == pytest.approx(np.median(ratios) * np.linalg.norm(translation), rel=1e-3)


def five_points_of(sample: Sample, bodies: LiftedPoses, *, tracked: bool = False) -> int:
    """Return how many hypotheses of a pair of views are of five points."""
    pair = replace(gather(sample, bodies), tracked=tracked)
    return int((search_hypotheses(pair, CONFIG).source == "five-point").sum())


@pytest.mark.parametrize("share", [0.4, 0.6])
def test_five_points_are_tried_where_half_of_the_frames_show_a_single_subject(share):
    """Both views detect it twice in a share of the frames. Of tracks any two may be one subject."""
    alone = {"people": 1, "false_detections": 0.0}
    sample, bodies = recording(**alone), lifted(**alone)
    twice = np.arange(60) < share * 60

    def double(values: np.ndarray) -> np.ndarray:
        copied = np.moveaxis(values.astype(float), 1, 0).copy()
        copied[~twice] = 0.0 if values is sample.confidence else np.nan
        return np.concatenate([values, np.moveaxis(copied, 0, 1)], axis=2)

    doubled = {name: double(getattr(sample, name)) for name in ("positions", "rays", "confidence")}
    bodies = LiftedPoses(*map(double, vars(bodies).values()))
    sample = replace(sample, **doubled)
    assert bool(five_points_of(sample, bodies)) == (share < 0.5)
    assert five_points_of(sample, bodies, tracked=True) > CONFIG.five_point_draws


def test_views_that_share_no_frame_make_no_pair():
    seen = recording().confidence > 0
    seen[0, ::2] = seen[1, 1::2] = False
    arrays = (
        np.where(seen[..., None], x, np.nan) for x in (recording().positions, recording().rays)
    )
    hidden = dict(zip(("positions", "rays"), arrays, strict=True)) | {"confidence": 1.0 * seen}
    assert calibrate_pair(gather(replace(recording(), **hidden), lifted()), CONFIG) is None
