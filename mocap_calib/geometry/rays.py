"""Rays of a rig, many at once, and points beside them."""

import numpy as np

from mocap_calib.compute.kernels import compiled, contiguous
from mocap_calib.types import Bools, CameraRig, Floats

_KERNELS = "mocap_calib.geometry.ray_kernels"


def points_in_cameras(rig: CameraRig, points: Floats) -> Floats:
    """Return points `[3, N]` in world coordinates in each camera's frame, `[view, 3, N]`."""
    return np.matmul(rig.rotation, points) + rig.translation[:, :, None]


def are_apart(rays: Floats, used: Bools, least_angle: float) -> Bools:
    """Return whether the used rays of each point are far enough apart, `[N]`.

    rays: `[view, 3, N]` in world coordinates; used: `[view, N]`; least_angle: in radians. The mean
    of two rays is half-way between them, so half of the angle is asked of the ray that is farthest
    from the mean.
    """
    mean = np.einsum("vin,vn->in", rays, used.astype(np.float64))
    mean /= np.maximum(np.sqrt((mean**2).sum(0)), 1e-12)
    cosine = np.where(used, np.einsum("vin,in->vn", rays, mean), 1.0)
    return cosine.min(0) < np.cos(least_angle / 2)


def rays_in_world(rig: CameraRig, rays: Floats) -> Floats:
    """Return rays `[view, 3, N]` of the cameras' frames in world coordinates, zero = missing."""
    if kernels := compiled(_KERNELS):
        world = np.empty(rays.shape)
        kernels.rays_in_world(*contiguous(rig.rotation, rays), world)
        return world
    return _rays_in_world(rig, rays)


def _rays_in_world(rig: CameraRig, rays: Floats) -> Floats:
    """Return what `rays_in_world` does."""
    return np.matmul(np.swapaxes(rig.rotation, 1, 2), np.nan_to_num(rays))


def ray_angles(rig: CameraRig, points: Floats, rays: Floats) -> tuple[Floats, Bools]:
    """Return the angles between rays and points, and whether the points are in front of the views.

    points: `[3, N]`; rays: `[view, 3, N]`. Angles `[view, N]` in radians, pi where something is
    missing; in front `[view, N]`.
    """
    if kernels := compiled(_KERNELS):
        angle, along = np.empty((2, len(rays), points.shape[1]))
        given = contiguous(rig.rotation, rig.translation, points, rays)
        kernels.ray_angles(*given, angle, along)
        return angle, along > 0
    return _ray_angles(rig, points, rays)


def _ray_angles(rig: CameraRig, points: Floats, rays: Floats) -> tuple[Floats, Bools]:
    """Return what `ray_angles` does."""
    in_camera = points_in_cameras(rig, points)
    along = np.einsum("vin,vin->vn", in_camera, rays)
    z, x, y = (_cross(in_camera, rays, i) for i in range(3))
    across = np.sqrt(z * z + x * x + y * y)
    angle = np.arctan2(across, along)
    return np.where(np.isnan(angle), np.pi, angle), along > 0


def _cross(first: Floats, second: Floats, i: int) -> Floats:
    """Return one component `[view, N]` of the cross product of vectors `[view, 3, N]`.

    The components come in the order z, x, y for i = 0, 1, 2.
    """
    j = (i + 1) % 3
    return first[:, i] * second[:, j] - first[:, j] * second[:, i]
