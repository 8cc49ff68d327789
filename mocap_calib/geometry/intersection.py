"""Points from the rays of many views, robustly, many at once.

All points start in closed form (weighted least squares on lines) and take Gauss-Newton steps on
angles. Those whose rays do not all meet there start again under a loss that tightens, and where
too few rays agree even then, every pair of rays gives a candidate. Arrays are kept by component,
`[view, 3, N]`, in blocks that stay in the cache.
"""

from dataclasses import dataclass
from itertools import combinations
from types import ModuleType

import numpy as np

from mocap_calib.config import (
    INTERSECT_AGREEING_RAYS,
    INTERSECT_AGREEING_SHARE,
    INTERSECT_ALL_PAIRS_VIEWS,
    INTERSECT_DOUBTFUL,
    INTERSECT_LOSS_SCALE,
    INTERSECT_OUTLIER,
    INTERSECT_POLISH_STEPS,
    INTERSECT_STEPS,
    INTERSECT_TIGHTENING_SCALES,
)
from mocap_calib.geometry import symmetric
from mocap_calib.geometry.symmetric import Entries
from mocap_calib.kernels.loading import compiled, contiguous
from mocap_calib.types import Bools, CameraRig, Floats, Ints

_PACKAGE = "mocap_calib.kernels"


@dataclass(frozen=True)
class _Rays:
    """The rays of N points.

    centres: `[view, 3]` camera centres, about their mean.
    direction: `[view, 3, N]` unit vectors in the world's axes, zero where missing.
    precision: `[view, N]` inverse variance of the angle in radians, 0 = not seen.
    """

    centres: Floats
    direction: Floats
    precision: Floats

    @property
    def seen(self) -> Bools:
        """`[view, N]` whether a view sees the point."""
        return self.precision > 0

    def of_points(self, points: Ints) -> "_Rays":
        """Return the rays of the points with these indices `[point]` alone."""
        return _Rays(self.centres, self.direction[..., points], self.precision[:, points])

    def of_views(self, views: list[int]) -> "_Rays":
        """Return the rays of these views (indices) alone."""
        return _Rays(self.centres[views], self.direction[views], self.precision[views])


def intersect(rig: CameraRig, world: Floats, precision: Floats) -> Floats:
    """Return the points `[3, N]` nearest to rays, in angles; NaN where fewer than two are seen.

    world: `[view, 3, N]` unit rays in the world's axes, zero where missing.
    precision: `[view, N]` inverse variance of the angle in radians, 0 = not seen.
    """
    middle = rig.centres.mean(0)
    rays = _Rays(rig.centres - middle, world, precision)
    all_rays = compiled(f"{_PACKAGE}.intersection")
    outlying_rays = compiled(f"{_PACKAGE}.outlying_rays")
    if all_rays is None or outlying_rays is None:
        points = _intersect_rays(rays)
    else:
        points = _by_kernels(all_rays, outlying_rays, rays)
    return points + middle[:, None]


def _by_kernels(all_rays: ModuleType, outlying_rays: ModuleType, rays: _Rays) -> Floats:
    """Return what `_intersect_rays` returns."""
    points = np.empty(rays.direction.shape[1:])
    doubts = np.empty(rays.direction.shape[-1], dtype=bool)
    given = contiguous(rays.centres, rays.direction, rays.precision)
    steps = np.full(INTERSECT_STEPS, INTERSECT_LOSS_SCALE)
    all_rays.intersect_rays(*given, steps, INTERSECT_DOUBTFUL, points, doubts)
    doubtful = np.flatnonzero(doubts)
    if len(doubtful):
        first, others = _candidate_pairs(len(rays.centres))
        outlying_rays.refine_among_outliers(
            *given,
            doubtful,
            np.array(first + others, dtype=np.int64).reshape(-1, 2),
            len(first),
            np.array(INTERSECT_TIGHTENING_SCALES),
            np.full(INTERSECT_POLISH_STEPS, INTERSECT_LOSS_SCALE),
            np.array([INTERSECT_OUTLIER, INTERSECT_AGREEING_RAYS, INTERSECT_AGREEING_SHARE]),
            points,
        )
    return points


def _intersect_rays(rays: _Rays) -> Floats:
    """Return the points `[3, N]` nearest to rays; NaN where fewer than two are seen."""
    points = _intersect_lines(rays)
    points = _refine(rays, points, INTERSECT_STEPS)
    points[:, rays.seen.sum(0) < 2] = np.nan
    doubtful = _doubtful_points(rays, points)
    if len(doubtful):
        points[:, doubtful] = _refine_among_outliers(rays.of_points(doubtful), points[:, doubtful])
    return points


def _doubtful_points(rays: _Rays, points: Floats) -> Ints:
    """Return the points (indices) of three and more rays that do not all meet there."""
    count = rays.seen.sum(0)
    missed = _squared_error(rays, points) > INTERSECT_DOUBTFUL * count
    return np.flatnonzero(missed.any(0) & (count > 2))


def _refine_among_outliers(rays: _Rays, points: Floats) -> Floats:
    """Return points `[3, N]` some of whose rays are wrong, after more robust refinement."""
    for scale in INTERSECT_TIGHTENING_SCALES:
        points = points + _gauss_newton_step(rays, points, loss_scale=scale)
    meets = (_squared_error(rays, points) <= INTERSECT_OUTLIER) & rays.seen
    meeting = meets.sum(0)
    enough = meeting >= INTERSECT_AGREEING_RAYS
    most = meeting >= INTERSECT_AGREEING_SHARE * rays.seen.sum(0)
    unsolved = np.flatnonzero(~(enough & most))
    if len(unsolved):
        points[:, unsolved] = _search_pairs(rays.of_points(unsolved))
    return points


def _search_pairs(rays: _Rays) -> Floats:
    """Return the best of the points `[3, N]` that pairs of views give, refined."""
    points = np.full(rays.direction.shape[1:], np.nan)
    cost = np.full(rays.direction.shape[2], np.inf)
    seen = rays.seen
    first_pairs, other_pairs = _candidate_pairs(len(rays.centres))
    for a, b in first_pairs:
        both = np.flatnonzero(seen[a] & seen[b])
        _try_candidates(rays, (a, b), both, points=points, cost=cost)
    missed = np.flatnonzero(~np.isfinite(cost))
    for a, b in other_pairs:
        if not len(missed):
            break
        both = missed[seen[a, missed] & seen[b, missed]]
        if len(both):
            _try_candidates(rays, (a, b), both, points=points, cost=cost)
            missed = missed[~np.isfinite(cost[missed])]
    return _refine(rays, points, INTERSECT_POLISH_STEPS)


def _try_candidates(
    rays: _Rays, pair: tuple[int, int], indices: Ints, *, points: Floats, cost: Floats
) -> None:
    """Intersect the rays of two views, and keep the candidates that fit all views better.

    indices: `[candidate]` of the points that are tried. points `[3, N]` and cost `[N]` of the best
    candidates so far are changed in place.
    """
    candidate = _intersect_lines(rays.of_views(list(pair)).of_points(indices))
    candidate_rays = rays.of_points(indices)
    capped = np.minimum(_squared_error(candidate_rays, candidate), INTERSECT_OUTLIER)
    candidate_cost = np.where(candidate_rays.seen, capped, 0.0).sum(0)
    better = candidate_cost < cost[indices]
    points[:, indices[better]] = candidate[:, better]
    cost[indices[better]] = candidate_cost[better]


def _candidate_pairs(views: int) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Return the pairs of views that try every point they see, and those that fill what these miss.

    All pairs are of the first kind in a small rig. In a large one they are those of a view with
    the next one, and with the one a third of the rig away.
    """
    pairs = list(combinations(range(views), 2))
    if views <= INTERSECT_ALL_PAIRS_VIEWS:
        return pairs, []
    neighbours = {
        (min(view, other), max(view, other))
        for view in range(views)
        for other in ((view + 1) % views, (view + views // 3) % views)
    }
    return sorted(neighbours), [pair for pair in pairs if pair not in neighbours]


def _intersect_lines(rays: _Rays) -> Floats:
    """Return the points `[3, N]` nearest to weighted lines, in closed form."""
    total = rays.precision.sum(0)
    weight = rays.precision / np.maximum(total, 1e-300)
    along = np.einsum("vi,vin->vn", rays.centres, rays.direction)
    projected = np.einsum("vin,vn->in", rays.direction, weight * along)
    side = rays.centres.T @ weight - projected
    return symmetric.solve(normal_matrix(rays.direction, weight), side)


def _refine(rays: _Rays, points: Floats, steps: int) -> Floats:
    """Return points `[3, N]` after steps under the loss of the end."""
    for _ in range(steps):
        points = points + _gauss_newton_step(rays, points, loss_scale=INTERSECT_LOSS_SCALE)
    return points


def _gauss_newton_step(rays: _Rays, points: Floats, *, loss_scale: float) -> Floats:
    """Return the Gauss-Newton step `[3, N]` on angles, under the loss of Geman and McClure.

    loss_scale: in standard deviations of the angle.
    """
    offset = points - rays.centres[:, :, None]
    square, along = _lengths(offset, rays.direction)
    error = np.maximum(1 - along * along / square, 0.0) * rays.precision
    weight = rays.precision / (square * (1 + error / loss_scale**2) ** 2)
    weight /= np.maximum(weight.sum(0), 1e-300)
    weighted = np.einsum("vin,vn->in", offset, weight)
    projected = np.einsum("vin,vn->in", rays.direction, weight * along)
    return -symmetric.solve(normal_matrix(rays.direction, weight), weighted - projected)


def _squared_error(rays: _Rays, points: Floats) -> Floats:
    """Return the squared sines `[view, N]` between rays and points, in standard deviations.

    Infinite behind the camera, 0 where nothing is seen.
    """
    square, along = _lengths(points - rays.centres[:, :, None], rays.direction)
    error = np.maximum(1 - along * along / square, 0.0) * rays.precision
    error = np.where(along > 0, error, np.inf)
    return np.where(rays.seen, error, 0.0)


def _lengths(offset: Floats, direction: Floats) -> tuple[Floats, Floats]:
    """Return the squared lengths of offsets `[view, 3, N]` and their lengths along the rays.

    Both `[view, N]`.
    """
    square = np.einsum("vin,vin->vn", offset, offset)
    along = np.einsum("vin,vin->vn", offset, direction)
    return np.maximum(square, 1e-18), along


def normal_matrix(direction: Floats, weight: Floats) -> Entries:
    """Return sum w (I - u u') over the views, as its entries.

    direction: `[view, 3, N]` unit vectors u; weight: `[view, N]`.
    """
    x, y, z = direction[:, 0], direction[:, 1], direction[:, 2]
    wx, wy, wz = x * weight, y * weight, z * weight
    total = weight.sum(0)
    return (
        total - _sum_over_views(wx, x),
        -_sum_over_views(wx, y),
        -_sum_over_views(wx, z),
        total - _sum_over_views(wy, y),
        -_sum_over_views(wy, z),
        total - _sum_over_views(wz, z),
    )


def _sum_over_views(first: Floats, second: Floats) -> Floats:
    """Return the sums `[N]` of the products of two arrays `[view, N]`."""
    return np.einsum("vn,vn->n", first, second)
