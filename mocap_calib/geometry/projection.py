"""Pixels and rays of a camera, for arrays of any shape.

Pixels have their centres at integers. Rays are unit vectors in the camera's axes: x right, y down, z forward.
"""

import numpy as np

from mocap_calib.geometry import lens
from mocap_calib.types import Camera, Floats, Reals

_BLOCK = 8192  # what is computed of so many stays in the cache


def rays_from_pixels(camera: Camera, pixels: Reals) -> Floats:
    """`[..., 2]` pixels -> `[..., 3]` unit rays with the distortion taken out; NaN stays NaN, and what no ray projects to is NaN."""
    flat = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    rays = np.empty((len(flat), 3))
    for k in range(0, len(flat), _BLOCK):
        rays[k : k + _BLOCK] = lens.rays(camera, flat[k : k + _BLOCK].T.copy()).T
    return rays.reshape(*pixels.shape[:-1], 3)


def pixels_from_points(camera: Camera, points: Floats) -> Floats:
    """`[..., 3]` points in the camera's axes -> `[..., 2]` pixels; NaN stays NaN, and behind the camera is NaN."""
    flat = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    pixels = np.empty((len(flat), 2))
    for k in range(0, len(flat), _BLOCK):
        pixels[k : k + _BLOCK] = lens.pixels(camera, flat[k : k + _BLOCK].T.copy()).T
    return pixels.reshape(*points.shape[:-1], 2)
