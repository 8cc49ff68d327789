"""Which detections are of one individual without any comparison."""

from types import SimpleNamespace

import numpy as np

from mocap_calib.config import PairwiseConfig
from mocap_calib.two_view.hypotheses import _known_identities


def pair_of(present_a: list[list[int]], present_b: list[list[int]]) -> SimpleNamespace:
    """Views that have these detections, `[frame, instance]`."""
    a, b = (SimpleNamespace(present=np.array(each, bool)) for each in (present_a, present_b))
    return SimpleNamespace(frames=np.arange(len(a.present)), a=a, b=b)


def test_one_subject_in_each_view_is_one_individual():
    """Not where one view sees two, or none; and only where half of the frames are such."""
    pair = pair_of(
        [[1, 0], [0, 1], [1, 1], [1, 0], [0, 0], [1, 0]],
        [[0, 1], [1, 0], [1, 0], [1, 1], [1, 0], [0, 1]],
    )
    (matches,) = _known_identities(pair, False, PairwiseConfig())
    assert matches.tolist() == [[0, 0, 1], [1, 1, 0], [5, 0, 1]]
    more = pair_of(
        [*pair.a.present.tolist(), [1, 1]],
        [*pair.b.present.tolist(), [1, 1]],
    )
    assert _known_identities(more, False, PairwiseConfig()) == []


def test_any_two_tracks_may_be_one_individual_where_both_are_seen():
    pair = pair_of([[1, 0], [1, 1], [0, 1]], [[1, 0], [1, 0], [1, 0]])
    first, second = _known_identities(pair, True, PairwiseConfig())
    assert first.tolist() == [[0, 0, 0], [1, 0, 0]]
    assert second.tolist() == [[1, 1, 0], [2, 1, 0]]
