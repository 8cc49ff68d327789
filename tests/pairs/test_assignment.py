"""Sinkhorn and mutual best matches: laws."""

import numpy as np

from mocap_calib.pairs.assignment import mutual_best, sinkhorn


def test_sinkhorn_rows_and_columns_hold_at_most_one():
    weight = sinkhorn(np.random.default_rng(0).uniform(size=(20, 3, 5)), dummy=0.2)
    assert (weight.sum(-2) <= 1 + 1e-9).all()
    assert (weight.sum(-1) <= 1 + 1e-2).all()  # twelve sweeps


def test_sinkhorn_is_equivariant_to_order():
    affinity = np.random.default_rng(1).uniform(size=(4, 5))
    rows, columns = [2, 0, 3, 1], [4, 1, 0, 3, 2]
    np.testing.assert_allclose(
        sinkhorn(affinity[rows][:, columns], dummy=0.2),
        sinkhorn(affinity, dummy=0.2)[rows][:, columns],
        atol=1e-12,
    )


def test_the_unlike_stay_alone():
    affinity = np.array([[0.9, 0.0], [0.0, 0.01]])
    assert mutual_best(sinkhorn(affinity, dummy=0.2), least=0.2).tolist() == [
        [True, False],
        [False, False],
    ]


def test_what_is_not_known_matches_nobody():
    """And leaves the others of its frame as they are."""
    affinity = np.array([[np.nan, 0.9], [0.8, 0.2]])
    expected = sinkhorn(np.nan_to_num(affinity), dummy=0.2)
    np.testing.assert_array_equal(sinkhorn(affinity, dummy=0.2), expected)


def test_nobody_is_matched_twice_where_weights_tie():
    """As of a detection that a file has twice: its second row or column matches nobody."""
    affinity = np.array([[0.9, 0.9, 0.1], [0.1, 0.1, 0.8], [0.1, 0.1, 0.8]])
    matched = mutual_best(sinkhorn(affinity, dummy=0.2), least=0.05)
    assert matched.tolist() == [[True, False, False], [False, False, True], [False] * 3]
    both = mutual_best(np.full((4, 2, 2), 0.5), least=0.2)
    np.testing.assert_array_equal(both, np.tile([[True, False], [False, False]], (4, 1, 1)))
