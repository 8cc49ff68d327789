"""Rays of many views: angles between them and points, and how sure points are."""

import math

import numpy as np

from mocap_calib.kernels.algebra import add_across, cross, invert, is_number, multiply, turn
from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.types import Bools, Floats

_ROWS = ((0, 1, 2), (1, 3, 4), (2, 4, 5))  # of a symmetric matrix, by entries


@kernel("f8[:,:,::1], f8[:,:,::1], f8[:,:,::1]")
def rays_in_world(rotation: Floats, rays: Floats, world: Floats) -> None:
    """Set rays `[view, 3, N]` in the world's axes, zero where they are missing (NaN).

    rotation: `[view, 3, 3]` from the world to the cameras. rays: `[view, 3, N]` in these.
    """
    for view in range(len(rays)):
        back, ray, found = rotation[view].T, rays[view], world[view]
        for n in range(ray.shape[1]):
            x, y, z = turn(back, ray[0, n], ray[1, n], ray[2, n])
            known = is_number(x, y, z)
            found[0, n] = x if known else 0.0
            found[1, n] = y if known else 0.0
            found[2, n] = z if known else 0.0


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
        shift, ray = translation[view], rays[view]
        for n in range(points.shape[1]):
            x, y, z = turn(rotation[view], points[0, n], points[1, n], points[2, n])
            x, y, z = x + shift[0], y + shift[1], z + shift[2]
            rx, ry, rz = ray[0, n], ray[1, n], ray[2, n]
            length = x * rx + y * ry + z * rz
            x, y, z = cross(x, y, z, rx, ry, rz)
            square = x * x + y * y + z * z
            along[view, n] = length
            # NaN, of a ray or a point that is missing, is not 0 or more
            angle[view, n] = math.atan2(math.sqrt(square), length) if square >= 0 else math.pi


@inlined
def _meets(
    centre: Floats, x: float, y: float, z: float, ray: tuple[float, float, float], tangent: float
) -> bool:
    """Return whether a ray passes a point in front of the view within a tangent of the angle."""
    x, y, z = x - centre[0], y - centre[1], z - centre[2]
    along = x * ray[0] + y * ray[1] + z * ray[2]
    x, y, z = cross(x, y, z, ray[0], ray[1], ray[2])
    return along > 0 and math.sqrt(x * x + y * y + z * z) < tangent * along


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
    for n in range(points.shape[1]):
        seen = meeting = 0
        for view in range(views):
            seen += weight[view, n] > 0
        x = y = z = 0.0
        for view in range(views):
            ray = world[view, 0, n], world[view, 1, n], world[view, 2, n]
            here = weight[view, n] > 0 and _meets(
                centres[view], points[0, n], points[1, n], points[2, n], ray, tangents[view, seen]
            )
            agree[view, n] = here
            if here:
                meeting += 1
                x, y, z = x + ray[0], y + ray[1], z + ray[2]
        length = max(math.sqrt(x * x + y * y + z * z), 1e-12)
        cosine = 1.0
        for view in range(views):
            if agree[view, n]:
                own = world[view, 0, n] * x + world[view, 1, n] * y + world[view, 2, n] * z
                cosine = min(cosine, own / length)
        if meeting < 2 or not cosine < narrowest:
            agree[:, n] = False


@inlined
def _direction(centre: Floats, points: Floats, n: int) -> tuple[float, float, float, float]:
    """Return the unit vector from a centre to a point, and the inverse of the squared distance."""
    x, y, z = points[0, n] - centre[0], points[1, n] - centre[1], points[2, n] - centre[2]
    inverse = 1 / max(x * x + y * y + z * z, 1e-300)
    root = math.sqrt(inverse)
    return x * root, y * root, z * root, inverse


@kernel("f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1], f8[::1], f8, f8[:,::1]")
def covariances(
    centres: Floats,
    points: Floats,
    world: Floats,
    precision: Floats,
    variance: Floats,
    loss_scale: float,
    found: Floats,
) -> None:
    """Set the entries `[6, N]` of the covariances of points `[3, N]`: N^-1 (sum w^2 s^2 J'J) N^-1.

    centres: `[view, 3]`. world: `[view, 3, N]`. precision: `[view, N]`. variance: `[view]`.
    """
    by_weight, by_error, inverse = np.empty(6), np.empty(6), np.empty(6)
    for n in range(points.shape[1]):
        by_weight[:], by_error[:] = 0.0, 0.0
        for view in range(len(centres)):
            if precision[view, n] > 0:
                x, y, z, inverse_square = _direction(centres[view], points, n)
                along = x * world[view, 0, n] + y * world[view, 1, n] + z * world[view, 2, n]
                error = max(1 - along * along, 0.0) * precision[view, n]
                weight = precision[view, n] / (1 + error / loss_scale**2) ** 2
                add_across(by_weight, weight * inverse_square, x, y, z)
                add_across(by_error, weight**2 * variance[view] * inverse_square, x, y, z)
        invert(by_weight, inverse)
        for row in _ROWS:
            x, y, z = multiply(by_error, inverse[row[0]], inverse[row[1]], inverse[row[2]])
            x, y, z = multiply(inverse, x, y, z)
            found[row[0], n], found[row[1], n], found[row[2], n] = x, y, z


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
    information, c = np.empty(6), np.empty(6)
    for n in range(points.shape[1]):
        information[:] = 0.0
        for view in range(len(centres)):
            if weight[view, n] > 0:
                x, y, z, inverse_square = _direction(centres[view], points, n)
                add_across(information, weight[view, n] * inverse_square, x, y, z)
        invert(information, c)
        trace = c[0] + c[3] + c[5]
        squares = c[0] ** 2 + c[3] ** 2 + c[5] ** 2 + 2 * (c[1] ** 2 + c[2] ** 2 + c[4] ** 2)
        for view in range(len(centres)):
            medians[view, n] = untouched
            if weight[view, n] > 0:
                x, y, z, inverse_square = _direction(centres[view], points, n)
                part = weight[view, n] * inverse_square
                ax, ay, az = multiply(c, x, y, z)
                straight = x * ax + y * ay + z * az
                taken = part * (trace - straight)
                square = squares - 2 * (ax * ax + ay * ay + az * az) + straight * straight
                mean = max(2 - taken, 2 * least_share)
                squared = max(2 - 2 * taken + part * part * square, 0.5 * mean * mean)
                freedom = min(max(mean * mean / squared, 1.0), 2.0)
                medians[view, n] = math.sqrt(mean * (1 - 2 / (9 * freedom)) ** 3)
