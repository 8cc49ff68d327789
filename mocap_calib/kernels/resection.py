"""How poses and projections of a camera fit its detections, compiled.

`resection._compare_block` and `projection_search` define what is computed.
"""

import numpy as np

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.types import Floats, Ints


@inlined
def _cost(
    turn: Floats,
    shift: Floats,
    body: Floats,
    ray: Floats,
    common: Floats,
    precision: float,
    terms: Floats,
) -> float:
    """Return the sum of the costs of the joints that are common to a body and a detection."""
    x, y, z = body[0], body[1], body[2]
    u, v, w = ray[0], ray[1], ray[2]
    xx, xy, xz, x0 = turn[0, 0], turn[0, 1], turn[0, 2], shift[0]
    yx, yy, yz, y0 = turn[1, 0], turn[1, 1], turn[1, 2], shift[1]
    zx, zy, zz, z0 = turn[2, 0], turn[2, 1], turn[2, 2], shift[2]
    for j in range(len(terms)):
        a = xx * x[j] + xy * y[j] + xz * z[j] + x0
        b = yx * x[j] + yy * y[j] + yz * z[j] + y0
        c = zx * x[j] + zy * y[j] + zz * z[j] + z0
        length = np.sqrt(a * a + b * b + c * c)
        length = length if length > 1e-12 else 1e-12
        gap = 2 - 2 * (a * u[j] + b * v[j] + c * w[j]) / length
        square = (gap if gap > 0 else 0.0) * precision
        terms[j] = common[j] * square / (1 + square)
    total = 0.0
    for j in range(len(terms)):
        total += terms[j]
    return total


@kernel(
    "f8[:,:,::1], f8[:,::1], i8[::1], f8[:,:,::1], f8[:,::1], f8[:,:,:,::1], f8[:,:,::1], "
    "f8[::1], i8, f8[:,::1], i8[:,::1]"
)
def compare(
    rotation: Floats,
    translation: Floats,
    frame: Ints,
    rays: Floats,
    seen: Floats,
    bodies: Floats,
    known: Floats,
    tolerance: Floats,
    least_joints: int,
    cost: Floats,
    body: Ints,
) -> None:
    """Set the least cost of each detection under each pose `[pose, detection]`, and its body.

    rays: `[detection, 3, joint]`, seen: `[detection, joint]`; bodies: `[frame, body, 3, joint]`,
    known: `[frame, body, joint]`: 1 where a joint is there, else 0, and any number for it.
    """
    joints = rays.shape[2]
    common, terms = np.empty(joints), np.empty(joints)
    cost[:] = np.inf
    body[:] = 0
    for n in range(len(frame)):
        precision = 1 / tolerance[n] ** 2
        for one in range(bodies.shape[1]):
            count = 0.0
            for j in range(joints):
                common[j] = seen[n, j] * known[frame[n], one, j]
                count += common[j]
            if count < least_joints:
                continue
            there = bodies[frame[n], one]
            for p in range(len(rotation)):
                total = _cost(rotation[p], translation[p], there, rays[n], common, precision, terms)
                if total / count < cost[p, n]:
                    cost[p, n] = total / count
                    body[p, n] = one
        for p in range(len(rotation)):
            if cost[p, n] == np.inf:
                cost[p, n] = np.nan


# --- a projection

_MISSING, _AHEAD, _BEHIND = 0.0, 1.0, 2.0


@inlined
def _project(points: Floats, projection: Floats, seen: Floats) -> None:
    """Set `[3, keypoint]` where points `[keypoint, 3]` are seen, and on which side they are."""
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        for row in range(3):
            seen[row, k] = (
                projection[row, 0] * x
                + projection[row, 1] * y
                + projection[row, 2] * z
                + projection[row, 3]
            )
        depth = seen[2, k]
        ahead = depth > 0
        by = depth if ahead else 1.0
        seen[0, k] /= by
        seen[1, k] /= by
        seen[2, k] = _MISSING if np.isnan(x) else _AHEAD if ahead else _BEHIND


@inlined
def _mean_cost(image: Floats, seen: Floats, square_tolerance: float, least: int) -> float:
    """Return the mean cost of the joints that are known of a detection and a body, 1 of too few."""
    count, total = 0, 0.0
    for k in range(len(image)):
        if seen[2, k] == _MISSING or np.isnan(image[k, 0]):
            continue
        count += 1
        if seen[2, k] == _BEHIND:
            total += 1.0
            continue
        across, down = image[k, 0] - seen[0, k], image[k, 1] - seen[1, k]
        square = (across * across + down * down) / square_tolerance
        total += square / (1 + square)
    return total / count if count >= least else 1.0


@kernel("f8[:,:,:,::1], f8[:,:,:,::1], f8[:,::1], f8, i8, f8[:,:,::1]")
def cost_detections(
    points: Floats,
    image: Floats,
    projection: Floats,
    square_tolerance: float,
    least: int,
    cost: Floats,
) -> None:
    """Set the costs `[frame, instance, individual]`.

    points: `[frame, individual, keypoint, 3]`; image: `[frame, instance, keypoint, 2]`; NaN =
    missing. projection: `[3, 4]`. least: joints that are compared.
    """
    frames, individuals, joints, _ = points.shape
    seen = np.empty((3, joints))
    for frame in range(frames):
        for individual in range(individuals):
            _project(points[frame, individual], projection, seen)
            for instance in range(image.shape[1]):
                cost[frame, instance, individual] = _mean_cost(
                    image[frame, instance], seen, square_tolerance, least
                )
