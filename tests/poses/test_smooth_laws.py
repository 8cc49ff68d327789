"""Best estimates of poses of one scene that is told in another order, time, mirror or world.

Points are compared in metres. How strongly to smooth is chosen by detections that are hidden by
lot, which is another choice for another order: what is exact is so at the same strengths. Measured
of 25 examples each; the poses are 4.3 mm from the truth.
"""

from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import MIRROR, recording, scene, told, truth

from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.poses import stage
from mocap_calib.results import Matches, Poses3D, Smoothing
from mocap_calib.rig.triangulate import triangulate
from mocap_calib.types import CameraRig, Recording

law = settings(max_examples=4, deadline=None, derandomize=True)
SEEDS = st.integers(0, 2**32 - 1)
SMALL = {"frames": 24}
HOW = ("views", "instances", "names", "time", "mirror")
HELD = dict.fromkeys(HOW, 3e-14) | {"views": 1e-12}  # rounding
CHOSEN = {"views": 0.0135, "instances": 1e-14, "names": 0.0128, "time": 0.0122, "mirror": 1e-14}


def smooth(found: Recording, rig: CameraRig, matches: Matches) -> tuple[Poses3D, Smoothing]:
    return stage.smooth_poses(found, rig, matches, triangulate(found, rig, matches))


@lru_cache
def first_told() -> tuple[Poses3D, Smoothing, tuple]:
    """The poses, how they were smoothed, and what was chosen."""
    chosen, choose = [], stage._choose

    def remember(known: stage._Scene) -> tuple:
        chosen.append(choose(known))
        return chosen[0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stage, "_choose", remember)
        found = smooth(recording(**SMALL), scene(**SMALL).rig, truth(**SMALL))
    return *found, chosen[0]


def differ(found: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Return how far points are from those expected; as many must be missing."""
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    distance = np.linalg.norm(found - expected, axis=-1)
    return distance[np.isfinite(distance)]


def as_first_told(how: str, rng: np.random.Generator, points: np.ndarray) -> np.ndarray:
    """Return points `[frame, individual, keypoint, 3]` of a scene told so, as they are of it."""
    if how == "names":
        return points[:, rng.permutation(points.shape[1])]
    if how == "time":
        return points[::-1]
    return points * MIRROR if how == "mirror" else points


@pytest.mark.parametrize("how", HOW)
@law
@given(seed=SEEDS)
def test_at_the_same_strengths_poses_know_no_order_time_or_mirror(how, seed):
    """Measured 9e-16, and 3.2e-13 of another order of cameras."""
    poses, smoothing, chosen = first_told()
    rng = np.random.default_rng(seed)
    found, place, matches, _ = told(how, rng, **SMALL)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stage, "_choose", lambda _: chosen)
        again, counted = smooth(found, place(scene(**SMALL).rig), matches)
    points = as_first_told(how, np.random.default_rng(seed), again.positions)
    assert differ(points, poses.positions).max() < HELD[how]
    assert counted.outliers == smoothing.outliers


@pytest.mark.parametrize("how", HOW)
@law
@given(seed=SEEDS)
def test_another_choice_of_strengths_moves_poses_little(how, seed):
    """No exact law but of the order of detections, and of the mirror.

    Measured 11.1 mm at worst for another order of cameras, 10.6 of names, 10.1 of time; median of
    a scene 1.3 mm at most. Accelerations are chosen up to twice as large or as small.
    """
    poses, smoothing, _ = first_told()
    rng = np.random.default_rng(seed)
    found, place, matches, _ = told(how, rng, **SMALL)
    again, chosen = smooth(found, place(scene(**SMALL).rig), matches)
    points = as_first_told(how, np.random.default_rng(seed), again.positions)
    moved = differ(points, poses.positions)
    assert moved.max() < CHOSEN[how]
    assert np.median(moved) < 0.0015
    assert abs(np.log2(chosen.acceleration / smoothing.acceleration)) < 1.01


def in_other_axes(turn: np.ndarray, factor: float, shift: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the points of the scene in other axes, as they are of it, and its acceleration."""
    rig = scene(**SMALL).rig
    rotation = rig.rotation @ turn.T
    translation = factor * rig.translation - rotation @ shift
    there = CameraRig(rig.cameras, rotation, translation, rig.unit)
    poses, smoothing = smooth(recording(**SMALL), there, truth(**SMALL))
    return (poses.positions - shift) / factor @ turn, smoothing.acceleration


@law
@given(SEEDS)
def test_poses_go_with_the_place_the_unit_and_the_axes_of_the_world(seed):
    """Measured 1.3e-10 m."""
    poses, smoothing, _ = first_told()
    rng = np.random.default_rng(seed)
    turn = matrix_from_vector(rng.normal(size=3))
    points, acceleration = in_other_axes(turn, rng.uniform(0.1, 10), rng.normal(size=3))
    assert differ(points, poses.positions).max() < 3e-10
    assert acceleration == pytest.approx(smoothing.acceleration, rel=1e-10)
