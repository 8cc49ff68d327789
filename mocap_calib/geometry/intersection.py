"""Points from the rays of many views, robustly, many at once, and how sure they are.

All points start in closed form (weighted least squares on lines) and take Gauss-Newton steps on
angles. Those whose rays do not all meet there start again under a loss that tightens, and where
fewer than half of the rays agree even then, every pair of rays gives a candidate. Arrays are kept
by component, `[view, 3, N]`, in blocks that stay in the cache, each with the views that see any of
its points: in a large hall a point is seen by a few views of all.

Covariances are to first order, with J the derivatives of the rays' angles by the point: a ray that
is seen at the distance d along the unit vector u has J' J = (I - u u') / d^2.
"""

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import (
    INTERSECT_AGREEING_RAYS,
    INTERSECT_DOUBTFUL,
    INTERSECT_LOSS_SCALE,
    INTERSECT_OUTLIER,
    INTERSECT_STEPS,
    INTERSECT_TIGHTENING_SCALES,
    SMALL_RIG,
)
from mocap_calib.geometry.graphs import fiedler_vector
from mocap_calib.kernels import intersection as kernels
from mocap_calib.kernels.jit import contiguous
from mocap_calib.types import Bools, CameraRig, Floats, Ints


def intersect(rig: CameraRig, world: Floats, precision: Floats) -> Floats:
    """Return the points `[3, N]` nearest to rays, in angles; NaN where fewer than two are seen.

    world: `[view, 3, N]` unit rays in the world's axes, zero where missing.
    precision: `[view, N]` inverse variance of the angle in radians, 0 = not seen.
    """
    middle = rig.centres.mean(0)
    points = np.empty(world.shape[1:])
    first, others = _candidate_pairs(len(rig))
    kernels.intersect_rays(
        *contiguous(rig.centres - middle, world, precision),
        np.array(first + others, dtype=np.int64).reshape(-1, 2),
        len(first),
        np.full(INTERSECT_STEPS, INTERSECT_LOSS_SCALE),
        np.array(INTERSECT_TIGHTENING_SCALES),
        np.array([INTERSECT_DOUBTFUL, INTERSECT_OUTLIER, INTERSECT_AGREEING_RAYS]),
        points,
    )
    return points + middle[:, None]


def _candidate_pairs(views: int) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Return the pairs of views that try every point they see, and those that fill what these miss.

    All pairs are of the first kind in a small rig. In a large one they are those of a view with
    the next one, and with the one a third of the rig away.
    """
    pairs = list(combinations(range(views), 2))
    if views <= SMALL_RIG:
        return pairs, []
    neighbours = {
        (min(view, other), max(view, other))
        for view in range(views)
        for other in ((view + 1) % views, (view + views // 3) % views)
    }
    return sorted(neighbours), [pair for pair in pairs if pair not in neighbours]


# Where a point follows one ray almost wholly, what is left of that ray's error tells nothing
# certain of the error: this share of its variance at least is taken to be left.
_LEAST_SHARE = 0.05
# the median angle of a view that does not see the point, which then takes up nothing of its error:
# of two degrees of freedom, by the formula of `median_angles`
_UNTOUCHED = (2 * (1 - 1 / 9) ** 3) ** 0.5


def point_covariance(
    rig: CameraRig, points: Floats, world: Floats, *, precision: Floats, variance: Floats
) -> Floats:
    """Return the covariances `[6, N]` of points that `intersect` found: xx, xy, xz, yy, yz, zz.

    points: `[3, N]` in world coordinates. world: `[view, 3, N]` unit rays in the world's axes, zero
        where missing.
    precision: `[view, N]` what they were weighed by, 0 = not used.
    variance: `[view]` of one coordinate of the rays' angles, in radians squared.

    With the robust weights w and N = sum w J'J they are N^-1 (sum w^2 s^2 J'J) N^-1: N^-1 itself
    where the weights are the inverse variances. Huge where the rays used are all in one line.
    """
    offset = points - rig.centres[:, :, None]
    square = np.maximum((offset**2).sum(1), 1e-300)
    unit = offset / np.sqrt(square)[:, None]
    along = np.einsum("vin,vin->vn", unit, world)
    error = np.maximum(1 - along**2, 0.0) * precision
    weight = precision / (1 + error / INTERSECT_LOSS_SCALE**2) ** 2
    known = _sum_across(weight / square, unit)
    spread = _sum_across(weight**2 * variance[:, None] / square, unit)
    size = np.trace(known, axis1=1, axis2=2)[:, None, None]
    scaled = known / np.where(size > 0, size, 1.0) + kernels.RIDGE * np.eye(3)
    inverse = np.linalg.inv(scaled) / np.where(size > 0, size, 1.0)
    return (inverse @ spread @ inverse)[:, *np.triu_indices(3)].T


def _sum_across(share: Floats, unit: Floats) -> Floats:
    """Return sums of shares `[view, N]` of I - u u' of unit vectors `[view, 3, N]`, `[N, 3, 3]`."""
    along = np.einsum("vin,vjn->nij", share[:, None] * unit, unit)
    return share.sum(0)[:, None, None] * np.eye(3) - along


def median_angles(rig: CameraRig, points: Floats, weight: Floats) -> Floats:
    """Return the medians `[view, N]` of the angles between rays and the points made of them.

    In standard deviations of one coordinate of the rays' errors, whose variances are inverse to
    the weights (`[view, N]`). An angle without any point would have 1.18. The point takes up
    H = w J (sum w J'J)^-1 J' of a ray's error, so what is left has the covariance I - H: of three
    coordinates less in all, but more of a near camera than of a far one, and in one direction
    alone where two rays meet.

    The squared angle has the mean m = tr(I - H) and the variance 2 tr(I - H)^2. As chi-squared of
    k = m^2 / tr(I - H)^2 degrees of freedom it has the median m (1 - 2 / (9 k))^3 (Satterthwaite
    1946; Wilson and Hilferty 1931).
    """
    medians = np.full(weight.shape, _UNTOUCHED)

    def measure(block: ViewBlock) -> Floats:
        """Return the medians of a block, where most views see most of the points."""
        seen_by = block.take(weight)
        found = np.empty(seen_by.shape)
        given = contiguous(rig.centres[block.views], points[:, block.points], seen_by)
        kernels.median_angles(*given, _LEAST_SHARE, _UNTOUCHED, found)
        return found

    blocks = view_blocks(np.asarray(weight > 0))
    for block, found in zip(blocks, map_in_threads(measure, blocks), strict=True):
        block.put(found, medians)
    return medians


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
