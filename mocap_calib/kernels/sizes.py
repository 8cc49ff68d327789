"""How far bodies are by how large they look, compiled: `view_pair` defines what is computed."""

import math

import numpy as np

from mocap_calib.kernels.jit import kernel
from mocap_calib.types import Floats


@kernel("f8[:,:,::1], f8[::1]")
def distances_by_size(rays: Floats, distance: Floats) -> None:
    """Set the distances `[N]` of bodies of the rays `[N, keypoint, 3]`, NaN = missing."""
    for n in range(len(rays)):
        x = y = z = 0.0
        count = 0
        for k in range(rays.shape[1]):
            if not np.isnan(rays[n, k, 0]):
                count += 1
                x += rays[n, k, 0]
                y += rays[n, k, 1]
                z += rays[n, k, 2]
        square = 0.0
        if count:
            x, y, z = x / count, y / count, z / count
            square = 1 - (x * x + y * y + z * z)
        distance[n] = math.sqrt(2 / 3) / math.sqrt(max(square, 1e-8))
