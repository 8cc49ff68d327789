"""Stages of all views, of one scene told in another order, time, mirror or world.

Each states what was measured of 30 to 40 examples; 1e-15 and the like is rounding, and has room for
other processors. What follows from detections that a rule takes out one by one is not rounding:
there the bound is what was measured, by half more.
"""

from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import (
    adjust_twice,
    lifted,
    mirrored,
    mirrored_rig,
    recording,
    rigs_differ,
    scene,
    told,
    truth,
    turn_cameras,
)

from mocap_calib.config import Config, TriangulateConfig
from mocap_calib.identities import finalise_identities
from mocap_calib.lift import lift
from mocap_calib.lift.lifter import load_lifter
from mocap_calib.results import Matches, Uncertainty
from mocap_calib.rig import per_frame_labels
from mocap_calib.rig.associate import associate
from mocap_calib.rig.triangulate import triangulate
from mocap_calib.types import CameraRig, silent
from mocap_calib.verdict.verdict import assess_uncertainty

law = settings(max_examples=4, deadline=None, derandomize=True)
SEEDS = st.integers(0, 2**32 - 1)
SMALL = {"frames": 12}


ALL = ("views", "instances", "names", "time", "mirror", "world")
ADJUSTED = dict.fromkeys(ALL, 1e-12) | {"views": 1e-4, "world": 1e-10}


@pytest.mark.parametrize("how", ALL)
@law
@given(seed=SEEDS)
def test_adjustment_knows_no_order_time_mirror_or_world(how, seed):
    """Measured 3e-13, another world 2e-11. Another order of cameras 4e-5: another one is held."""
    rng = np.random.default_rng(seed)
    start = turn_cameras(scene(**SMALL).rig, 1.0, seed=int(rng.integers(100)))
    found, place, matches, views = told(how, rng, **SMALL)
    first = adjust_twice(recording(**SMALL), start, truth(**SMALL), Config())
    second = adjust_twice(found, place(start), matches, Config())
    back = mirrored_rig(second) if how == "mirror" else second
    assert rigs_differ(first.select(views), back) < ADJUSTED[how]


@lru_cache
def assessed(frames: int) -> tuple[CameraRig, Uncertainty]:
    """A rig, adjusted from the truth, and how sure it is."""
    given = recording(frames=frames), scene(frames=frames).rig, truth(frames=frames), Config()
    rig = adjust_twice(*given)
    return rig, assess_uncertainty(given[0], rig, *given[2:])


SURE = dict.fromkeys(ALL, 1e-11) | {"views": 4e-4, "world": 1e-10}
FOCAL = dict.fromkeys(ALL, 1e-12) | {"views": 5e-4, "world": 1e-11}


def surer(found: Uncertainty, expected: Uncertainty, views: np.ndarray) -> float:
    """Return by what share sigmas differ at most from those expected of the same cameras."""
    sigmas = [
        np.stack([each.covariance.rotation_sigma, each.covariance.centre_sigma])
        for each in (found, expected)
    ]
    return float(np.abs(sigmas[0] / sigmas[1][:, views] - 1).max())


@pytest.mark.parametrize("how", ALL)
@law
@given(seed=SEEDS)
def test_how_sure_a_rig_is_knows_no_order_time_mirror_or_world(how, seed):
    """Sigmas: measured 7e-13, another world 1e-11, another order of cameras 2e-4.

    Focal lengths are freed on a part of the points, another one in another order: 3.4e-4.
    """
    rng = np.random.default_rng(seed)
    rig, expected = assessed(12)
    sample, place, matches, views = told(how, rng, **SMALL)
    found = assess_uncertainty(sample, place(rig), matches, Config())
    assert surer(found, expected, views) < SURE[how]
    np.testing.assert_allclose(
        found.focal_change, expected.focal_change[views], rtol=0, atol=FOCAL[how]
    )
    for name in ("outlier_cameras", "weak_perspective", "wrong_focal"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name)[views])


def test_blocks_of_time_are_cut_elsewhere_where_time_runs_backwards():
    """No exact law: of 24 frames there are blocks of one and of two. Measured 6.7 %."""
    rig, expected = assessed(24)
    sample, _, matches, views = told("time", np.random.default_rng(0), frames=24)
    found = assess_uncertainty(sample, rig, matches, Config())
    assert 1e-3 < surer(found, expected, views) < 0.1


def same_groups(first: np.ndarray, second: np.ndarray) -> bool:
    """Return whether labels name the same detections alike, whatever the names."""
    there = first >= 0
    if not np.array_equal(there, second >= 0):
        return False
    names = np.unique(np.stack([first[there], second[there]]), axis=1)
    return bool((np.bincount(names[0]) == 1).all() and (np.bincount(names[1]) == 1).all())


def retold(how: str, rng: np.random.Generator, labels: np.ndarray) -> np.ndarray:
    """Return labels `[view, frame, instance]` of a scene in the order in which it is told."""
    if how == "views":
        return labels[rng.permutation(len(labels))]
    if how == "instances":
        return labels[:, :, rng.permutation(labels.shape[2])]
    return labels[:, ::-1] if how == "time" else labels


@pytest.mark.parametrize("how", ALL)
@law
@given(seed=SEEDS)
def test_who_is_who_in_the_end_knows_no_order_time_mirror_or_world(how, seed):
    """The same detections have one name, whatever it is."""
    size = {"frames": 60}
    found, place, matches, _ = told(how, np.random.default_rng(seed), **size)
    first = finalise_identities(recording(**size), scene(**size).rig, truth(**size), Config())
    second = finalise_identities(found, place(scene(**size).rig), matches, Config())
    expected = retold(how, np.random.default_rng(seed), first.labels)
    assert first.individuals == 3
    assert same_groups(second.labels, expected)


@pytest.mark.parametrize("how", ["views", "instances", "time", "world"])
@law
@given(seed=SEEDS)
def test_matching_knows_no_order_time_or_world(how, seed):
    """The network that lifts bodies knows left from right, so that a mirror is another scene."""
    rig, lifter = scene(**SMALL).rig, load_lifter()[0]
    found, place, _, _ = told(how, np.random.default_rng(seed), **SMALL)
    first = associate(recording(**SMALL), lifted(**SMALL), rig, Config(), progress=silent)
    bodies = lift(found, lifter, progress=silent)
    second = associate(found, bodies, place(rig), Config(), progress=silent)
    expected = Matches(retold(how, np.random.default_rng(seed), first.labels))
    assert first.individuals == 3
    in_frames = [per_frame_labels(matches).labels for matches in (second, expected)]
    np.testing.assert_array_equal(*in_frames)


def test_points_of_the_mirror_image_are_the_mirror_image_of_points():
    """To the last digit."""
    rig = scene(**SMALL).rig
    first = triangulate(recording(**SMALL), rig, truth(**SMALL), TriangulateConfig())
    image = triangulate(
        mirrored(recording(**SMALL)), mirrored_rig(rig), truth(**SMALL), TriangulateConfig()
    )
    np.testing.assert_allclose(image.positions * [-1, 1, 1], first.positions, rtol=1e-13)
