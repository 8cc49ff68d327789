"""Points from the rays of many views, compiled: `intersection` defines what is computed.

All steps of `LANES` points are done before those of the next ones, of all views in turn.
"""

import numpy as np

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.types import Bools, Floats, Ints

LANES = 64  # points at once
_RIDGE = 1e-10  # as of `symmetric`


@inlined
def _take_lanes(
    start: int, world: Floats, seen: Floats, ray: Floats, precision: Floats, count: Ints
) -> None:
    """Set the rays of points from a start on, `[view, 3, LANES]`, and by how many views are seen.

    precision: `[view, LANES]`. count: `[LANES]`. Beyond the points there is nothing.
    """
    here = min(LANES, world.shape[2] - start)
    count[:] = 0
    for view in range(len(world)):
        for k in range(3):
            ray[view, k, :here] = world[view, k, start : start + here]
            ray[view, k, here:] = 0.0
        precision[view, :here] = seen[view, start : start + here]
        precision[view, here:] = 0.0
        for n in range(LANES):
            count[n] += precision[view, n] > 0


@inlined
def _add_offsets(
    centre: Floats, ray: Floats, weight: Floats, by_total: Floats, point: Floats, sums: Floats
) -> None:
    """Add w (I - u u') of a view to sums `[9, LANES]`, and w (o - u'o u) of offsets from it.

    w: the weight times `by_total`, which is 1 over the sum of the weights of all views.
    """
    from_x, from_y, from_z = centre[0], centre[1], centre[2]
    for n in range(LANES):
        x, y, z = ray[0, n], ray[1, n], ray[2, n]
        to_x, to_y, to_z = point[0, n] - from_x, point[1, n] - from_y, point[2, n] - from_z
        share = weight[n] * by_total[n]
        wx, wy, wz = share * x, share * y, share * z
        along = to_x * x + to_y * y + to_z * z
        sums[0, n] += share - wx * x
        sums[1, n] -= wx * y
        sums[2, n] -= wx * z
        sums[3, n] += share - wy * y
        sums[4, n] -= wy * z
        sums[5, n] += share - wz * z
        sums[6, n] += share * to_x - along * wx
        sums[7, n] += share * to_y - along * wy
        sums[8, n] += share * to_z - along * wz


@inlined
def _step_back(sums: Floats, point: Floats) -> None:
    """Take the solution of each system from a point `[3, LANES]`, as `symmetric.solve` finds it."""
    for n in range(LANES):
        xy, xz, yz = sums[1, n], sums[2, n], sums[4, n]
        xx, yy, zz = sums[0, n] + _RIDGE, sums[3, n] + _RIDGE, sums[5, n] + _RIDGE
        a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        d, e, f = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
        determinant = xx * a + xy * b + xz * c
        inverse = 1 / determinant if abs(determinant) > 1e-300 else 0.0
        x, y, z = sums[6, n], sums[7, n], sums[8, n]
        point[0, n] -= (a * x + b * y + c * z) * inverse
        point[1, n] -= (b * x + d * y + e * z) * inverse
        point[2, n] -= (c * x + e * y + f * z) * inverse


@inlined
def _measure_lanes(
    centre: Floats, ray: Floats, precision: Floats, point: Floats, error: Floats
) -> None:
    """Set the squared sines `[LANES]` of a view, infinite behind it, 0 where nothing is seen."""
    from_x, from_y, from_z = centre[0], centre[1], centre[2]
    for n in range(LANES):
        x, y, z = point[0, n] - from_x, point[1, n] - from_y, point[2, n] - from_z
        along = x * ray[0, n] + y * ray[1, n] + z * ray[2, n]
        length = max(x * x + y * y + z * z, 1e-18)
        error[n] = max(1 - along * along / length, 0.0) * precision[n]
        if not along > 0 and precision[n] > 0:
            error[n] = np.inf


@inlined
def _weigh_lanes(
    centre: Floats,
    ray: Floats,
    precision: Floats,
    point: Floats,
    scale: float,
    weight: Floats,
    total: Floats,
) -> None:
    """Set the weights `[LANES]` of a view under the loss of Geman and McClure, and add them up."""
    from_x, from_y, from_z = centre[0], centre[1], centre[2]
    narrow = 1 / scale**2
    for n in range(LANES):
        x, y, z = point[0, n] - from_x, point[1, n] - from_y, point[2, n] - from_z
        along = x * ray[0, n] + y * ray[1, n] + z * ray[2, n]
        square = max(x * x + y * y + z * z, 1e-18)
        # (1 + error / scale^2) times the squared distance: one division in all
        loss = square + max(square - along * along, 0.0) * precision[n] * narrow
        weight[n] = precision[n] * square / (loss * loss)
        total[n] += weight[n]


@inlined
def _invert_total(total: Floats) -> None:
    """Set 1 over each of the totals `[LANES]`."""
    for n in range(LANES):
        total[n] = 1 / max(total[n], 1e-300)


@inlined
def _intersect_lanes(
    centres: Floats,
    ray: Floats,
    precision: Floats,
    steps: Floats,
    weight: Floats,
    total: Floats,
    sums: Floats,
    point: Floats,
) -> None:
    """Set points `[3, LANES]` in closed form, and take a Gauss-Newton step at each scale."""
    total[:] = sums[:] = point[:] = 0.0
    for view in range(len(centres)):
        for n in range(LANES):
            total[n] += precision[view, n]
    _invert_total(total)
    for view in range(len(centres)):  # from anywhere a step on lines leads to the same point
        _add_offsets(centres[view], ray[view], precision[view], total, point, sums)
    _step_back(sums, point)
    for scale in steps:
        total[:] = sums[:] = 0.0
        for view in range(len(centres)):
            _weigh_lanes(
                centres[view], ray[view], precision[view], point, scale, weight[view], total
            )
        _invert_total(total)
        for view in range(len(centres)):
            _add_offsets(centres[view], ray[view], weight[view], total, point, sums)
        _step_back(sums, point)


@inlined
def _find_doubtful(
    centres: Floats,
    ray: Floats,
    precision: Floats,
    count: Ints,
    doubtful: float,
    point: Floats,
    error: Floats,
    doubt: Bools,
) -> None:
    """Set which points `[LANES]` of three and more rays have one that does not meet there.

    error: `[LANES]`, is overwritten.
    """
    doubt[:] = False
    for view in range(len(centres)):
        _measure_lanes(centres[view], ray[view], precision[view], point, error)
        for n in range(LANES):
            doubt[n] = doubt[n] or error[n] > doubtful * count[n]
    for n in range(LANES):
        doubt[n] = doubt[n] and count[n] > 2


@kernel("f8[:,::1], f8[:,:,::1], f8[:,::1], f8[::1], f8, f8[:,::1], b1[::1]")
def intersect_rays(
    centres: Floats,
    world: Floats,
    seen: Floats,
    steps: Floats,
    doubtful: float,
    points: Floats,
    doubts: Bools,
) -> None:
    """Set points `[3, N]` nearest to rays, and which have rays that do not all meet there.

    centres `[view, 3]`, world `[view, 3, N]` and seen `[view, N]`: as of `intersection._Rays`.
    steps: scales of the loss at each step. doubtful: INTERSECT_DOUBTFUL. doubts: `[N]`.
    """
    views = len(centres)
    rays, precision = np.empty((views, 3, LANES)), np.empty((views, LANES))
    weight, sums, total = np.empty((views, LANES)), np.empty((9, LANES)), np.empty(LANES)
    count, doubt = np.empty(LANES, dtype=np.int64), np.empty(LANES, dtype=np.bool_)
    place = np.empty((3, LANES))
    for start in range(0, points.shape[1], LANES):
        _take_lanes(start, world, seen, rays, precision, count)
        _intersect_lanes(centres, rays, precision, steps, weight, total, sums, place)
        _find_doubtful(centres, rays, precision, count, doubtful, place, total, doubt)
        for n in range(min(LANES, points.shape[1] - start)):
            doubts[start + n] = doubt[n]
            for k in range(3):
                points[k, start + n] = place[k, n] if count[n] > 1 else np.nan
