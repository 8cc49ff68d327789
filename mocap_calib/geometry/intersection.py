"""Points from the rays of many views, robustly, many at once.

All points start in closed form (weighted least squares on lines) and take Gauss-Newton steps on angles. Those whose rays do not all meet
there start again under a loss that tightens, and what still does not agree starts from every pair of rays. Arrays are kept by
component, `[view, 3, N]`, in blocks that stay in the cache.
"""

from itertools import combinations

import numpy as np

from mocap_calib.types import CameraRig, Floats

_SMALL_RIG = 7  # views up to which all pairs of them propose points
_STEPS = 2  # of Gauss-Newton after the closed form: measured, the third moves a point by 1e-9 of its distance
_TIGHTEN = (24.0, 12.0, 6.0, 3.0, 3.0, 3.0)  # scales of the loss, in standard deviations
_POLISH = 6
_SCALE = 3.0  # of the loss in the end
_OUTLIER = 16.0  # squared error in standard deviations, from which on a ray does not belong
_DOUBTFUL = (
    4 / 3
)  # squared error for each of the rays, from which on a point starts again: of few rays a wrong one bends the point to itself
_AGREE = 0.6  # share of a point's rays, three at least, that must meet for the rest to be outliers


def intersect(rig: CameraRig, world: Floats, precision: Floats) -> Floats:
    """`[3, N]` points nearest to rays, in angles; NaN where there are fewer than two.

    world: `[view, 3, N]` unit rays in the world's axes (zero where missing); precision: `[view, N]` inverse variance of the angle in
    radians, 0 = not seen.
    """
    middle = rig.centres.mean(0)
    centres = rig.centres - middle
    count = (precision > 0).sum(0)
    points = _closed_form(centres, world, precision)
    for _ in range(_STEPS):
        points = points + _step(centres, points, world, precision, _SCALE)
    points[:, count < 2] = np.nan
    doubtful = np.flatnonzero(
        (_error(centres, points, world, precision) > _DOUBTFUL * count).any(0) & (count > 2)
    )
    if len(doubtful):
        points[:, doubtful] = _among_outliers(
            centres, points[:, doubtful], world[..., doubtful], precision[:, doubtful]
        )
    return points + middle[:, None]


def _among_outliers(centres: Floats, points: Floats, world: Floats, precision: Floats) -> Floats:
    """Points some of whose rays are wrong."""
    for scale in _TIGHTEN:
        points = points + _step(centres, points, world, precision, scale)
    count = (precision > 0).sum(0)
    meeting = ((_error(centres, points, world, precision) <= _OUTLIER) & (precision > 0)).sum(0)
    hard = np.flatnonzero(~((meeting >= 3) & (meeting >= _AGREE * count)))
    if len(hard):
        points[:, hard] = _from_pairs(centres, world[..., hard], precision[:, hard])
    return points


def _from_pairs(centres: Floats, world: Floats, precision: Floats) -> Floats:
    """The best of the points that pairs of views propose, refined."""
    points, cost = np.full(world.shape[1:], np.nan), np.full(world.shape[2], np.inf)
    first, others = _seed_pairs(len(centres))
    for turn, pair in enumerate([*first, *others]):
        a, b = pair
        both = np.flatnonzero(
            (precision[a] > 0) & (precision[b] > 0) & ((turn < len(first)) | ~np.isfinite(cost))
        )
        two = list(pair)
        proposal = _closed_form(centres[two], world[two][..., both], precision[two][:, both])
        rays, weight = world[..., both], precision[:, both]
        residual = np.where(
            weight > 0, np.minimum(_error(centres, proposal, rays, weight), _OUTLIER), 0.0
        ).sum(0)
        better = residual < cost[both]
        points[:, both[better]], cost[both[better]] = proposal[:, better], residual[better]
    for _ in range(_POLISH):
        points = points + _step(centres, points, world, precision, _SCALE)
    return points


def _seed_pairs(views: int) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Pairs of views that propose every point they see, and pairs that propose those that none of the first sees.

    All are of the first kind in a small rig; in a large one those to the next view and to one a third of the rig away.
    """
    pairs = list(combinations(range(views), 2))
    if views <= _SMALL_RIG:
        return pairs, []
    first = sorted(
        {
            (min(v, (v + s) % views), max(v, (v + s) % views))
            for v in range(views)
            for s in (1, views // 3)
        }
    )
    return first, [pair for pair in pairs if pair not in set(first)]


def _closed_form(centres: Floats, world: Floats, weight: Floats) -> Floats:
    """`[3, N]` points nearest to weighted lines."""
    share = weight / np.maximum(weight.sum(0), 1e-300)
    along = np.einsum("vi,vin->vn", centres, world)
    return _solved(
        _normal(world, share),
        centres.T @ share - np.einsum("vin,vn->in", world, share * along),
        1e-10,
    )


def _step(
    centres: Floats, points: Floats, world: Floats, precision: Floats, scale: float
) -> Floats:
    """`[3, N]` the Gauss-Newton step on angles, under Geman and McClure's loss at `scale` standard deviations."""
    offset = points - centres[:, :, None]
    square, along = _lengths(offset, world)
    error = np.maximum(1 - along * along / square, 0.0) * precision
    weight = precision / (square * (1 + error / scale**2) ** 2)
    weight /= np.maximum(weight.sum(0), 1e-300)
    return -_solved(
        _normal(world, weight),
        np.einsum("vin,vn->in", offset, weight) - np.einsum("vin,vn->in", world, weight * along),
        1e-10,
    )


def _lengths(offset: Floats, world: Floats) -> tuple[Floats, Floats]:
    """Squared lengths `[view, N]` of offsets from the centres, and what of them is along the rays."""
    return np.maximum(np.einsum("vin,vin->vn", offset, offset), 1e-18), np.einsum(
        "vin,vin->vn", offset, world
    )


def _error(centres: Floats, points: Floats, world: Floats, precision: Floats) -> Floats:
    """`[view, N]` squared sines in standard deviations; infinite behind the camera, 0 where nothing is seen."""
    square, along = _lengths(points - centres[:, :, None], world)
    error = np.where(along > 0, np.maximum(1 - along * along / square, 0.0) * precision, np.inf)
    return np.where(precision > 0, error, 0.0)


def _normal(world: Floats, weight: Floats) -> tuple[Floats, ...]:
    """Sum w (I - u u') as its six entries xx, xy, xz, yy, yz, zz, each `[N]`."""
    x, y, z = (world[:, i] for i in range(3))
    wx, wy, wz = x * weight, y * weight, z * weight
    total = weight.sum(0)
    xx, yy, zz = (np.einsum("vn,vn->n", a, b) for a, b in ((wx, x), (wy, y), (wz, z)))
    xy, xz, yz = (np.einsum("vn,vn->n", a, b) for a, b in ((wx, y), (wx, z), (wy, z)))
    return total - xx, -xy, -xz, total - yy, -yz, total - zz


def _solved(matrix: tuple[Floats, ...], side: Floats, ridge: float) -> Floats:
    """`[3, N]` solutions of symmetric 3 x 3 systems by cofactors."""
    xx, xy, xz, yy, yz, zz = matrix
    xx, yy, zz = xx + ridge, yy + ridge, zz + ridge
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    d, e, f = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    determinant = xx * a + xy * b + xz * c
    determinant = np.where(np.abs(determinant) > 1e-300, determinant, np.inf)
    return (
        np.stack(
            [
                a * side[0] + b * side[1] + c * side[2],
                b * side[0] + d * side[1] + e * side[2],
                c * side[0] + e * side[1] + f * side[2],
            ]
        )
        / determinant
    )
