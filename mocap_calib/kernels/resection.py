"""How poses of a camera fit its detections, compiled.

`resection._compare_block` defines what is computed.
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
