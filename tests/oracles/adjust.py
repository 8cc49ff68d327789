"""Definitions in plain numpy of what kernels of the adjustment compute."""

import numpy as np

from mocap_calib.adjust.residuals import Linearised
from mocap_calib.adjust.solve import NormalEquations
from mocap_calib.types import Floats


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


def schur_complement(equations: NormalEquations) -> tuple[Floats, Floats, Floats]:
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


def detection_costs(points: Floats, image: Floats, projection: Floats, tolerance: float, least):
    """Return `[frame, instance, individual]` mean costs of joints, 1 where too few compare.

    points: `[frame, individual, keypoint, 3]`; image: `[frame, instance, keypoint, 2]`.
    """
    seen = points @ projection[:, :3].T + projection[:, 3]
    in_front = seen[..., 2:] > 0
    there = seen[..., :2] / np.where(in_front, seen[..., 2:], np.nan)
    square = ((image[:, :, None] - there[:, None]) ** 2).sum(-1) / tolerance**2
    cost = np.where(in_front[:, None, ..., 0], square / (1 + square), 1.0)
    both = np.isfinite(image[:, :, None, :, 0]) & np.isfinite(points[:, None, ..., 0])
    count = both.sum(-1)
    mean = np.where(both, cost, 0.0).sum(-1) / np.maximum(count, 1)
    return np.where(count >= least, mean, 1.0)


def compare_poses(rotation: Floats, translation: Floats, seen, tolerance: Floats, least_joints):
    """Return the least costs `[pose, detection]` of the bodies of its frame, and which these are.

    seen: `Sightings`. NaN where no body has enough joints in common.
    """
    costs = np.full((len(rotation), len(seen.frame), seen.bodies.shape[1]), np.inf)
    for n, frame in enumerate(seen.frame):
        for body, points in enumerate(seen.bodies[frame]):
            both = np.isfinite(points[:, 0]) & np.isfinite(seen.rays[n, :, 0])
            if both.sum() < least_joints:
                continue
            for pose, (turn, shift) in enumerate(zip(rotation, translation, strict=True)):
                at = points[both] @ turn.T + shift
                unit = at / np.linalg.norm(at, axis=1, keepdims=True)
                square = ((unit - seen.rays[n, both]) ** 2).sum(1) / tolerance[n] ** 2
                costs[pose, n, body] = (square / (1 + square)).mean()
    least = costs.min(-1)
    return np.where(np.isfinite(least), least, np.nan), costs.argmin(-1)
