"""Which detections are of one individual without any comparison, and what else is counted."""

from types import SimpleNamespace

import numpy as np

from mocap_calib.config import PairwiseConfig
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.pairs.solve import _known_identities
from mocap_calib.paper import (
    FivePointConfig,
    _count_inliers,
    _inliers,
    _possible_matches,
)
from mocap_calib.paper import _candidates as _five_point_candidates


def pair_of(
    present_a: list[list[int]], present_b: list[list[int]], *, tracked: bool = False
) -> SimpleNamespace:
    """Views that have these detections, `[frame, instance]`."""
    a, b = (SimpleNamespace(present=np.array(each, bool)) for each in (present_a, present_b))
    return SimpleNamespace(frames=np.arange(len(a.present)), a=a, b=b, tracked=tracked)


def test_one_subject_in_each_view_is_one_individual():
    """Not where one view sees two, or none; and only where half of the frames are such."""
    pair = pair_of(
        [[1, 0], [0, 1], [1, 1], [1, 0], [0, 0], [1, 0]],
        [[0, 1], [1, 0], [1, 0], [1, 1], [1, 0], [0, 1]],
    )
    (matches,) = _known_identities(pair, PairwiseConfig())
    assert matches.tolist() == [[0, 0, 1], [1, 1, 0], [5, 0, 1]]
    more = pair_of(
        [*pair.a.present.tolist(), [1, 1]],
        [*pair.b.present.tolist(), [1, 1]],
    )
    assert _known_identities(more, PairwiseConfig()) == []


def test_any_two_tracks_may_be_one_individual_where_both_are_seen():
    pair = pair_of([[1, 0], [1, 1], [0, 1]], [[1, 0], [1, 0], [1, 0]], tracked=True)
    first, second = _known_identities(pair, PairwiseConfig())
    assert first.tolist() == [[0, 0, 0], [1, 0, 0]]
    assert second.tolist() == [[1, 1, 0], [2, 1, 0]]


def test_inliers_are_counted_of_right_matches_alone():
    """Three bodies of ten joints, one joint wrong in each; a fourth of which four are right."""
    rng = np.random.default_rng(0)
    rotation, translation = (
        matrix_from_vector(np.array([0.1, 1.0, 0.0])),
        np.array([-8.0, 0.3, 5.0]),
    )
    points = rng.normal(0, 0.6, (1, 4, 10, 3)) + rng.normal([0, 0, 10], [2, 0.4, 1], (1, 4, 1, 3))
    points_b = points @ rotation.T + translation
    points_b[:, :, 0, 1] += 1.0
    points_b[:, 3, :6, 1] += 1.0
    a, b = (each / np.linalg.norm(each, axis=-1, keepdims=True) for each in (points, points_b))
    found = _inliers(a, b, (rotation, translation / np.linalg.norm(translation)), 1e-6)
    assert _count_inliers(*found, FivePointConfig.least_fit) == 27


def test_candidates_are_of_detections_that_are_there():
    """One in each view, the first of one and the second of the other."""
    rays = np.ones((2, 1, 2, 10, 3))
    rays[0, :, 1] = rays[1, :, 0] = np.nan
    (mask,) = _five_point_candidates(rays[0], rays[1], 60, np.random.default_rng(0))
    assert np.argwhere(mask).tolist() == [[0, 0, 1]]


def test_sets_of_two_matches_are_of_two_bodies_in_each_view():
    """Each set once; one match where there are not two bodies."""
    found = _possible_matches(np.array([True, False, True]), np.array([True, True]))
    assert found == [[(0, 0), (2, 1)], [(0, 1), (2, 0)]]
    assert _possible_matches(np.array([False, True]), np.array([True, True])) == [
        [(1, 0)],
        [(1, 1)],
    ]
