"""Rigs of cameras that stand around a room and look into it, in metres."""

from typing import Literal

import numpy as np

from mocap_calib.errors import MismatchError
from mocap_calib.geometry.rotation import looking_along, matrix_from_vector
from mocap_calib.synthetic.config import CAMERA_AIM
from mocap_calib.synthetic.signals import direction
from mocap_calib.types import Camera, CameraRig, Floats

Distortion = Literal["none", "brown", "fisheye"]

_DOWN = np.array([0.0, 0.0, -1.0])


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
    """Return a rig of cameras cam1, cam2, ... that stand around the middle of a room.

    All look at the middle, but no two alike: places, aims, focal lengths and rolls differ by a few
    per cent or degrees.

    radius, height: metres, about; size: (width, height) in pixels; arc_deg: over which the cameras
    are spread; a small arc makes narrow baselines.

    Raises MismatchError.
    """
    if cameras < 1 or radius <= 0 or min(size) <= 0 or not 0 <= arc_deg <= 360:
        raise MismatchError(
            "rig",
            "cameras, radius and size above 0 and an arc of 0..360 degrees",
            f"{cameras}, {radius}, {size}, {arc_deg}",
            "correct that number",
        )
    azimuth = _azimuths(rng, cameras, arc_deg)
    distance = radius * (1 + rng.uniform(-0.08, 0.08, cameras))
    up = height * (1 + rng.uniform(-0.15, 0.15, cameras))
    level = distance[:, None] * direction(azimuth)
    centres = np.concatenate([level, up[:, None]], axis=-1)
    aims = np.array(CAMERA_AIM) + rng.normal(0, [0.25, 0.25, 0.1], (cameras, 3))
    roll = np.radians(rng.normal(0, 2.0, cameras))
    rolled = matrix_from_vector(roll[:, None] * np.array([0.0, 0.0, 1.0]))
    rotation = rolled @ looking_along(aims - centres, _DOWN)
    translation = -np.einsum("vij,vj->vi", rotation, centres)
    made = tuple(_random_camera(rng, f"cam{k + 1}", size, distortion) for k in range(cameras))
    return CameraRig(made, rotation, translation, "m")


def _azimuths(rng: np.random.Generator, cameras: int, arc_deg: float) -> Floats:
    """Return the directions `[camera]` of the cameras from the middle, in radians."""
    # a full ring has as many gaps as cameras, an arc one less
    gaps = cameras if arc_deg == 360 else max(cameras - 1, 1)
    gap = np.radians(arc_deg) / gaps
    start = rng.uniform(0, 2 * np.pi)
    place = np.arange(cameras) + rng.uniform(-0.1, 0.1, cameras)
    return start + gap * place


def _random_camera(
    rng: np.random.Generator, name: str, size: tuple[int, int], distortion: Distortion
) -> Camera:
    """Return a camera about 62 degrees wide, a fisheye about 105."""
    width, height = size
    usual_focal = width * (0.55 if distortion == "fisheye" else 0.85)
    focal = usual_focal * rng.uniform(0.93, 1.07)
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    centre_x, centre_y = middle + rng.uniform(-0.01, 0.01, 2) * width
    focal_y = focal * rng.uniform(0.998, 1.002)
    matrix = np.array([[focal, 0, centre_x], [0, focal_y, centre_y], [0, 0, 1]])
    coefficients = _random_coefficients(rng, distortion)
    return Camera(
        name=name,
        size=size,
        matrix=matrix,
        distortion=coefficients,
        fisheye=distortion == "fisheye",
    )


def _random_coefficients(rng: np.random.Generator, distortion: Distortion) -> Floats:
    """Return distortion coefficients, as in OpenCV: `[5]`, or `[4]` of a fisheye.

    The distorted radius grows with the radius everywhere: nothing folds back into the image.
    Brown: 1 + 3 k1 r^2 + 5 k2 r^4 > 0 for all r, since 9 k1^2 < 20 k2. Fisheye: likewise up to 90
    degrees.
    """
    if distortion == "none":
        return np.zeros(5)
    if distortion == "brown":
        k1, k2 = rng.uniform(-0.28, -0.18), rng.uniform(0.06, 0.1)
        p1, p2 = rng.normal(0, 5e-4, 2)
        return np.array([k1, k2, p1, p2, 0.0])
    k1, k2 = rng.uniform(-0.04, -0.01), rng.uniform(-0.002, 0.002)
    return np.array([k1, k2, 0.0, 0.0])
