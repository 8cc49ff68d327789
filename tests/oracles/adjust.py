"""Definitions in plain numpy of what kernels of the adjustment compute."""

from dataclasses import dataclass

import numpy as np

from mocap_calib.adjust.residuals import Linearised
from mocap_calib.types import Floats


@dataclass(frozen=True)
class NormalEquations:
    """The Gauss-Newton system about a state, with A and B the Jacobians of cameras and points.

    camera: `[view, C, C]` U = A'A, of C unknowns each; camera_gradient: `[view, C]` a = A'r.
    point: `[3, 3, N]` V = B'B; point_gradient: `[3, N]` b = B'r. mixed: `[view, C, 3, N]` W = A'B.
    """

    camera: Floats
    camera_gradient: Floats
    point: Floats
    point_gradient: Floats
    mixed: Floats


def normal_equations(rotation: Floats, linear: Linearised) -> NormalEquations:
    """Return U = A'A, V = B'B, W = A'B and their gradients of Jacobians A and B."""
    slope, residual = linear.by_point, linear.residual
    turning = np.cross(
        linear.in_camera[:, None], slope, axis=2
    )  # a rotation w moves a point x by w x x
    camera = np.concatenate([turning, slope, linear.by_intrinsics], axis=2)
    point = np.einsum("vkin,vij->vkjn", slope, rotation)
    return NormalEquations(
        camera=np.einsum("vkin,vkjn->vij", camera, camera, optimize=True),
        camera_gradient=np.einsum("vkin,vkn->vi", camera, residual),
        point=np.einsum("vkin,vkjn->ijn", point, point),
        point_gradient=np.einsum("vkin,vkn->in", point, residual),
        mixed=np.einsum("vkin,vkjn->vijn", camera, point),
    )


def eliminate_points(equations: NormalEquations) -> tuple[Floats, Floats, Floats]:
    """Return V^-1 `[3, 3, N]`, and S = U - W V^-1 W' and g = a - W V^-1 b of all cameras."""
    largest = np.einsum("iin->in", equations.point).max(0)
    ridge = np.where(largest > 0, 1e-12 * largest, 1.0)
    inverse = np.linalg.inv(equations.point.T + ridge[:, None, None] * np.eye(3)).T
    views, unknowns = equations.camera_gradient.shape
    mixed = equations.mixed.reshape(views * unknowns, *equations.point_gradient.shape)
    own = np.zeros((views, unknowns, views, unknowns))
    own[np.arange(views), :, np.arange(views)] = equations.camera
    system = own.reshape((views * unknowns,) * 2)
    system = system - np.einsum("ain,ijn,bjn->ab", mixed, inverse, mixed, optimize=True)
    moved = np.einsum("ijn,jn->in", inverse, equations.point_gradient)
    gradient = equations.camera_gradient.ravel() - np.einsum("ain,in->a", mixed, moved)
    return inverse, system, gradient


def compare_projections(projections: Floats, seen, tolerance: Floats, least_joints: int):
    """Return the least costs `[projection, detection]` and the bodies that these are of.

    seen: `Sightings`. NaN where no body has enough joints in common.
    """
    costs = np.full((len(projections), len(seen.frame), seen.bodies.shape[1]), np.inf)
    for n, frame in enumerate(seen.frame):
        for body, points in enumerate(seen.bodies[frame]):
            both = np.isfinite(points[:, 0]) & np.isfinite(seen.image[n, :, 0])
            if both.sum() < least_joints:
                continue
            for number, projection in enumerate(projections):
                at = points[both] @ projection[:, :3].T + projection[:, 3]
                error = at[:, :2] / at[:, 2:] - seen.image[n, both]
                square = (error**2).sum(1) / tolerance[n] ** 2
                cost = np.where(at[:, 2] > 0, square / (1 + square), 1.0)
                costs[number, n, body] = cost.mean()
    least = costs.min(-1)
    return np.where(np.isfinite(least), least, np.nan), costs.argmin(-1)
