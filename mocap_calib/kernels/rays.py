"""Rays, and angles between them and points, compiled.

`rays` and `point_covariance` say the same in numpy.
"""

import math

import numpy as np

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.types import Bools, Floats, Ints

LANES = 64  # points at once, of all views in turn
_RIDGE = 1e-10  # as of `symmetric`


@kernel("f8[:,:,::1], f8[:,:,::1], f8[:,:,::1]")
def rays_in_world(rotation: Floats, rays: Floats, world: Floats) -> None:
    """Set rays `[view, 3, N]` in the world's axes, zero where they are missing (NaN).

    rotation: `[view, 3, 3]` from the world to the cameras. rays: `[view, 3, N]` in these.
    """
    for view in range(len(rays)):
        turn, ray, found = rotation[view], rays[view], world[view]
        for n in range(ray.shape[1]):
            x, y, z = ray[0, n], ray[1, n], ray[2, n]
            known = not np.isnan(x + y + z)
            for k in range(3):
                value = turn[0, k] * x + turn[1, k] * y + turn[2, k] * z
                found[k, n] = value if known else 0.0


@kernel("f8[:,:,::1], f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1]")
def ray_angles(
    rotation: Floats,
    translation: Floats,
    points: Floats,
    rays: Floats,
    angle: Floats,
    along: Floats,
) -> None:
    """Set the angles between rays and points, pi where one is missing, and lengths along the rays.

    Both `[view, N]`. rotation: `[view, 3, 3]`; translation: `[view, 3]`; points: `[3, N]`;
    rays: `[view, 3, N]`.
    """
    for view in range(len(rays)):
        turn, shift, ray = rotation[view], translation[view], rays[view]
        for n in range(points.shape[1]):
            px, py, pz = points[0, n], points[1, n], points[2, n]
            x = turn[0, 0] * px + turn[0, 1] * py + turn[0, 2] * pz + shift[0]
            y = turn[1, 0] * px + turn[1, 1] * py + turn[1, 2] * pz + shift[1]
            z = turn[2, 0] * px + turn[2, 1] * py + turn[2, 2] * pz + shift[2]
            rx, ry, rz = ray[0, n], ray[1, n], ray[2, n]
            length = x * rx + y * ry + z * rz
            across_x, across_y, across_z = y * rz - z * ry, z * rx - x * rz, x * ry - y * rx
            square = across_x * across_x + across_y * across_y + across_z * across_z
            along[view, n] = length
            # NaN, of a ray or a point that is missing, is not 0 or more
            angle[view, n] = math.atan2(math.sqrt(square), length) if square >= 0 else math.pi


@inlined
def _count_views(weight: Floats, count: Ints) -> None:
    """Set by how many views points are seen, `[LANES]`; weight: `[view, LANES]`."""
    count[:] = 0
    for view in range(len(weight)):
        for n in range(LANES):
            count[n] += weight[view, n] > 0


@inlined
def _find_meeting(
    centre: Floats, ray: Floats, limit: Floats, point: Floats, meets: Floats, sums: Floats
) -> None:
    """Set to 1 or 0 which rays of a view, `[LANES]`, meet the points, and add them to sums.

    ray, point: `[3, LANES]`. limit: `[LANES]` tangents of angles. meets: the weights, 0 = not
    seen, which are overwritten. sums: `[4, LANES]` of rays and of their number.
    """
    from_x, from_y, from_z = centre[0], centre[1], centre[2]
    for n in range(LANES):
        x, y, z = point[0, n] - from_x, point[1, n] - from_y, point[2, n] - from_z
        rx, ry, rz = ray[0, n], ray[1, n], ray[2, n]
        along = x * rx + y * ry + z * rz
        across_x, across_y, across_z = y * rz - z * ry, z * rx - x * rz, x * ry - y * rx
        square = across_x * across_x + across_y * across_y + across_z * across_z
        # of what is missing (NaN) nothing is less
        near = (along > 0) & (meets[n] > 0) & (math.sqrt(square) < limit[n] * along)
        meets[n] = 1.0 if near else 0.0
        sums[0, n] += meets[n] * rx
        sums[1, n] += meets[n] * ry
        sums[2, n] += meets[n] * rz
        sums[3, n] += meets[n]


@inlined
def _widen(ray: Floats, meets: Floats, sums: Floats, cosine: Floats) -> None:
    """Lower the least cosines `[LANES]` between the mean of rays that meet and each of them."""
    for n in range(LANES):
        x, y, z = sums[0, n], sums[1, n], sums[2, n]
        length = max(math.sqrt(x * x + y * y + z * z), 1e-12)
        own = (ray[0, n] * x + ray[1, n] * y + ray[2, n] * z) / length
        cosine[n] = min(cosine[n], own if meets[n] > 0 else 1.0)


@kernel("f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1], f8, b1[:,::1]")
def agreeing_views(
    centres: Floats,
    points: Floats,
    world: Floats,
    weight: Floats,
    tangents: Floats,
    narrowest: float,
    agree: Bools,
) -> None:
    """Set which views agree on points, `[view, N]`.

    centres: `[view, 3]`. points: `[3, N]`. world: `[view, 3, N]`. weight: `[view, N]`. tangents:
    `[view, count]` of the limits. narrowest: the cosine of the angle from the mean of the rays
    that one of them must exceed.
    """
    views = len(centres)
    rays, meets = np.zeros((views, 3, LANES)), np.zeros((views, LANES))
    place, sums, own = np.zeros((3, LANES)), np.empty((4, LANES)), np.empty((2, LANES))
    limit, cosine, count = own[0], own[1], np.empty(LANES, dtype=np.int64)
    for start in range(0, points.shape[1], LANES):
        end = min(start + LANES, points.shape[1])
        here = end - start
        place[:, :here] = points[:, start:end]
        meets[:, :here] = weight[:, start:end]
        _count_views(meets, count)
        sums[:] = 0.0
        for view in range(views):
            for k in range(3):
                rays[view, k, :here] = world[view, k, start:end]
            for n in range(LANES):
                limit[n] = tangents[view, count[n]]
            _find_meeting(centres[view], rays[view], limit, place, meets[view], sums)
        cosine[:] = 1.0
        for view in range(views):
            _widen(rays[view], meets[view], sums, cosine)
        for n in range(LANES):
            if sums[3, n] < 2 or not cosine[n] < narrowest:
                meets[:, n] = 0.0
        for view in range(views):
            for n in range(here):
                agree[view, start + n] = meets[view, n] > 0


@inlined
def _set_directions(
    n: int, centres: Floats, points: Floats, weight: Floats, direction: Floats, share: Floats
) -> None:
    """Set the unit vectors to a point, and the weights over squared distances, of its views."""
    for view in range(len(centres)):
        share[view] = 0.0
        if weight[view, n] == 0:
            continue
        square = 0.0
        for k in range(3):
            offset = points[k, n] - centres[view, k]
            direction[view, k] = offset
            square += offset * offset
        inverse = 1 / max(square, 1e-300)
        root = math.sqrt(inverse)
        for k in range(3):
            direction[view, k] *= root
        share[view] = weight[view, n] * inverse


@inlined
def _set_covariance(direction: Floats, share: Floats, covariance: Floats) -> None:
    """Set the inverse of sum w (I - u u'), as `symmetric.invert` does."""
    total = xx = xy = xz = yy = yz = zz = 0.0
    for view in range(len(share)):
        if share[view] == 0:
            continue
        x, y, z = direction[view, 0], direction[view, 1], direction[view, 2]
        wx, wy, wz = share[view] * x, share[view] * y, share[view] * z
        total += share[view]
        xx, xy, xz = xx + wx * x, xy + wx * y, xz + wx * z
        yy, yz, zz = yy + wy * y, yz + wy * z, zz + wz * z
    xx, yy, zz = total - xx, total - yy, total - zz
    size = xx + yy + zz
    if size == 0:
        covariance[:] = 0.0
        return
    xx, yy, zz = xx / size + _RIDGE, yy / size + _RIDGE, zz / size + _RIDGE
    xy, xz, yz = -xy / size, -xz / size, -yz / size
    covariance[0], covariance[1] = yy * zz - yz * yz, xz * yz - xy * zz
    covariance[2], covariance[3] = xy * yz - xz * yy, xx * zz - xz * xz
    covariance[4], covariance[5] = xy * xz - xx * yz, xx * yy - xy * xy
    determinant = xx * covariance[0] + xy * covariance[1] + xz * covariance[2]
    if abs(determinant) <= 1e-300:
        determinant = np.inf
    for k in range(6):
        covariance[k] = covariance[k] / determinant / size


@kernel("f8[:,::1], f8[:,::1], f8[:,::1], f8, f8, f8[:,::1]")
def median_angles(
    centres: Floats,
    points: Floats,
    weight: Floats,
    least_share: float,
    untouched: float,
    medians: Floats,
) -> None:
    """Set the medians `[view, N]` of the angles between rays and the points made of them.

    centres: `[view, 3]`; points: `[3, N]`; weight: `[view, N]`. untouched: that of a view that does
    not see the point.
    """
    direction, share = np.empty((len(centres), 3)), np.empty(len(centres))
    covariance = np.empty(6)
    for n in range(points.shape[1]):
        _set_directions(n, centres, points, weight, direction, share)
        _set_covariance(direction, share, covariance)
        xx, xy, xz = covariance[0], covariance[1], covariance[2]
        yy, yz, zz = covariance[3], covariance[4], covariance[5]
        squares = xx * xx + yy * yy + zz * zz + 2 * (xy * xy + xz * xz + yz * yz)
        for view in range(len(centres)):
            medians[view, n] = untouched
            part = share[view]
            if part == 0:
                continue
            x, y, z = direction[view, 0], direction[view, 1], direction[view, 2]
            ax, ay = xx * x + xy * y + xz * z, xy * x + yy * y + yz * z
            az = xz * x + yz * y + zz * z
            straight = x * ax + y * ay + z * az
            taken = part * (xx + yy + zz - straight)
            square = squares - 2 * (ax * ax + ay * ay + az * az) + straight * straight
            mean = max(2 - taken, 2 * least_share)
            squared = max(2 - 2 * taken + part * part * square, 0.5 * mean * mean)
            freedom = min(max(mean * mean / squared, 1.0), 2.0)
            kept = 1 - 2 / (9 * freedom)
            medians[view, n] = math.sqrt(mean * kept * kept * kept)
