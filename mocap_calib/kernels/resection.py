"""How projections of a camera fit its detections, compiled.

`tests/oracles/adjust.py` defines what is computed.
"""

import numpy as np

from mocap_calib.kernels.jit import inlined, kernel
from mocap_calib.types import Floats, Ints


@inlined
def _cost(projection: Floats, joints: Floats, count: int, precision: float) -> float:
    """Return the sum of the costs of joints: rows x y z of a body, and u v of a detection."""
    total = 0.0
    for j in range(count):
        x, y, z = joints[0, j], joints[1, j], joints[2, j]
        row = projection[2]
        depth = row[0] * x + row[1] * y + row[2] * z + row[3]
        if depth <= 1e-12:
            total += 1.0
            continue
        row = projection[0]
        across = (row[0] * x + row[1] * y + row[2] * z + row[3]) / depth - joints[3, j]
        row = projection[1]
        down = (row[0] * x + row[1] * y + row[2] * z + row[3]) / depth - joints[4, j]
        square = (across * across + down * down) * precision
        total += square / (1 + square)
    return total


@kernel("f8[:,:,::1], i8[::1], f8[:,:,::1], f8[:,:,:,::1], f8[::1], i8, f8[:,::1], i8[:,::1]")
def compare(
    projection: Floats,
    frame: Ints,
    image: Floats,
    bodies: Floats,
    tolerance: Floats,
    least_joints: int,
    cost: Floats,
    body: Ints,
) -> None:
    """Set the least cost of each detection under each projection, and its body.

    Both `[projection, detection]`. projection: `[projection, 3, 4]`; image: `[detection, 2, joint]`
    and bodies: `[frame, body, 3, joint]`, NaN = missing.
    """
    joints = np.empty((5, image.shape[2]))
    cost[:] = np.inf
    body[:] = 0
    for n in range(len(frame)):
        precision = 1 / tolerance[n] ** 2
        for one in range(bodies.shape[1]):
            there, count = bodies[frame[n], one], 0
            for j in range(image.shape[2]):
                if np.isnan(there[0, j]) or np.isnan(image[n, 0, j]):
                    continue
                for k in range(3):
                    joints[k, count] = there[k, j]
                joints[3, count], joints[4, count] = image[n, 0, j], image[n, 1, j]
                count += 1
            if count < least_joints:
                continue
            for p in range(len(projection)):
                mean = _cost(projection[p], joints, count, precision) / count
                if mean < cost[p, n]:
                    cost[p, n] = mean
                    body[p, n] = one
        for p in range(len(projection)):
            if cost[p, n] == np.inf:
                cost[p, n] = np.nan
