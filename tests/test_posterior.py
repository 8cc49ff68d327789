"""Rays and lifted bodies weighed together."""

from dataclasses import replace

import numpy as np
import pytest

from mocap_calib.config import PairwiseConfig
from mocap_calib.geometry.rotation import angle_between, direction_angle, matrix_from_vector
from mocap_calib.two_view.posterior import _bodies, _epipolar, _places, most_probable
from mocap_calib.two_view.view_pair import Detections, Overlap, ViewPair
from mocap_calib.types import Floats

CONFIG = PairwiseConfig()
ROTATION = matrix_from_vector(np.array([0.1, 1.2, -0.05]))
TRANSLATION = np.array([-8.0, 0.5, 4.0])


def exact_pair(bodies: int) -> ViewPair:
    """Bodies of 12 joints in one frame, as far as 10 body sizes, seen and lifted without any error."""
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
    overlap = Overlap(cross, norm, doubt=np.zeros(all_pairs), lifted=np.ones(all_pairs))
    return ViewPair(np.array([0]), a, b, overlap)


def rays_of(pair: ViewPair) -> tuple[Floats, Floats, Floats, Floats]:
    rays_a, rays_b = pair.a.rays.reshape(-1, 3), pair.b.rays.reshape(-1, 3)
    return rays_a, rays_b, np.ones(len(rays_a)), np.full(len(rays_a), 10.0)


@pytest.mark.parametrize("bodies", [1, 3])
def test_the_truth_is_found_from_nearby(bodies):
    pair = exact_pair(bodies)
    matched = np.eye(bodies, dtype=bool)[None]
    start = (
        matrix_from_vector(np.array([0.1, -0.1, 0.15])) @ ROTATION,
        TRANSLATION + np.array([1.0, 0.5, -1.0]),
    )
    rotation, translation = most_probable(pair, *start, matched, rays_of(pair), CONFIG)
    assert np.degrees(angle_between(rotation, ROTATION)) < 0.1
    assert np.degrees(direction_angle(translation, TRANSLATION)) < 0.1
    assert np.linalg.norm(translation) == pytest.approx(np.linalg.norm(TRANSLATION), rel=0.02)


def test_without_lifted_bodies_nothing_changes():
    pair = exact_pair(2)
    pair = replace(pair, overlap=replace(pair.overlap, lifted=np.zeros((1, 2, 2))))
    found = most_probable(
        pair, ROTATION, TRANSLATION, np.eye(2, dtype=bool)[None], rays_of(pair), CONFIG
    )
    assert found[0] is ROTATION
    assert found[1] is TRANSLATION


def test_slopes():
    """Gradients against differences of the energies, away from the truth."""
    pair, use = exact_pair(2), np.eye(2, dtype=bool)[None]
    rotation, translation = (
        matrix_from_vector(np.array([0.02, -0.03, 0.04])) @ ROTATION,
        TRANSLATION + 0.1,
    )

    def moved(delta: Floats) -> tuple[Floats, Floats]:
        return matrix_from_vector(delta[:3]) @ rotation, translation + delta[3:]

    step = 1e-5 * np.eye(6)
    for law in (
        lambda r, _: _bodies(pair, r, use, CONFIG),
        lambda r, t: _places(pair, r, t, use, replace(CONFIG, centre_spread=10.0)),
    ):
        energies = [(law(*moved(d))[0] - law(*moved(-d))[0]) / 2e-5 for d in step]
        np.testing.assert_allclose(
            law(rotation, translation)[2], energies, rtol=5e-2, atol=1e-5
        )  # places: that the uncertainty turns along is left out
    rays_a, rays_b, *rest = rays_of(pair)
    rays = [rays_a.T[None], rays_b.T[None], *rest]
    errors = [(_epipolar(*moved(d), rays)[0] - _epipolar(*moved(-d), rays)[0]) / 2e-5 for d in step]
    slope = _epipolar(rotation, translation, rays)[1]
    assert (
        np.abs(slope - np.stack(errors)).max() < 0.05 * np.abs(slope).max()
    )  # the slope of the slope is left out
