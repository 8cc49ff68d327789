"""Blocks of points and the views that see them: every detection is in one, and few others."""

import numpy as np
import pytest

from mocap_calib.config import SMALL_RIG
from mocap_calib.geometry.graphs import fiedler_vector
from mocap_calib.geometry.intersection import ViewBlock, order_by_views, view_blocks


def hall(views: int, points: int) -> np.ndarray:
    """Return who sees what along a hall, `[view, N]`: each view, in random order, a tenth of it."""
    rng = np.random.default_rng(0)
    place, where = rng.uniform(0, 10, (views, 1)), rng.uniform(0, 10, points)
    return np.asarray((np.abs(place - where) < 0.5) & (rng.random((views, points)) < 0.9))


@pytest.mark.parametrize("views", [2, SMALL_RIG, SMALL_RIG + 1, 60])
def test_every_detection_is_in_one_block(views):
    seen, times = hall(views, 9000), np.zeros((views, 9000), dtype=np.int64)
    for block in view_blocks(seen):
        part = np.array(block.take(seen), dtype=np.int64)
        block.put(part + block.take(times), times)
    np.testing.assert_array_equal(times, seen)


def test_a_small_rig_is_not_sorted():
    """What is computed of it stays the same to the last bit, however many points there are."""
    seen = hall(SMALL_RIG, 9000)
    assert [block.points for block in view_blocks(seen)] == [slice(0, 8192), slice(8192, 16384)]
    assert all(len(block.views) == SMALL_RIG for block in view_blocks(seen))


def test_blocks_of_a_hall_leave_out_who_sees_nothing():
    """Measured: 9.6 of 60 views in a block, where 5.2 see a point; all 60 unless it is sorted."""
    seen = hall(60, 20_000)
    views = [len(block.views) for block in view_blocks(seen)]
    assert np.mean(views) < 14
    as_it_comes = ViewBlock(np.arange(60), slice(0, 1024))
    assert as_it_comes.take(seen).any(1).all()


def test_nobody_sees_anything():
    assert view_blocks(np.zeros((60, 100), dtype=bool)) == []
    assert len(order_by_views(np.zeros((60, 100), dtype=bool))) == 100


def test_points_keep_their_middle_part():
    """Of arrays with a component between views and points, `[view, 3, N]`."""
    seen, values = hall(60, 3000), np.random.default_rng(1).normal(size=(60, 3, 3000))
    for block in view_blocks(seen):
        np.testing.assert_array_equal(block.take(values), values[block.views][..., block.points])


def test_neighbours_in_a_chain_are_neighbours_of_the_vector():
    """Of a chain the Fiedler vector is a half of a cosine, so it follows the chain."""
    order = np.random.default_rng(0).permutation(30)
    weight = np.zeros((30, 30))
    weight[order[1:], order[:-1]] = weight[order[:-1], order[1:]] = 1.0
    found = np.argsort(fiedler_vector(weight))
    assert found.tolist() in (order.tolist(), order[::-1].tolist())
