"""What no stage may depend on: the order of things, the gauge, the unit. Drawn by hypothesis."""

from dataclasses import replace
from itertools import combinations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import (
    MIRROR,
    mirrored_rig,
    moved,
    permuted,
    recording,
    rigs_differ,
    scene,
    truth,
)

from mocap_calib.adjust.covariance import jackknife
from mocap_calib.adjust.refine import measure_fit
from mocap_calib.config import AveragingConfig, Config, TriangulateConfig
from mocap_calib.geometry.rotation import angle_between, matrix_from_vector
from mocap_calib.identities.pieces import _medians
from mocap_calib.results import Matches, PairwiseCalibration, Poses3D
from mocap_calib.rig.averaging import average
from mocap_calib.rig.triangulate import frame_blocks, triangulate
from mocap_calib.types import CameraRig
from mocap_calib.verdict.evaluation import evaluate

law = settings(max_examples=4, deadline=None, derandomize=True)
SEEDS = st.integers(0, 2**32 - 1)
SMALL = {"frames": 12}
FULL = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])  # of xx, xy, xz, yy, yz, zz


def triangulated(order: dict | None = None, rig: CameraRig | None = None) -> Poses3D:
    """The poses of a scene whose views, frames and instances are taken in another order."""
    found, rig, labels = recording(**SMALL), rig or scene(**SMALL).rig, truth(**SMALL).labels
    views, frames, instances = (
        np.asarray((order or {}).get(k, range(n))) for k, n in enumerate(labels.shape)
    )
    found = permuted(found, views=views, frames=frames, instances=instances)
    matches = Matches(labels[np.ix_(views, frames, instances)])
    return triangulate(found, rig.select(views), matches, TriangulateConfig())


@law
@given(SEEDS)
def test_points_do_not_depend_on_the_order_of_views_frames_and_instances(seed):
    """Time may run backwards, too. Measured 2e-9 m."""
    rng = np.random.default_rng(seed)
    first, count = triangulated(), recording(**SMALL).positions.shape[:3]
    order = {0: rng.permutation(count[0]), 1: np.arange(count[1])[::-1]}
    second = triangulated(order | {2: rng.permutation(count[2])})
    np.testing.assert_allclose(second.positions[::-1], first.positions, rtol=0, atol=1e-8)
    np.testing.assert_array_equal(second.views[::-1], first.views)
    np.testing.assert_allclose(second.error[::-1], first.error, rtol=1e-6)


@law
@given(SEEDS)
def test_points_and_their_covariance_go_with_the_world_and_its_unit(seed):
    rng = np.random.default_rng(seed)
    rig, turn, factor = moved(scene(**SMALL).rig, rng)
    first, second = triangulated(), triangulated(rig=rig)
    centre = [points.positions.reshape(-1, 3) for points in (first, second)]
    known = np.isfinite(centre[0][:, 0])
    np.testing.assert_array_equal(np.isfinite(centre[1][:, 0]), known)
    middle = [points[known] - points[known].mean(0) for points in centre]
    np.testing.assert_allclose(middle[1] / factor, middle[0] @ turn.T, rtol=0, atol=1e-7)
    np.testing.assert_allclose(second.error, first.error, rtol=1e-5)
    square = [points.covariance.reshape(-1, 6)[known][:, FULL] for points in (first, second)]
    size = np.trace(square[0], axis1=1, axis2=2)[:, None, None]
    gap = square[1] / factor**2 - turn @ square[0] @ turn.T
    assert (np.abs(gap) / size).max() < 1e-4


@law
@given(SEEDS)
def test_names_of_individuals_are_only_names(seed):
    labels = truth(**SMALL).labels
    order = np.random.default_rng(seed).permutation(labels.max() + 1)
    renamed = Matches(np.append(order, -1)[labels])
    found, rig = recording(**SMALL), scene(**SMALL).rig
    first = triangulated()
    second = triangulate(found, rig, renamed, TriangulateConfig())
    np.testing.assert_array_equal(second.positions[:, order], first.positions)


def pairs_with_noise(rig: CameraRig, rng: np.random.Generator) -> list[PairwiseCalibration]:
    """The pairs of a rig, each a degree and a hundredth of its baseline off."""
    pairs = []
    for a, b in combinations(range(len(rig)), 2):
        rotation, translation = rig.relative(a, b)
        pairs.append(
            PairwiseCalibration(
                a=a,
                b=b,
                rotation=matrix_from_vector(rng.normal(0, 0.01, 3)) @ rotation,
                translation=translation * (1 + rng.normal(0, 0.01, 3)),
                matches=np.zeros((0, 3), int),
                frames=10,
                score=rng.uniform(0.5, 0.9),
                residual=0.0,
                in_front=1.0,
                source="lifted",
            )
        )
    return pairs


@law
@given(SEEDS)
def test_averaging_depends_neither_on_the_order_nor_on_the_unit(seed):
    rng = np.random.default_rng(seed)
    rig = scene(cameras=5, frames=2).rig
    pairs = pairs_with_noise(rig, rng)
    first = average(rig.cameras, tuple(pairs), AveragingConfig())
    order, factor = rng.permutation(len(pairs)), rng.uniform(0.1, 10)
    other = tuple(replace(pairs[k], translation=factor * pairs[k].translation) for k in order)
    second = average(rig.cameras, other, AveragingConfig())
    assert angle_between(second.rig.rotation, first.rig.rotation).max() < 1e-6
    lengths = [np.linalg.norm(each.rig.centres, axis=1) for each in (first, second)]
    np.testing.assert_allclose(lengths[1], factor * lengths[0], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(second.weight, first.weight[order], rtol=1e-5)


@law
@given(SEEDS)
def test_averaging_knows_no_order_of_cameras_and_no_mirror(seed):
    """Measured 9e-11, of 60 examples; in the mirror 3e-15, which is rounding."""
    rng = np.random.default_rng(seed)
    rig = scene(cameras=5, frames=2).rig
    pairs = pairs_with_noise(rig, rng)
    first = average(rig.cameras, tuple(pairs), AveragingConfig())
    order = rng.permutation(5)
    place = np.argsort(order)
    renumbered = tuple(replace(p, a=int(place[p.a]), b=int(place[p.b])) for p in pairs)
    second = average(rig.select(order).cameras, renumbered, AveragingConfig())
    assert rigs_differ(first.rig.select(order), second.rig) < 1.4e-10
    np.testing.assert_allclose(second.weight, first.weight, rtol=8e-9)
    image = tuple(_in_a_mirror(pair) for pair in pairs)
    third = average(mirrored_rig(rig).cameras, image, AveragingConfig())
    assert rigs_differ(first.rig, mirrored_rig(third.rig)) < 3e-14


@law
@given(SEEDS)
def test_which_camera_of_a_pair_is_the_first_moves_centres_but_turns_none(seed):
    """No exact law: a baseline is laid out by the averaged rotation of the second camera.

    Measured 0.015 of the largest distance at worst, 0.004 at the median of 60 examples, whose
    pairs are 0.01 rad and 1 % off, and whose rigs 0.016 from the truth. Rotations: 3e-15 rad.
    """
    rng = np.random.default_rng(seed)
    rig = scene(cameras=5, frames=2).rig
    pairs = pairs_with_noise(rig, rng)
    first = average(rig.cameras, tuple(pairs), AveragingConfig()).rig
    second = average(rig.cameras, tuple(map(_reversed, pairs)), AveragingConfig()).rig
    assert rigs_differ(first, second) < 0.022
    turned = [
        angle_between(first.relative(*p)[0], second.relative(*p)[0])
        for p in combinations(range(5), 2)
    ]
    assert max(turned) < 3e-14


def _reversed(pair: PairwiseCalibration) -> PairwiseCalibration:
    back = pair.rotation.T
    return replace(pair, a=pair.b, b=pair.a, rotation=back, translation=-back @ pair.translation)


def _in_a_mirror(pair: PairwiseCalibration) -> PairwiseCalibration:
    rotation = MIRROR[:, None] * pair.rotation * MIRROR
    return replace(pair, rotation=rotation, translation=MIRROR * pair.translation)


@law
@given(SEEDS)
def test_an_evaluation_is_blind_to_gauge_unit_and_order(seed):
    rng = np.random.default_rng(seed)
    reference = scene(cameras=5, frames=2).rig
    turns = matrix_from_vector(rng.normal(0, 0.02, (5, 3)))
    rig = replace(reference, rotation=turns @ reference.rotation)
    first = evaluate(rig, reference)
    other, _, _ = moved(rig.select(rng.permutation(5)), rng)
    second = evaluate(other, moved(reference, rng)[0])
    for name in ("rotation_error", "translation_error"):
        found, expected = (np.sort(getattr(each, name)) for each in (second, first))
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)


@law
@given(st.integers(1, 3000), st.integers(0, 100_000))
def test_blocks_of_frames_are_all_frames_once_and_as_many_as_there_is_room_for(frames, points):
    blocks = frame_blocks(frames, points)
    np.testing.assert_array_equal(np.concatenate(blocks), np.arange(frames))
    assert all(len(block) * points <= 8192 or len(block) == 1 for block in blocks)
    assert all(len(block) == len(blocks[0]) for block in blocks[:-1])
    assert len(blocks) == 1 or (len(blocks[0]) + 1) * points > 8192


@law
@given(SEEDS, st.integers(1, 9))
def test_medians_of_columns_leave_out_what_is_not_known(seed, rows):
    """Of two in the middle the lower one; NaN of nothing."""
    rng = np.random.default_rng(seed)
    values = np.where(rng.random((rows, 40)) < 0.7, rng.normal(size=(rows, 40)), np.nan)
    known = [np.sort(column[np.isfinite(column)]) for column in values.T]
    expected = [each[(len(each) - 1) // 2] if len(each) else np.nan for each in known]
    np.testing.assert_array_equal(_medians(values), expected)


def test_the_jackknife_of_a_mean_is_the_variance_of_a_mean():
    values = np.random.default_rng(0).normal(size=(12, 3))
    without = np.stack([np.delete(values, left_out, axis=0).mean(0) for left_out in range(12)])
    found = jackknife(without)
    np.testing.assert_allclose(found, (values.var(0, ddof=1) / 12).sum())


def test_errors_of_detections_are_spread_as_those_of_the_noise():
    """The median is 1.55 times the quarter of errors in two directions; measured 1.5 to 1.7."""
    fit = measure_fit(recording(**SMALL), scene(**SMALL).rig, truth(**SMALL), Config())
    ratio = fit.angle / fit.good_angle
    assert ((ratio > 1.3) & (ratio < 1.9)).all(), ratio
