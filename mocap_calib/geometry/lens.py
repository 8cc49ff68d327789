"""Lenses as in OpenCV, by component: `[2, N]` pixels, `[3, N]` points and rays. NaN stays NaN.

Compiled, because whole recordings go through: ten times faster than cv2, and without its failures
(its fixed-point iteration diverges at strong lenses; its fisheye inverse returns tan(theta), which
breaks near 90 degrees).
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from mocap_calib.compute.parallel import do_in_threads
from mocap_calib.config import LENS_MISS_PX
from mocap_calib.kernels import lens as kernels
from mocap_calib.kernels.loading import contiguous
from mocap_calib.types import Camera, Floats

# Of one call, or of one view where it has more: each call waits for Python's lock.
_PIXELS = 1 << 18


class Slopes(NamedTuple):
    """How pixels move with what they are images of.

    image: `[2, 2, N]` by the points of the plane z = 1, which is symmetric but for focal lengths.
    log_focal: `[2, N]` by the logarithm of the focal lengths. k1: `[2, N]` by that coefficient.
    """

    image: Floats
    log_focal: Floats
    k1: Floats


def rows(cameras: Sequence[Camera]) -> Floats:
    """Return the lenses `[view, 14]` as kernels take them, see `kernels.lens`."""
    found = np.zeros((len(cameras), 14))
    for row, camera in zip(found, cameras, strict=True):
        coefficients = camera.distortion[: 4 if camera.fisheye else 8]
        row[:2] = kernels.FISHEYE if camera.fisheye else 1.0, 1.0
        row[2:4], row[4:6] = camera.matrix[[0, 1], [0, 1]], camera.matrix[:2, 2]
        row[6 : 6 + len(coefficients)] = coefficients
    return found


def project(camera: Camera, points: Floats) -> Floats:
    """Return the pixels `[2, N]` of points `[3, N]` in the camera's axes; NaN behind the camera."""
    pixels = np.empty((2, points.shape[1]))
    kernels.project(rows((camera,))[0], *contiguous(points), pixels)
    return pixels


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
    given = np.ascontiguousarray(pixels, np.float64)
    _set_rays(cameras, given.swapaxes(1, 2), rays if by_component else rays.swapaxes(1, 2))
    return rays


def _set_rays(cameras: Sequence[Camera], pixels: Floats, rays: Floats) -> None:
    """Set the rays `[view, 3, N]` of pixels `[view, 2, N]`; those of several views in one call.

    Either is in C order, or was before its last two axes were swapped.
    """
    each = max(1, _PIXELS // max(1, pixels.shape[-1]))
    lenses = rows(cameras)
    limits = np.array([_limits(*row.tolist()) for row in lenses]).reshape(-1, 3)
    strides = [axis // 8 for array in (pixels, rays) for axis in array.strides[:0:-1]]

    def work(first: int) -> None:
        some = slice(first, first + each)
        given = *contiguous(_flat(pixels[some]), lenses[some], limits[some]), np.array(strides)
        kernels.unproject(*given, pixels.shape[-1], _flat(rays[some]))

    do_in_threads(work, range(0, len(cameras), each))


@lru_cache
def _limits(kind: float, _: float, *lens: float) -> tuple[float, float, float]:
    """Return when a point is that of a pixel: see `kernels.lens.unproject`."""
    focal, k = lens[:2], lens[4:]
    miss = LENS_MISS_PX / max(focal)
    if kind == kernels.FISHEYE:
        return 0.0, np.inf, miss
    # the distorted radius grows with the radius up to the first fold
    radius = np.linspace(0, 10, 4001)
    square = radius**2
    above = 1 + square * (k[0] + square * (k[1] + square * k[4]))
    below = 1 + square * (k[5] + square * (k[6] + square * k[7]))
    grows = np.diff(radius * above / np.where(below > 0, below, np.nan)) > 0
    fold = np.inf if grows.all() else float(square[np.argmin(grows)])
    return 1e-12 + 1e-9 * miss, fold, miss


def _flat(array: Floats) -> Floats:
    """Return all numbers of an array in the order in which they lie in memory, without a copy."""
    return (array if array.flags.c_contiguous else array.swapaxes(1, 2)).reshape(-1)


def image_slopes(camera: Camera, image: Floats) -> Slopes:
    """Return the derivatives of the pixels of points `[2, N]` of the plane z = 1."""
    found = np.empty((4, 2, image.shape[1]))
    kernels.set_slopes(rows((camera,))[0], *contiguous(image), found)
    return Slopes(image=found[:2].swapaxes(0, 1), log_focal=found[2], k1=found[3])


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
