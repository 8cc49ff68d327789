"""Lenses as in OpenCV, by component: `[2, N]` pixels, `[3, N]` points and rays. NaN stays NaN.

Written out, because whole recordings go through: ten times faster than cv2, and without its
failures (its fixed-point iteration diverges at strong lenses; its fisheye inverse returns
tan(theta), which breaks near 90 degrees).
"""

import numpy as np

from mocap_calib.config import LENS_MISS_PX
from mocap_calib.geometry import brown_conrady, kannala_brandt
from mocap_calib.types import Camera, Floats


def project(camera: Camera, points: Floats) -> Floats:
    """Return the pixels `[2, N]` of points `[3, N]` in the camera's axes; NaN behind the camera."""
    focal, middle = _focal_and_middle(camera)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        depth = np.where(points[2] > 1e-9, points[2], np.nan)
        image = points[:2] / depth
        if camera.fisheye:
            image = kannala_brandt.distort(kannala_brandt.coefficients(camera), image)
        elif camera.distortion.any():
            image = brown_conrady.distort(brown_conrady.coefficients(camera), image)
        return focal[:, None] * image + middle[:, None]


def unproject(camera: Camera, pixels: Floats) -> Floats:
    """Return the unit rays `[3, N]` of pixels `[2, N]`, with the distortion taken out.

    NaN where no ray has the pixel.
    """
    focal, middle = _focal_and_middle(camera)
    miss = LENS_MISS_PX / focal.max()
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        image = (pixels - middle[:, None]) / focal[:, None]
        if camera.fisheye:
            return kannala_brandt.rays(kannala_brandt.coefficients(camera), image, miss=miss)
        if camera.distortion.any():
            image = brown_conrady.undistort(brown_conrady.coefficients(camera), image, miss=miss)
        length = 1 / np.sqrt(1 + image[0] ** 2 + image[1] ** 2)
        return np.concatenate([image * length, length[None]])


def _focal_and_middle(camera: Camera) -> tuple[Floats, Floats]:
    """Return the focal lengths `[2]` and the principal point `[2]` in pixels."""
    return camera.matrix[[0, 1], [0, 1]], camera.matrix[:2, 2]
