"""Rotations and offsets of views whose clocks differ, held to their definitions."""

import numpy as np
import pytest
from oracles import clocks as oracle

from mocap_calib.clocks.compare import (
    BLOCK_FRAMES,
    POSE_TOLERANCE,
    ViewInTime,
    _align,
    _best_in_blocks,
    _candidates,
    _score_at_any_time,
    agreement,
)
from mocap_calib.config import CLOCK_RATES
from mocap_calib.geometry.rotation import angle_between, matrix_from_vector
from mocap_calib.kernels import clocks as kernels

WINDOW = 60
FRAMES = 4 * BLOCK_FRAMES


def unit_bodies(rng: np.random.Generator, frames: int) -> np.ndarray:
    """Bodies `[1, frame, 1, axis, 3]` of length 1."""
    body = rng.normal(size=(1, frames, 1, 3, 3))
    return body / np.linalg.norm(body, axis=(-2, -1), keepdims=True)


def view_of(body: np.ndarray) -> ViewInTime:
    return ViewInTime(body.astype(np.float32), np.ones(body.shape[:3], bool))


def test_bodies_are_aligned_at_their_offset_and_unlike_ones_do_not_count():
    """Two frames late, a third of the bodies others: exact, from 10 degrees off."""
    rng = np.random.default_rng(0)
    truth = matrix_from_vector(np.array([0.4, -0.3, 0.8]))
    body = unit_bodies(rng, FRAMES)
    seen_by_b = np.roll(body @ truth.T, 2, axis=1)
    others = rng.random(FRAMES) < 1 / 3
    seen_by_b[:, others] = unit_bodies(rng, int(others.sum()))
    start = matrix_from_vector(np.radians([6.0, -6.0, 5.0])) @ truth
    rows = np.arange(FRAMES)
    found = _align(view_of(body), view_of(seen_by_b), start, rate=1.0, rows=rows, window=WINDOW)
    assert np.degrees(angle_between(found, truth)) < 0.5


def test_bodies_before_the_first_frame_of_the_other_view_are_not_compared():
    """Two frames early: the last of b are like the first of a, but turned, and not their match."""
    rng = np.random.default_rng(2)
    truth = matrix_from_vector(np.array([0.4, -0.3, 0.8]))
    body = unit_bodies(rng, FRAMES)
    seen_by_b = np.roll(body @ truth.T, -2, axis=1)
    seen_by_b[:, -2:] @= matrix_from_vector(np.array([0.2, 0.0, 0.0]))
    views, rows = (view_of(body), view_of(seen_by_b)), np.arange(FRAMES)
    found = _align(*views, truth, rate=1.0, rows=rows, window=WINDOW)
    assert np.degrees(angle_between(found, truth)) < 0.001


def test_blocks_of_time_that_show_nothing_count_where_they_are_the_most():
    """Half of the blocks are enough; of less the score is less."""
    blocks = FRAMES // BLOCK_FRAMES
    for used, expected in ((blocks, 0.8), (blocks // 2, 0.8), (blocks // 4, 0.4)):
        values = np.full((1, 1, FRAMES, FRAMES), np.nan, np.float32)
        values[:, :, : used * BLOCK_FRAMES] = 0.8
        score, offsets = _best_in_blocks(values, 1.0, np.arange(FRAMES), WINDOW)
        np.testing.assert_allclose(score, expected, rtol=1e-6)
        assert (offsets >= 0).sum() == used


@pytest.mark.parametrize("rate", CLOCK_RATES)
def test_compiled_sums_on_diagonals_are_those_of_their_definition(rate):
    """To the last bit; a third is not seen, and rows that no block needs are left over."""
    rng = np.random.default_rng(5)
    values = rng.random((2, 3, 10, 40)).astype(np.float32)
    values[rng.random(values.shape) < 1 / 3] = np.nan
    rows = np.sort(rng.permutation(40)[:10])
    shape = (2, 3, 3, 15)
    sums = np.zeros(shape, np.float32), np.zeros(shape, np.int64)
    kernels.sum_on_diagonals(values, np.round(rows * rate).astype(np.int64) - 7, 3, *sums)
    defined = oracle.sum_on_diagonals(values, rate, rows, 3, 7)
    for found, expected in zip(sums, defined, strict=True):
        assert found.shape == (2, 3, 3, 15)
        np.testing.assert_array_equal(found, expected)
    assert 0 < defined[1].min(initial=9, where=defined[1] > 0) < defined[1].max() == 3


@pytest.mark.parametrize(("in_a", "in_b"), [(1, 1), (2, 2), (2, 1), (1, 3)])
def test_bodies_agree_with_the_most_alike_of_the_other_view(in_a, in_b):
    """By its definition, body by body; bodies that are not there are 0, and 0.0003 like any."""
    rng = np.random.default_rng(in_a + in_b)
    turn = matrix_from_vector(np.array([0.4, -0.3, 0.8]))
    base = unit_bodies(rng, 1)[0, 0, 0]
    a, b = (base + 0.15 * rng.normal(size=(1, 6, n, 3, 3)) / 3 for n in (in_a, in_b))
    a, b = (body / np.linalg.norm(body, axis=(-2, -1), keepdims=True) for body in (a, b))
    seen_a, seen_b = (rng.random(body.shape[:3]) < 0.7 for body in (a, b))
    a, b = (x * seen[..., None, None] for x, seen in ((a, seen_a), (b, seen_b)))
    alike = np.exp((np.einsum("fiax,gjax->figj", a[0], b[0]) - 1) / POSE_TOLERANCE**2)
    total = alike.max(3).sum(1) + alike.max(1).sum(2)
    count_a, count_b = seen_a[0].sum(1)[:, None], seen_b[0].sum(1)
    expected = np.where((count_a > 0) & (count_b > 0), total / (count_a + count_b + 1e-9), np.nan)
    view_a = ViewInTime(a.astype(np.float32), seen_a)
    view_b = ViewInTime((b @ turn.T).astype(np.float32), seen_b)
    found = agreement(view_a, view_b, turn)[0]
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=1e-6)


def test_candidates_turn_bodies_to_those_of_the_same_shape():
    rng = np.random.default_rng(1)
    truth = matrix_from_vector(np.array([0.4, -0.3, 0.8]))
    body = unit_bodies(rng, 20)
    found = _candidates(view_of(body), view_of(body @ truth.T), rng)
    nearest = found.reshape(20, -1, 3, 3)[:, 0]
    assert np.degrees(angle_between(nearest, truth)).max() < 0.1


def test_a_rotation_is_scored_at_each_rate():
    """Bodies in step: only the truth, and only at one frame for one."""
    rng = np.random.default_rng(3)
    view, rows = view_of(unit_bodies(rng, FRAMES)), np.arange(FRAMES)
    turned = np.stack([np.eye(3), matrix_from_vector(np.array([0.0, 2.0, 0.0]))])
    score = _score_at_any_time(view, view, turned, rows, WINDOW)
    assert score.shape == (2, len(CLOCK_RATES))
    assert score[0, CLOCK_RATES.index(1.0)] == pytest.approx(1.0, abs=1e-3)
    assert score[1].max() < 0.5


def test_rays_that_meet_are_likely_and_unseen_points_are_left_out():
    rng = np.random.default_rng(0)
    normal, ray = rng.normal(size=(2, 1, 6, 4, 3))
    square_a, square_b = rng.random((2, 1, 6, 4))
    square_a[0, 2], square_b[0, 4, :3] = np.nan, np.nan
    table = np.empty((1, 6, 5))
    kernels.mean_epipolar_likelihood(normal, ray, square_a, square_b, 0.3, table)
    for frame in range(6):
        for offset in range(-2, 3):
            expected = np.nan
            if 0 <= frame + offset < 6 and frame != 2:
                gap = (normal[0, frame] * ray[0, frame + offset]).sum(-1)
                square = square_a[0, frame] + square_b[0, frame + offset]
                expected = np.nanmean(-np.log1p(gap**2 / square / 0.3**2))
            assert table[0, frame, offset + 2] == pytest.approx(expected, nan_ok=True)
