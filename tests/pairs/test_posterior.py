"""Rays and lifted bodies weighed together."""

from dataclasses import replace

import numpy as np
import pytest

from mocap_calib.config import PairwiseConfig
from mocap_calib.geometry.rotation import angle_between, direction_angle, matrix_from_vector
from mocap_calib.pairs import posterior, refine
from mocap_calib.pairs.hypotheses import Hypotheses
from mocap_calib.pairs.posterior import (
    body_energy,
    centre_energy,
    lift_spread,
    most_probable,
    ray_energy,
    ray_errors,
)
from mocap_calib.pairs.scoring import score_hypotheses
from mocap_calib.pairs.view_pair import Detections, MatchedRays, Overlap, ViewPair

CONFIG = PairwiseConfig()
ROTATION = matrix_from_vector(np.array([0.1, 1.2, -0.05]))
TRANSLATION = np.array([-8.0, 0.5, 4.0])


def exact_pair(bodies: int) -> ViewPair:
    """Return bodies of 12 joints in one frame, 10 body sizes away, seen and lifted exactly."""
    rng = np.random.default_rng(0)
    points = rng.normal(0, 0.6, (1, bodies, 12, 3)) + rng.normal(
        [0, 0, 10], [2, 0.2, 2], (1, bodies, 1, 3)
    )
    moved = points @ ROTATION.T + TRANSLATION
    centres = [x.mean(2) for x in (points, moved)]
    inside = [x - c[:, :, None] for x, c in zip((points, moved), centres, strict=True)]
    cross = np.einsum("fikx,fjky->fijxy", inside[0], inside[1]) / 12
    square = [(x**2).sum((-1, -2)) / 12 for x in inside]
    rays = [x / np.linalg.norm(x, axis=-1, keepdims=True) for x in (points, moved)]
    norm = square[0][:, :, None] + square[1][:, None]
    a, b = (
        Detections(rays[k], np.ones((1, bodies, 12)), c, np.linalg.norm(c, axis=-1))
        for k, c in enumerate(centres)
    )
    all_pairs = (1, bodies, bodies)
    overlap = Overlap(cross[None], norm, doubt=np.zeros(all_pairs), lifted=np.ones(all_pairs))
    return ViewPair(np.array([0]), a, b, overlap, reversal=np.inf)


def rays_of(pair: ViewPair) -> MatchedRays:
    """Return the joints of all bodies, each matched with itself."""
    rays_a, rays_b = pair.a.rays.reshape(-1, 3), pair.b.rays.reshape(-1, 3)
    return MatchedRays(rays_a, rays_b, np.ones(len(rays_a)), np.full(len(rays_a), 10.0))


@pytest.mark.parametrize("bodies", [1, 3])
def test_the_truth_is_found_from_nearby(bodies):
    pair = exact_pair(bodies)
    rotation, translation = most_probable(
        pair,
        np.eye(bodies, dtype=bool)[None],
        rays_of(pair),
        CONFIG,
        rotation=matrix_from_vector(np.array([0.1, -0.1, 0.15])) @ ROTATION,
        translation=TRANSLATION + np.array([1.0, 0.5, -1.0]),
    )
    assert np.degrees(angle_between(rotation, ROTATION)) < 0.1
    assert np.degrees(direction_angle(translation, TRANSLATION)) < 0.1
    assert np.linalg.norm(translation) == pytest.approx(np.linalg.norm(TRANSLATION), rel=0.02)


def test_without_lifted_bodies_nothing_changes():
    pair = exact_pair(2)
    pair = replace(pair, overlap=replace(pair.overlap, lifted=np.zeros((1, 2, 2))))
    rotation, translation = most_probable(
        pair,
        np.eye(2, dtype=bool)[None],
        rays_of(pair),
        CONFIG,
        rotation=ROTATION,
        translation=TRANSLATION,
    )
    assert rotation is ROTATION
    assert translation is TRANSLATION


START = matrix_from_vector(np.array([0.02, -0.03, 0.04])) @ ROTATION, TRANSLATION + 0.1


def difference(function, k: int):
    """Return the slope of a function of R and t in their k-th of six parameters, by differences."""
    delta = 1e-5 * np.eye(6)[k]
    rotation, translation = START
    forth = function(matrix_from_vector(delta[:3]) @ rotation, translation + delta[3:])
    back = function(matrix_from_vector(-delta[:3]) @ rotation, translation - delta[3:])
    return (forth - back) / 2e-5


def test_slope_of_the_energy_of_bodies():
    pair, lifted = exact_pair(2), np.eye(2, dtype=bool)[None]
    slope = body_energy(pair, lifted, START[0], CONFIG).gradient
    expected = [
        difference(lambda r, _: body_energy(pair, lifted, r, CONFIG).value, k) for k in range(6)
    ]
    np.testing.assert_allclose(slope, expected, rtol=1e-5, atol=1e-6)


def test_slope_of_the_energy_of_centres():
    pair, lifted = exact_pair(2), np.eye(2, dtype=bool)[None]

    def energy(rotation, translation):
        return centre_energy(pair, lifted, CONFIG, rotation=rotation, translation=translation)

    slope = energy(*START).gradient
    expected = [difference(lambda r, t: energy(r, t).value, k) for k in range(6)]
    np.testing.assert_allclose(slope, expected, rtol=1e-5, atol=1e-6)


def test_slopes_of_the_errors_of_rays():
    rays = rays_of(exact_pair(2))
    slope = ray_errors(rays, *START)[1]
    expected = np.stack([difference(lambda r, t: ray_errors(rays, r, t)[0], k) for k in range(6)])
    np.testing.assert_allclose(slope, expected, atol=1e-7 * np.abs(slope).max())


def rough_rays(count: int) -> MatchedRays:
    """Return so many rays of points 5 to 15 body sizes away, with 3 mrad of noise and outliers."""
    rng = np.random.default_rng(1)
    points = rng.uniform([-4, -1, 5], [4, 1, 15], (count, 3))
    rays = [x + rng.normal(0, 0.03, x.shape) for x in (points, points @ ROTATION.T + TRANSLATION)]
    rays[1][::7] = rng.permutation(rays[1][::7])
    a, b = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in rays)
    return MatchedRays(a, b, rng.random(count), rng.uniform(5, 15, count))


def test_slope_of_the_energy_of_rays():
    """With outliers, which the loss weighs less."""
    rays = rough_rays(100)

    def energy(rotation, translation):
        return ray_energy(rays, rotation, translation, noise=0.05, config=CONFIG)

    slope = energy(*START).gradient
    expected = [difference(lambda r, t: energy(r, t).value, k) for k in range(6)]
    np.testing.assert_allclose(slope, expected, atol=1e-6 * np.abs(slope).max())


@pytest.mark.parametrize("count", [10, 64, 333])
def test_kernels_refine_as_numpy_does(count, monkeypatch):
    """With a block of rays that is full, and one that is not: measured 3e-15."""
    rays = rough_rays(count)
    batch = rays[np.arange(count)[None]]
    quick = refine.refine_two_view(START[0][None], START[1][None], batch, CONFIG)
    monkeypatch.setattr(refine, "compiled", lambda _: None)
    slow = refine.refine_two_view(START[0][None], START[1][None], batch, CONFIG)
    for found, expected in zip(quick, slow, strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)


def test_kernels_find_the_most_probable_pose_that_numpy_finds(monkeypatch):
    """From 12 degrees off: measured 2e-15."""
    pair, rays = exact_pair(3), rough_rays(100)
    start = {
        "rotation": matrix_from_vector(np.array([0.1, -0.1, 0.15])) @ ROTATION,
        "translation": TRANSLATION + np.array([1.0, 0.5, -1.0]),
    }
    matched = np.eye(3, dtype=bool)[None]
    quick = most_probable(pair, matched, rays, CONFIG, **start)
    monkeypatch.setattr(posterior, "compiled", lambda _: None)
    slow = most_probable(pair, matched, rays, CONFIG, **start)
    for found, expected in zip(quick, slow, strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


def test_kernels_take_the_steps_that_numpy_takes_from_far_off(monkeypatch):
    """About 50 degrees: which steps are taken depends on the energy itself. Measured 5e-15."""
    pair, rays, rng = exact_pair(3), rough_rays(100), np.random.default_rng(0)
    starts = [
        (matrix_from_vector(rng.normal(0, 0.5, 3)) @ ROTATION, TRANSLATION + rng.normal(0, 3, 3))
        for _ in range(20)
    ]

    def refined() -> list[np.ndarray]:
        matched = np.eye(3, dtype=bool)[None]
        return [
            np.column_stack(most_probable(pair, matched, rays, CONFIG, rotation=r, translation=t))
            for r, t in starts
        ]

    quick = refined()
    monkeypatch.setattr(posterior, "compiled", lambda _: None)
    np.testing.assert_allclose(quick, refined(), rtol=0, atol=1e-9)


def test_a_pose_is_scored_by_the_matches_in_front_of_both_views():
    """The truth, and the same with the other camera behind: there nothing counts."""
    pair = exact_pair(3)
    both = Hypotheses(np.stack([ROTATION] * 2), np.stack([TRANSLATION, -TRANSLATION]), ("", ""))
    scored = score_hypotheses(pair, both, CONFIG)
    assert np.array_equal(scored.matched[0, 0], np.eye(3, dtype=bool))
    np.testing.assert_allclose(scored.score, [1, 0], atol=0.05)
    assert scored.in_front.tolist() == [1.0, 0.0]


def test_the_residual_of_a_pose_is_that_of_the_joint_in_the_middle():
    """Exact but for one joint of 36, which is seen 0.1 rad off."""
    pair = exact_pair(3)
    off = pair.b.rays.copy()
    off[0, 0, 0] = matrix_from_vector(np.array([0.1, 0.0, 0.0])) @ off[0, 0, 0]
    truth = Hypotheses(ROTATION[None], TRANSLATION[None], ("",))
    scored = score_hypotheses(replace(pair, b=replace(pair.b, rays=off)), truth, CONFIG)
    assert scored.matched[0, 0, 0, 0]
    assert scored.residual[0] < 1e-6


def test_the_energy_of_bodies_is_that_of_their_distance():
    """None where exact bodies lie on each other, and more the farther they are turned away."""
    pair, lifted = exact_pair(2), np.eye(2, dtype=bool)[None]
    turned = [
        body_energy(pair, lifted, matrix_from_vector(angle * np.eye(3)[0]) @ ROTATION, CONFIG).value
        for angle in (0.0, 0.1, 0.2)
    ]
    assert turned[0] == pytest.approx(0.0, abs=1e-12)
    assert 0 < turned[1] < turned[2]


def test_small_errors_of_rays_count_by_their_square_in_units_of_the_noise():
    """Far below the width of the loss: E = 1/2 sum w (error / noise)^2, to 1 %."""
    rays = rays_of(exact_pair(3))
    near = matrix_from_vector(np.array([0.0, 0.0, 2e-4])) @ ROTATION
    error, _ = ray_errors(rays, near, TRANSLATION)
    noise = 0.4 * CONFIG.lift_spread
    found = ray_energy(rays, near, TRANSLATION, noise=noise, config=CONFIG)
    assert found.value == pytest.approx(0.5 * (rays.weight * (error / noise) ** 2).sum(), rel=0.01)


def test_bodies_of_which_the_network_is_less_sure_turn_the_answer_less():
    """Measured 2.2 times as far; of a surer network nothing changes."""
    pair, lifted = exact_pair(2), np.eye(2, dtype=bool)[None]
    unsure = replace(pair, overlap=replace(pair.overlap, doubt=np.full((1, 2, 2), 0.5**2)))
    assert lift_spread(pair, lifted, CONFIG) == CONFIG.lift_spread
    assert lift_spread(unsure, lifted, CONFIG) == pytest.approx(0.5 * CONFIG.lift_turned)
    rays = rays_of(pair)
    against = replace(rays, a=rays.a @ matrix_from_vector(np.array([0.1, -0.2, 0.1])))
    start = {"rotation": START[0], "translation": START[1]}
    sure, less = (
        angle_between(most_probable(p, lifted, against, CONFIG, **start)[0], ROTATION)
        for p in (pair, unsure)
    )
    assert less > 1.5 * sure
