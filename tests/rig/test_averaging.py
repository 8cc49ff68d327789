"""Pairs to one rig."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scenes import rotation_errors_deg, scene

from mocap_calib.config import AveragingConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.results import PairwiseCalibration
from mocap_calib.rig import pairs_among
from mocap_calib.rig.averaging import average
from mocap_calib.rig.view_graph import usable_cameras
from mocap_calib.types import CameraRig


def exact_pairs(rig: CameraRig, *, wrong: tuple[int, ...] = ()) -> tuple[PairwiseCalibration, ...]:
    """Return pairs that agree with a rig, but for some that are 40 degrees off and score less."""
    pairs = []
    for k, (a, b) in enumerate(combinations(range(len(rig.cameras)), 2)):
        rotation, translation = rig.relative(a, b)
        if k in wrong:
            rotation = matrix_from_vector(np.radians([0.0, 40.0, 0.0])) @ rotation
            translation = np.roll(translation, 1)
        pair = PairwiseCalibration(
            a=a,
            b=b,
            rotation=rotation,
            translation=translation,
            matches=np.zeros((0, 3), int),
            frames=10,
            score=0.5 if k in wrong else 0.8,
            residual=0.0,
            in_front=1.0,
            source="lifted",
        )
        pairs.append(pair)
    return tuple(pairs)


def test_consistent_pairs_give_their_rig():
    """Up to the gauge: the first camera is the world, lengths are those of the baselines."""
    rig = scene(cameras=6).rig
    found = average(rig.cameras, exact_pairs(rig), AveragingConfig()).rig
    np.testing.assert_allclose(found.rotation[0], np.eye(3), atol=1e-12)
    for a, b in combinations(range(6), 2):
        for value, expected in zip(found.relative(a, b), rig.relative(a, b), strict=True):
            np.testing.assert_allclose(value, expected, atol=1e-8)


def test_a_pair_that_breaks_the_loops_is_named_and_loses_its_weight():
    rig = scene(cameras=5).rig
    found = average(rig.cameras, exact_pairs(rig, wrong=(4,)), AveragingConfig())
    assert rotation_errors_deg(found.rig, rig).max() < 0.1
    assert found.weight[4] < 0.05
    assert np.delete(found.weight, 4).min() > 0.9
    assert np.degrees(found.loop_error[4]) == pytest.approx(40, abs=0.5)


def test_unconnected_cameras_are_not_glued():
    rig = scene(cameras=4).rig
    pairs = [p for p in exact_pairs(rig) if (p.a < 2) == (p.b < 2)]
    with pytest.raises(DegenerateError, match=r"cam1, cam2 \| cam3, cam4"):
        usable_cameras(rig.cameras, tuple(pairs), AveragingConfig())


def test_a_camera_that_no_pair_holds_is_left_out():
    rig = scene(cameras=4).rig
    pairs = tuple(replace(p, score=0.02) if 1 in (p.a, p.b) else p for p in exact_pairs(rig))
    kept = usable_cameras(rig.cameras, pairs, AveragingConfig())
    assert kept.tolist() == [0, 2, 3]
    assert [(p.a, p.b) for p in pairs_among(pairs, kept)] == [(0, 1), (0, 2), (1, 2)]


def test_a_wrong_baseline_of_a_right_rotation_moves_no_camera():
    """It points elsewhere and is three times as long: measured 1e-3 of the rig's size."""
    rig = scene(cameras=5).rig
    pairs = list(exact_pairs(rig))
    pairs[4] = replace(pairs[4], translation=3 * np.roll(pairs[4].translation, 1))
    found = average(rig.cameras, tuple(pairs), AveragingConfig())
    assert found.weight[4] < 0.05
    for a, b in combinations(range(5), 2):
        expected = rig.relative(a, b)[1]
        gap = np.linalg.norm(found.rig.relative(a, b)[1] - expected)
        assert gap < 0.01 * np.linalg.norm(expected)


def test_what_a_loop_does_not_close_is_shared_by_the_squares_of_its_baselines():
    """Of 1, 4 and 4 body sizes: errors of baselines are a share of their lengths.

    The loop is 0.001 open, of which the short one takes 1 / 33; without lengths it would take a
    third. Measured 0.16 % from that, as the short one is 0.08 % too long.
    """
    made = scene(cameras=3).rig
    middle = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, np.sqrt(16 - 0.25), 0.0]])
    rig = replace(made, translation=-np.einsum("vij,vj->vi", made.rotation, middle))
    pairs = list(exact_pairs(rig))
    pairs[0] = replace(pairs[0], translation=pairs[0].translation + [0.0006, 0.0, 0.0008])
    found = average(rig.cameras, tuple(pairs), AveragingConfig()).rig
    gaps = [np.linalg.norm(found.relative(p.a, p.b)[1] - p.translation) for p in pairs]
    assert gaps == pytest.approx(np.array([1, 16, 16]) / 33 * 0.001, rel=0.0024)


def test_a_pair_counts_by_the_square_of_its_score():
    """Half a degree that a loop does not close, shared as least squares do: by inverse weights."""
    rig = scene(cameras=3).rig
    first, second, third = exact_pairs(rig)
    turn = matrix_from_vector(np.radians([0.0, 0.0, 0.5]))
    pairs = (replace(first, score=0.4), second, replace(third, rotation=turn @ third.rotation))
    error = average(rig.cameras, pairs, AveragingConfig()).loop_error
    assert np.degrees(error.sum()) == pytest.approx(0.5, rel=1e-3)
    assert error[0] / error[1:] == pytest.approx([4.0, 4.0], rel=0.02)
