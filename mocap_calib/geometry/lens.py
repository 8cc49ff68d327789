"""Lenses, pixels, and rays of the cameras of a rig.

Pixels have their centres at integers. Rays are unit vectors in the camera's axes: x right, y down,
z forward. By component, where nothing else is said: `[2, N]` pixels, `[3, N]` points and rays. NaN
stays NaN.

Lenses are OpenCV's. Their inverses are compiled, because whole recordings go through: ten times
faster than cv2, and without its failures (its fixed-point iteration diverges at strong lenses; its
fisheye inverse returns tan(theta), which breaks near 90 degrees).
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mocap_calib.compute.parallel import do_in_threads
from mocap_calib.config import LENS_MISS_PX, UncertaintyConfig
from mocap_calib.kernels import lens as kernels
from mocap_calib.kernels.jit import contiguous
from mocap_calib.types import Bools, Camera, CameraRig, Floats, Reals, as_array

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


def centre_sigma(camera: Camera, config: UncertaintyConfig) -> float:
    """Return the standard deviation of a given principal point along each axis, in pixels.

    The one that is stated. Else that of a calibration by a board, and the distance from the middle
    of the image with the probability that it belongs to other images: a mixture of two priors.
    """
    if camera.centre_sigma is not None:
        return camera.centre_sigma
    size = np.array(camera.size) if all(camera.size) else 2 * camera.matrix[:2, 2] + 1
    longer = float(size.max())
    if config.centre_uncertainty is not None:
        return config.centre_uncertainty * longer
    far = np.linalg.norm(camera.matrix[:2, 2] - (size - 1) / 2) / longer
    usual, mistaken = config.usual_principal_point, config.mistaken_principal_point
    right = (1 - config.mistaken_share) * np.exp(-((far / usual) ** 2) / 2) / usual**2
    wrong = config.mistaken_share * np.exp(-((far / mistaken) ** 2) / 2) / mistaken**2
    share = wrong / (right + wrong)
    return float(longer * np.sqrt(config.given_principal_point**2 + share * far**2 / 2))


def focal_sigmas(cameras: Sequence[Camera], config: UncertaintyConfig) -> Floats:
    """Return the stated standard deviations `[view]` of the logarithms of focal lengths.

    NaN where none is stated.
    """
    usual = np.nan if config.focal_uncertainty is None else config.focal_uncertainty
    known = [(camera.focal_sigma, camera.focal) for camera in cameras]
    return np.array([usual if sigma is None else sigma / focal for sigma, focal in known])


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
    row = rows((camera,))[0]
    depth = np.where(points[2] > 1e-9, points[2], np.nan)
    x, y, *_ = _distort(row, points[:2] / depth)
    return np.stack([row[2] * x + row[4], row[3] * y + row[5]])


def _distort(row: Floats, image: Floats) -> tuple[Floats, ...]:
    """Return what `kernels.lens.distort` does, of points `[2, N]` of the plane z = 1."""
    with np.errstate(all="ignore"):  # points far outside the image
        return kernels.distort(row, image[0], image[1])


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
    row = rows((camera,))[0]
    focal = row[2:4, None]
    x, y, xx, xy, yy, by_k1 = _distort(row, image)
    return Slopes(
        image=focal[:, None] * np.array([[xx, xy], [xy, yy]]),
        log_focal=focal * np.stack([x, y]),
        k1=focal * image * by_k1,
    )


def change_intrinsics(
    camera: Camera, *, log_focal: float, k1: float, log_aspect: float = 0.0
) -> Camera:
    """Return the camera with other intrinsics.

    log_focal is added to the logarithm of both focal lengths, k1 to the first coefficient of the
    lens, and log_aspect to the logarithm of f_y / f_x.
    """
    matrix = camera.matrix.copy()
    matrix[[0, 1], [0, 1]] *= np.exp(log_focal + np.array([-0.5, 0.5]) * log_aspect)
    distortion = camera.distortion.copy()
    if not len(distortion):
        distortion = np.zeros(4 if camera.fisheye else 5)
    distortion[0] += k1
    return replace(camera, matrix=matrix, distortion=distortion)


def rays_from_pixels(camera: Camera, pixels: Reals) -> Floats:
    """Return the unit rays `[..., 3]` of pixels `[..., 2]`, with the distortion taken out.

    NaN stays NaN, and a pixel that no ray projects to is NaN.
    """
    rays = unproject_views((camera,), np.reshape(pixels, (1, -1, 2)), by_component=False)
    return rays.reshape(*pixels.shape[:-1], 3)


def pixels_from_points(camera: Camera, points: Floats) -> Floats:
    """Return the pixels `[..., 2]` of points `[..., 3]` in the camera's axes.

    NaN stays NaN, and a point behind the camera is NaN.
    """
    pixels = project(camera, np.asarray(points, dtype=np.float64).reshape(-1, 3).T)
    return pixels.T.reshape(*points.shape[:-1], 2)


def project_points(rig: CameraRig, points: ArrayLike) -> Floats:
    """Return the pixels `[view, ..., 2]` of points `[..., 3]` in world coordinates.

    The distortion of the lenses is applied. NaN stays NaN, and a point behind a camera is NaN
    there. Pixels outside the image are returned like any other.

    Raises ValueError where the last axis of the points is not 3.
    """
    world = as_array("points", points, float, *np.shape(points)[:-1], 3)
    pixels = project_views(rig, world.reshape(-1, 3).T)
    return pixels.swapaxes(1, 2).reshape(len(rig), *world.shape[:-1], 2)


def points_in_cameras(rig: CameraRig, points: Floats) -> Floats:
    """Return points `[3, N]` in world coordinates in each camera's frame, `[view, 3, N]`."""
    return np.matmul(rig.rotation, points) + rig.translation[:, :, None]


def agreeing_views(
    rig: CameraRig,
    points: Floats,
    world: Floats,
    weight: Floats,
    *,
    limits: Floats,
    least_angle: float,
) -> Bools:
    """Return the views that agree on points, `[view, N]`; none where they are too few or too near.

    A view agrees where the point is in front of it, and its ray passes within a limit. Two views
    at least must, and their rays be far enough apart.

    points: `[3, N]`, NaN = unknown. world: `[view, 3, N]` unit rays in the world's axes, zero where
    missing. weight: `[view, N]`, 0 = not seen. limits: `[view, count]` angles in radians, of points
    that so many views see. least_angle: in radians.
    """
    seen = weight > 0
    limit = np.take_along_axis(limits, np.broadcast_to(seen.sum(0), seen.shape), axis=1)
    angle, along = _angles(points - rig.centres[:, :, None], world)
    agree = seen & (along > 0) & (angle < limit)
    mean = np.einsum("vin,vn->in", world, agree.astype(np.float64))
    mean /= np.maximum(np.linalg.norm(mean, axis=0), 1e-12)
    cosine = np.where(agree, np.einsum("vin,in->vn", world, mean), 1.0).min(0)
    return agree & (agree.sum(0) >= 2) & (cosine < np.cos(least_angle / 2))


def rays_in_world(rig: CameraRig, rays: Floats) -> Floats:
    """Return rays `[view, 3, N]` of the cameras' frames in world coordinates, zero = missing."""
    return np.nan_to_num(np.matmul(np.swapaxes(rig.rotation, 1, 2), rays))


def ray_angles(rig: CameraRig, points: Floats, rays: Floats) -> tuple[Floats, Bools]:
    """Return the angles between rays and points, and whether the points are in front of the views.

    points: `[3, N]`; rays: `[view, 3, N]`. Angles `[view, N]` in radians, pi where something is
    missing; in front `[view, N]`.
    """
    angle, along = _angles(points_in_cameras(rig, points), rays)
    return np.where(np.isnan(angle), np.pi, angle), along > 0


def _angles(offset: Floats, rays: Floats) -> tuple[Floats, Floats]:
    """Return angles `[view, N]` between offsets and rays `[view, 3, N]`, and lengths along rays."""
    along = np.einsum("vin,vin->vn", offset, rays)
    return np.arctan2(np.linalg.norm(np.cross(offset, rays, axis=1), axis=1), along), along


def project_views(rig: CameraRig, points: Floats) -> Floats:
    """Return the pixels `[view, 2, N]` of points `[3, N]` in world coordinates; NaN = behind."""
    return np.stack(list(map(project, rig.cameras, points_in_cameras(rig, points))))


def reprojection_error(rig: CameraRig, points: Floats, *, pixels: Floats, used: Bools) -> Floats:
    """Return the RMS distance `[N]` in pixels of points from their detections in the used views.

    points: `[3, N]` in world coordinates; pixels: `[view, 2, N]` the detections; used: `[view, N]`.
    NaN where no view is used. A view that has a point behind it adds no distance.
    """
    total = np.zeros(points.shape[1])
    for own, seen, counted in zip(project_views(rig, points), pixels, used, strict=True):
        total += np.where(counted, np.nan_to_num(((own - seen) ** 2).sum(0)), 0.0)
    count = used.sum(0)
    return np.sqrt(np.where(count > 0, total, np.nan) / np.maximum(count, 1))


def decompose_projection(projection: Floats) -> tuple[Floats, Floats, Floats]:
    """Return K `[3, 3]`, R `[3, 3]` and t `[3]` of P = K [R t] `[3, 4]`, by RQ decomposition.

    The second and third diagonal elements of K are positive; the first is negative where the image
    is mirrored. The sign of P is taken as it is: what is in front of the camera has a positive
    third coordinate.
    """
    turned, upper = np.linalg.qr(projection[::-1, :3].T)  # of rows in reverse: RQ of QR
    matrix, rotation = upper.T[::-1, ::-1], turned.T[::-1]
    sign = np.sign(np.diag(matrix))
    matrix, rotation = matrix * sign, sign[:, None] * rotation
    if np.linalg.det(rotation) < 0:
        flip = np.array([-1.0, 1.0, 1.0])
        matrix, rotation = matrix * flip, flip[:, None] * rotation
    translation = np.linalg.solve(matrix, projection[:, 3])
    matrix = matrix / matrix[2, 2]
    return np.asarray(matrix), np.asarray(rotation, dtype=np.float64), np.asarray(translation)
