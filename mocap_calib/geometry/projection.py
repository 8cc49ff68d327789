"""Pixels and rays of a camera, for arrays of any shape.

Pixels have their centres at integers. Rays are unit vectors in the camera's axes: x right, y down,
z forward.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from mocap_calib.geometry import lens
from mocap_calib.records import as_array
from mocap_calib.types import Camera, CameraRig, Floats, Reals

_BLOCK = 8192  # what is computed of so many stays in the cache


def rays_from_pixels(camera: Camera, pixels: Reals) -> Floats:
    """Return the unit rays `[..., 3]` of pixels `[..., 2]`, with the distortion taken out.

    NaN stays NaN, and a pixel that no ray projects to is NaN.
    """
    rows = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    rays = _convert_in_blocks(lens.unproject, camera, rows, width=3)
    return rays.reshape(*pixels.shape[:-1], 3)


def pixels_from_points(camera: Camera, points: Floats) -> Floats:
    """Return the pixels `[..., 2]` of points `[..., 3]` in the camera's axes.

    NaN stays NaN, and a point behind the camera is NaN.
    """
    rows = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    pixels = _convert_in_blocks(lens.project, camera, rows, width=2)
    return pixels.reshape(*points.shape[:-1], 2)


def project(rig: CameraRig, points: ArrayLike) -> Floats:
    """Return the pixels `[view, ..., 2]` of points `[..., 3]` in world coordinates.

    The distortion of the lenses is applied. NaN stays NaN, and a point behind a camera is NaN
    there. Pixels outside the image are returned like any other.

    Raises ValueError where the last axis of the points is not 3.
    """
    world = as_array("points", points, float, *np.shape(points)[:-1], 3)
    views = zip(rig.cameras, rig.rotation, rig.translation, strict=True)
    return np.stack(
        [
            pixels_from_points(camera, world @ rotation.T + translation)
            for camera, rotation, translation in views
        ]
    )


def _convert_in_blocks(
    convert: Callable[[Camera, Floats], Floats], camera: Camera, rows: Floats, *, width: int
) -> Floats:
    """Return `[N, width]` rows, converted by a function that takes and returns components."""
    converted = np.empty((len(rows), width))
    for start in range(0, len(rows), _BLOCK):
        block = slice(start, start + _BLOCK)
        converted[block] = convert(camera, rows[block].T.copy()).T
    return converted
