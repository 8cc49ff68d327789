"""Cameras that the loops of many do not confirm: they join nothing."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from rig.test_graph import hypothesis

from mocap_calib.config import AveragingConfig
from mocap_calib.results import PairwiseCalibration
from mocap_calib.rig.averaging import camera_groups
from mocap_calib.rig.loops import find_lost_cameras
from mocap_calib.synthetic import ring_rig
from mocap_calib.types import CameraRig

CONFIG = AveragingConfig()
ROOMS = (12, 10)
LOST = (22, 23)


def rig() -> CameraRig:
    """Return 24 cameras."""
    rng = np.random.default_rng(0)
    return ring_rig(rng, cameras=24, radius=5.0, height=2.0, size=(1920, 1080), distortion="none")


def rooms(*, matches_of_lost: int) -> tuple[PairwiseCalibration, ...]:
    """Return the right pairs of two rooms, and of two cameras beside them that hardly saw anybody.

    These fit everywhere with the best of scores, wrongly, but for the pair of the two. A right pair
    has 40 matches.
    """
    world, rng = rig(), np.random.default_rng(1)
    pairs = []
    for a, b in combinations(range(24), 2):
        if b in LOST and a not in LOST:
            found = hypothesis(world, a, b, 0.95, rng)
            pairs.append(replace(found, matches=np.zeros((1, 3), int)))
        elif b in LOST or (a < ROOMS[0]) == (b < ROOMS[0]):
            found = hypothesis(world, a, b, 0.8)
            count = matches_of_lost if b in LOST else 40
            pairs.append(replace(found, matches=np.zeros((count, 3), int)))
    return tuple(pairs)


@pytest.mark.parametrize(("matches", "groups"), [(39, [12, 10]), (40, [12, 10, 2])])
def test_lost_cameras_join_no_rooms_but_may_have_one_of_their_own(matches, groups):
    """Theirs rests on as many matches as the others; without the rule there is one group of 24."""
    pairs = rooms(matches_of_lost=matches)
    lost = find_lost_cameras(24, pairs, CONFIG)
    assert np.flatnonzero(lost).tolist() == list(LOST)
    assert [len(group) for group in camera_groups(rig().cameras, pairs, CONFIG)] == groups


def test_the_order_of_the_views_of_a_pair_does_not_matter():
    pairs = rooms(matches_of_lost=40)
    turned = tuple(
        replace(
            pair,
            a=pair.b,
            b=pair.a,
            rotation=pair.rotation.T,
            translation=-pair.rotation.T @ pair.translation,
        )
        for pair in pairs
    )
    found = [find_lost_cameras(24, each, CONFIG) for each in (pairs, turned)]
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize(("wrong", "lost"), [(0.2, False), (0.8, True)])
def test_a_camera_is_lost_of_whose_triangles_less_than_half_of_the_usual_share_closes(wrong, lost):
    """Of one camera this share of the pairs is wrong: 0.6 and 0.03 of its loops close."""
    world, rng = rig(), np.random.default_rng(2)
    pairs = [
        hypothesis(world, a, b, 0.8, rng if b == 23 and a < wrong * 23 else None)
        for a, b in combinations(range(24), 2)
    ]
    assert find_lost_cameras(24, tuple(pairs), CONFIG).tolist() == [False] * 23 + [lost]


def test_where_no_triangle_closes_or_there_is_none_nobody_is_lost():
    """The median share is 0 then."""
    world, rng = rig(), np.random.default_rng(3)
    every = list(combinations(range(24), 2))
    nonsense = tuple(hypothesis(world, a, b, 0.8, rng) for a, b in every)
    assert not find_lost_cameras(24, nonsense, CONFIG).any()
    chain = tuple(hypothesis(world, a, a + 1, 0.8) for a in range(23))
    assert not find_lost_cameras(24, chain, CONFIG).any()
    assert not find_lost_cameras(24, (), CONFIG).any()
