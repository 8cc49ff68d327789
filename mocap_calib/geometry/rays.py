"""Rays of a rig, many at once, and points beside them."""

import numpy as np

from mocap_calib.kernels.loading import compiled, contiguous
from mocap_calib.types import Bools, CameraRig, Floats

_KERNELS = "mocap_calib.kernels.rays"


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
    kernels = compiled(_KERNELS)
    if kernels is None:
        return _agreeing_views(rig, points, world, weight, limits=limits, least_angle=least_angle)
    agree = np.empty(weight.shape, dtype=bool)
    tangents = np.tan(np.minimum(limits, np.pi / 2))
    given = contiguous(rig.centres, points, world, weight, tangents)
    kernels.agreeing_views(*given, np.cos(least_angle / 2), agree)
    return agree


def _agreeing_views(
    rig: CameraRig,
    points: Floats,
    world: Floats,
    weight: Floats,
    *,
    limits: Floats,
    least_angle: float,
) -> Bools:
    """Return what `agreeing_views` does."""
    seen = weight > 0
    limit = np.take_along_axis(limits, np.broadcast_to(seen.sum(0), weight.shape), axis=1)
    angle, in_front = _angles(points - rig.centres[:, :, None], world)
    agree = seen & in_front & (angle < limit)
    enough = agree.sum(0) >= 2
    return np.asarray(agree & enough & are_apart(world, agree, least_angle))


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
    return _angles(points_in_cameras(rig, points), rays)


def _angles(offset: Floats, rays: Floats) -> tuple[Floats, Bools]:
    """Return the angles between rays and offsets of points from the views, and which are in front.

    Both `[view, 3, N]`. Angles `[view, N]` in radians, pi where something is missing.
    """
    along = np.einsum("vin,vin->vn", offset, rays)
    z, x, y = (_cross(offset, rays, i) for i in range(3))
    across = np.sqrt(z * z + x * x + y * y)
    angle = np.arctan2(across, along)
    return np.where(np.isnan(angle), np.pi, angle), along > 0


def _cross(first: Floats, second: Floats, i: int) -> Floats:
    """Return one component `[view, N]` of the cross product of vectors `[view, 3, N]`.

    The components come in the order z, x, y for i = 0, 1, 2.
    """
    j = (i + 1) % 3
    return first[:, i] * second[:, j] - first[:, j] * second[:, i]
