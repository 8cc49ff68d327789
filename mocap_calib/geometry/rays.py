"""Rays of a rig, many at once, and points beside them."""

import numpy as np

from mocap_calib.kernels import rays as kernels
from mocap_calib.kernels.loading import contiguous
from mocap_calib.types import Bools, CameraRig, Floats


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
    agree = np.empty(weight.shape, dtype=bool)
    tangents = np.tan(np.minimum(limits, np.pi / 2))
    given = contiguous(rig.centres, points, world, weight, tangents)
    kernels.agreeing_views(*given, np.cos(least_angle / 2), agree)
    return agree


def rays_in_world(rig: CameraRig, rays: Floats) -> Floats:
    """Return rays `[view, 3, N]` of the cameras' frames in world coordinates, zero = missing."""
    world = np.empty(rays.shape)
    kernels.rays_in_world(*contiguous(rig.rotation, rays), world)
    return world


def ray_angles(rig: CameraRig, points: Floats, rays: Floats) -> tuple[Floats, Bools]:
    """Return the angles between rays and points, and whether the points are in front of the views.

    points: `[3, N]`; rays: `[view, 3, N]`. Angles `[view, N]` in radians, pi where something is
    missing; in front `[view, N]`.
    """
    angle, along = np.empty((2, len(rays), points.shape[1]))
    kernels.ray_angles(*contiguous(rig.rotation, rig.translation, points, rays), angle, along)
    return angle, along > 0
