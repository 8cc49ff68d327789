"""Rigs of cameras that stand around a room and look into it, in metres."""

from typing import Literal

import numpy as np

from mocap_calib.errors import MismatchError
from mocap_calib.geometry.rotation import looking_along, matrix_from_vector
from mocap_calib.types import Camera, CameraRig, Floats

Distortion = Literal["none", "brown", "fisheye"]

_DOWN = np.array([0.0, 0.0, -1.0])
_AIM = np.array([0.0, 0.0, 0.9])  # the middle of the people in the room


def ring_rig(
    rng: np.random.Generator,
    *,
    cameras: int,
    radius: float,
    height: float,
    size: tuple[int, int],
    distortion: Distortion,
    arc_deg: float = 360.0,
) -> CameraRig:
    """Cameras cam1, cam2, ... at `radius` and `height` metres (about), spread over `arc_deg` around the room's middle.

    All look at the middle, but no two alike: places, aims, focal lengths and rolls differ by a few per cent or
    degrees. A small arc makes narrow baselines. size: (width, height) in pixels. Raises MismatchError.
    """
    if cameras < 1 or radius <= 0 or min(size) <= 0 or not 0 <= arc_deg <= 360:
        raise MismatchError(
            f"rig: expected cameras, radius and size above 0 and an arc of 0..360 degrees, got {cameras}, {radius}, {size}, {arc_deg}"
        )
    # a full ring has as many gaps as cameras, an arc one less
    gaps = cameras if arc_deg == 360 else max(cameras - 1, 1)
    gap = np.radians(arc_deg) / gaps
    azimuth = rng.uniform(0, 2 * np.pi) + gap * (
        np.arange(cameras) + rng.uniform(-0.1, 0.1, cameras)
    )
    out = radius * (1 + rng.uniform(-0.08, 0.08, cameras))
    up = height * (1 + rng.uniform(-0.15, 0.15, cameras))
    centres = np.stack([out * np.cos(azimuth), out * np.sin(azimuth), up], axis=-1)
    aims = _AIM + rng.normal(0, [0.25, 0.25, 0.1], (cameras, 3))
    roll = np.radians(rng.normal(0, 2.0, cameras))
    rotation = matrix_from_vector(roll[:, None] * np.array([0.0, 0.0, 1.0])) @ looking_along(
        aims - centres, _DOWN
    )
    translation = -np.einsum("vij,vj->vi", rotation, centres)
    made = tuple(_camera(rng, f"cam{k + 1}", size, distortion) for k in range(cameras))
    return CameraRig(made, rotation, translation, "m")


def _camera(
    rng: np.random.Generator, name: str, size: tuple[int, int], distortion: Distortion
) -> Camera:
    """About 62 degrees wide, a fisheye about 105."""
    width, height = size
    focal = width * (0.55 if distortion == "fisheye" else 0.85) * rng.uniform(0.93, 1.07)
    middle = np.array([(width - 1) / 2, (height - 1) / 2]) + rng.uniform(-0.01, 0.01, 2) * width
    matrix = np.array(
        [[focal, 0, middle[0]], [0, focal * rng.uniform(0.998, 1.002), middle[1]], [0, 0, 1]]
    )
    return Camera(name, size, matrix, _coefficients(rng, distortion), distortion == "fisheye")


def _coefficients(rng: np.random.Generator, distortion: Distortion) -> Floats:
    """Such that the distorted radius grows with the radius everywhere: nothing folds back into the image.

    Brown: 1 + 3 k1 r^2 + 5 k2 r^4 > 0 for all r, since 9 k1^2 < 20 k2. Fisheye: likewise up to 90 degrees.
    """
    if distortion == "none":
        return np.zeros(5)
    if distortion == "brown":
        return np.array(
            [rng.uniform(-0.28, -0.18), rng.uniform(0.06, 0.1), *rng.normal(0, 5e-4, 2), 0.0]
        )
    return np.array([rng.uniform(-0.04, -0.01), rng.uniform(-0.002, 0.002), 0.0, 0.0])
