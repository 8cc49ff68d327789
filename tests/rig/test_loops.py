"""Cameras that the loops of many do not confirm: they join nothing."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from rig.test_graph import hypothesis

from mocap_calib.config import AveragingConfig
from mocap_calib.results import PairwiseCalibration
from mocap_calib.rig.view_graph import camera_groups
from mocap_calib.synthetic import ring_rig
from mocap_calib.types import CameraRig

CONFIG = AveragingConfig()
ROOMS = (12, 10)
LOST = (22, 23)


def rig() -> CameraRig:
    """Return 24 cameras."""
    rng = np.random.default_rng(0)
    return ring_rig(rng, cameras=24, radius=5.0, height=2.0, size=(1920, 1080), distortion="none")


def rooms() -> tuple[PairwiseCalibration, ...]:
    """Return the right pairs of two rooms, and of two cameras beside them that hardly saw anybody.

    These fit everywhere with the best of scores, wrongly.
    """
    world, rng = rig(), np.random.default_rng(1)
    return tuple(
        hypothesis(world, a, b, 0.95, rng) if b in LOST else hypothesis(world, a, b, 0.8)
        for a, b in combinations(range(24), 2)
        if b in LOST or (a < ROOMS[0]) == (b < ROOMS[0])
    )


def test_cameras_that_contradict_all_others_join_no_rooms():
    """Without the rule there is one group of 24. The order of the views of a pair is any."""
    turned = tuple(
        replace(
            pair,
            a=pair.b,
            b=pair.a,
            rotation=pair.rotation.T,
            translation=-pair.rotation.T @ pair.translation,
        )
        for pair in rooms()
    )
    for pairs in (rooms(), turned):
        groups = camera_groups(rig().cameras, pairs, CONFIG)
        assert [len(group) for group in groups] == list(ROOMS)


@pytest.mark.parametrize(("wrong", "left"), [(0.2, 24), (1.0, 23)])
def test_a_camera_is_left_out_where_none_of_its_pairs_closes_half_of_its_triangles(wrong, left):
    """Of one camera this share of the pairs is wrong."""
    world, rng = rig(), np.random.default_rng(2)
    pairs = [
        hypothesis(world, a, b, 0.8, rng if b == 23 and a < wrong * 23 else None)
        for a, b in combinations(range(24), 2)
    ]
    (group,) = camera_groups(rig().cameras, tuple(pairs), CONFIG)
    assert len(group) == left


def test_pairs_without_triangles_join():
    chain = tuple(hypothesis(rig(), a, a + 1, 0.8) for a in range(23))
    (group,) = camera_groups(rig().cameras, chain, CONFIG)
    assert len(group) == 24
