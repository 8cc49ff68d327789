"""Lenses as in OpenCV, by component: `[2, N]` pixels, `[3, N]` points and rays. NaN stays NaN.

Written out, because whole recordings go through: ten times faster than cv2, and without its
failures (its fixed-point iteration diverges at strong lenses; its fisheye inverse returns
tan(theta), which breaks near 90 degrees).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mocap_calib.compute.parallel import do_in_threads
from mocap_calib.config import LENS_MISS_PX
from mocap_calib.geometry import brown_conrady, kannala_brandt
from mocap_calib.kernels import lens as kernels
from mocap_calib.types import Camera, Floats

# Of one call, or of one view where it has more: each call waits for Python's lock.
_PIXELS = 1 << 18


class Slopes(NamedTuple):
    """How pixels move with what they are images of.

    image: `[2, 2, N]` by the points of the plane z = 1.
    log_focal: `[2, N]` by the logarithm of the focal lengths. k1: `[2, N]` by that coefficient.
    """

    image: Floats
    log_focal: Floats
    k1: Floats


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
    rays = np.empty((1, 3, pixels.shape[1]))
    _set_rays((camera,), np.ascontiguousarray(pixels, np.float64)[None], rays)
    return rays[0]


def unproject_views(cameras: Sequence[Camera], pixels: Floats, *, by_component: bool) -> Floats:
    """Return the unit rays of pixels `[view, N, 2]` of each camera, as of `unproject`.

    `[view, 3, N]` by component, or else `[view, N, 3]`.
    """
    views, count, _ = pixels.shape
    rays = np.empty((views, 3, count) if by_component else (views, count, 3))
    rows = np.ascontiguousarray(pixels, np.float64)
    _set_rays(cameras, rows.swapaxes(1, 2), rays if by_component else rays.swapaxes(1, 2))
    return rays


def _set_rays(cameras: Sequence[Camera], pixels: Floats, rays: Floats) -> None:
    """Set the rays `[view, 3, N]` of pixels `[view, 2, N]`; those of several views in one call.

    Either is in C order, or was before its last two axes were swapped.
    """
    each = max(1, _PIXELS // max(1, pixels.shape[-1]))

    def work(first: int) -> None:
        some = slice(first, first + each)
        _set_rays_of_some(cameras[some], pixels[some], rays[some])

    do_in_threads(work, range(0, len(cameras), each))


def _set_rays_of_some(cameras: Sequence[Camera], pixels: Floats, rays: Floats) -> None:
    """Do what `_set_rays` does, on one thread."""
    doubtful = np.ones((len(cameras), pixels.shape[-1]), dtype=bool)
    intrinsics, lenses = parameters(cameras)
    misses = (LENS_MISS_PX / intrinsics[:, :2].max(-1)).tolist()
    limits = [
        brown_conrady.limits_of_newton(k, miss=miss) for k, miss in zip(lenses, misses, strict=True)
    ]
    strides = [axis // 8 for array in (pixels, rays) for axis in array.strides[:0:-1]]
    kernels.unproject(
        _flat(pixels),
        intrinsics,
        np.array(lenses),
        np.array([_newton_steps(camera) for camera in cameras]),
        np.array(limits),
        np.array(strides),
        _flat(rays),
        doubtful,
    )
    for view in np.flatnonzero(doubtful.any(1)).tolist():
        lost = slice(None) if doubtful[view].all() else doubtful[view]
        rays[view][:, lost] = _unproject(cameras[view], pixels[view][:, lost])


def parameters(
    cameras: Sequence[Camera],
) -> tuple[Floats, list[brown_conrady.Coefficients]]:
    """Return focal lengths and principal points `[view, 4]`, and the coefficients of lenses."""
    intrinsics = np.stack([np.concatenate(_focal_and_middle(camera)) for camera in cameras])
    return intrinsics, [brown_conrady.coefficients(camera) for camera in cameras]


def _flat(array: Floats) -> Floats:
    """Return all numbers of an array in the order in which they lie in memory, without a copy."""
    return (array if array.flags.c_contiguous else array.swapaxes(1, 2)).reshape(-1)


def _newton_steps(camera: Camera) -> int:
    """Return the steps that the kernel takes, -1 where it does not know the lens."""
    if camera.fisheye:
        return -1
    return brown_conrady.NEWTON_STEPS if camera.distortion.any() else 0


def _unproject(camera: Camera, pixels: Floats) -> Floats:
    """Return what `unproject` returns."""
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


def image_slopes(camera: Camera, image: Floats) -> Slopes:
    """Return the derivatives of the pixels of points `[2, N]` of the plane z = 1."""
    focal, _ = _focal_and_middle(camera)
    if camera.fisheye:
        fisheye = kannala_brandt.coefficients(camera)
        distorted = kannala_brandt.distort(fisheye, image)
        by_image = kannala_brandt.jacobian(fisheye, image)
        by_k1 = kannala_brandt.slope_by_k1(image)
    else:
        brown = brown_conrady.coefficients(camera)
        distorted = brown_conrady.distort(brown, image)
        by_image = brown_conrady.jacobian(brown, image)
        by_k1 = brown_conrady.slope_by_k1(brown, image)
    return Slopes(
        image=focal[:, None, None] * by_image,
        log_focal=focal[:, None] * distorted,
        k1=focal[:, None] * by_k1,
    )


def change_intrinsics(camera: Camera, *, log_focal: float, k1: float) -> Camera:
    """Return the camera with other intrinsics.

    log_focal is added to the logarithm of both focal lengths, and k1 to the first coefficient of
    the lens.
    """
    matrix = camera.matrix.copy()
    matrix[[0, 1], [0, 1]] *= np.exp(log_focal)
    distortion = camera.distortion.copy()
    if not len(distortion):
        distortion = np.zeros(4 if camera.fisheye else 5)
    distortion[0] += k1
    return replace(camera, matrix=matrix, distortion=distortion)


def _focal_and_middle(camera: Camera) -> tuple[Floats, Floats]:
    """Return the focal lengths `[2]` and the principal point `[2]` in pixels."""
    return camera.matrix[[0, 1], [0, 1]], camera.matrix[:2, 2]
