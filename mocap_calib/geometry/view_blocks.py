"""Points in blocks that stay in the cache, each with the views that see any of its points.

In a small rig nearly every view sees every block. In a large hall a point is seen by a few views of
all, so points that the same views see come together there, and a block leaves out the others.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_calib.config import SMALL_RIG
from mocap_calib.geometry.graphs import fiedler_vector
from mocap_calib.types import Bools, Ints

# Points at a time: enough that calls cost little beside, few enough for the cache
POINT_BLOCK = 8192
_BLOCK_OF_A_LARGE_RIG = 1024  # fewer points are seen by fewer views


@dataclass(frozen=True)
class ViewBlock:
    """Some points, and the views that see any of them.

    views: `[own view]` their indices. points: `[n]` their indices, or where they lie; then the
        views are all that there are.
    """

    views: Ints
    points: Ints | slice

    def take(self, array: NDArray[Any]) -> NDArray[Any]:
        """Return the part `[own view, ..., n]` of an array `[view, ..., N]`."""
        if isinstance(self.points, slice):
            return array[..., self.points]
        between = [np.arange(size) for size in array.shape[1:-1]]
        return array[np.ix_(self.views, *between, self.points)]

    def put(self, part: NDArray[Any], array: NDArray[Any]) -> None:
        """Set the part `[own view, n]` of an array `[view, N]`."""
        if isinstance(self.points, slice):
            array[:, self.points] = part
        else:
            array[np.ix_(self.views, self.points)] = part


def point_blocks(count: int) -> list[slice]:
    """Return the blocks of so many points that are worked on at a time, one at least."""
    return [slice(start, start + POINT_BLOCK) for start in range(0, max(count, 1), POINT_BLOCK)]


def view_blocks(seen: Bools) -> list[ViewBlock]:
    """Return blocks of all points that any view sees; of a small rig, of all points.

    seen: `[view, N]` whether a view sees a point.
    """
    views, count = seen.shape
    if views <= SMALL_RIG:
        return [ViewBlock(np.arange(views), block) for block in point_blocks(count)]
    order = order_by_views(seen)
    order = order[np.any(seen[:, order], axis=0)]
    blocks = []
    for start in range(0, len(order), _BLOCK_OF_A_LARGE_RIG):
        points = order[start : start + _BLOCK_OF_A_LARGE_RIG]
        blocks.append(ViewBlock(np.flatnonzero(seen[:, points].any(1)), points))
    return blocks


def order_by_views(seen: Bools) -> Ints:
    """Return the indices of points in an order in which the same views see those that follow.

    seen: `[view, N]`. In a large rig the views come in the order of the Fiedler vector of how much
    they see in common: views of one place are neighbours in it.
    """
    if len(seen) > SMALL_RIG:
        share = seen.astype(np.float64)
        share /= np.maximum(np.sqrt(share.sum(1, keepdims=True)), 1.0)
        seen = seen[np.argsort(fiedler_vector(share @ share.T), kind="stable")]
    return np.lexsort(seen)
