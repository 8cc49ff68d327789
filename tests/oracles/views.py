"""Definitions in plain numpy of what kernels compute from rays of many views."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from mocap_calib.config import (
    INTERSECT_AGREEING_RAYS,
    INTERSECT_DOUBTFUL,
    INTERSECT_LOSS_SCALE,
    INTERSECT_OUTLIER,
    INTERSECT_STEPS,
    INTERSECT_TIGHTENING_SCALES,
    SMALL_RIG,
)
from mocap_calib.types import CameraRig, Floats


def across(directions: Floats) -> Floats:
    """Return I - u u' `[view, 3, 3]` of unit vectors `[view, 3]`."""
    return np.eye(3) - directions[:, :, None] * directions[:, None]


def solve(weight: Floats, rays: Floats, side: Floats) -> Floats:
    """Return the point of sum w (I - u u') (x - s) = 0, with weights scaled to 1.

    The ridge is 1e-10 of the trace, which is 2.
    """
    share = weight / weight.sum()
    matrix = np.einsum("v,vij->ij", share, across(rays))
    return np.linalg.solve(
        matrix + 2e-10 * np.eye(3), np.einsum("v,vij,vj->i", share, across(rays), side)
    )


def squared_errors(point: Floats, centres: Floats, rays: Floats, precision: Floats) -> Floats:
    """Return squared sines between rays and a point in variances, infinite behind the camera."""
    offset = point - centres
    along = (offset * rays).sum(1)
    error = np.maximum(1 - along**2 / (offset**2).sum(1), 0.0) * precision
    return np.where(along > 0, error, np.inf)


def refine(point: Floats, centres: Floats, rays: Floats, precision: Floats, scales) -> Floats:
    """Return a point after Gauss-Newton steps on angles under the loss of Geman and McClure."""
    for scale in scales:
        offset = point - centres
        square = (offset**2).sum(1)
        error = np.maximum(1 - (offset * rays).sum(1) ** 2 / square, 0.0) * precision
        weight = precision / square / (1 + error / scale**2) ** 2
        point = point - solve(weight, rays, offset)
    return point


def intersect_point(centres: Floats, rays: Floats, precision: Floats, pairs) -> Floats:
    """Return the point nearest to all rays that see it; pairs: of rays that give candidates."""
    given = centres, rays, precision
    loss = INTERSECT_LOSS_SCALE
    point = refine(solve(precision, rays, centres), *given, [loss] * INTERSECT_STEPS)
    count = len(rays)
    if count <= 2 or (squared_errors(point, *given) <= INTERSECT_DOUBTFUL * count).all():
        return point
    point = refine(point, *given, INTERSECT_TIGHTENING_SCALES)
    meeting = (squared_errors(point, *given) <= INTERSECT_OUTLIER).sum()
    if meeting >= INTERSECT_AGREEING_RAYS and 2 * meeting >= count:
        return point
    candidates = [solve(precision[both], rays[both], centres[both]) for both in pairs]
    costs = [
        np.minimum(squared_errors(candidate, *given), INTERSECT_OUTLIER).sum()
        for candidate in candidates
    ]
    return refine(candidates[np.argmin(costs)], *given, [loss] * INTERSECT_STEPS)


def candidate_pairs(views: int) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Return the pairs of views that give candidates, and those for points that these miss.

    All of a small rig. Of a large one: a view with the next one, and with the one a third away.
    """
    pairs = list(combinations(range(views), 2))
    apart = (1, views - 1, views // 3, views - views // 3)
    first = [pair for pair in pairs if views <= SMALL_RIG or pair[1] - pair[0] in apart]
    return first, [pair for pair in pairs if pair not in first]


def intersect(rig: CameraRig, world: Floats, precision: Floats) -> Floats:
    """Return the points `[3, N]` nearest to rays; NaN where fewer than two are seen."""
    points = np.full(world.shape[1:], np.nan)
    middle = rig.centres.mean(0)
    for n, seen in enumerate((precision > 0).T):
        if seen.sum() >= 2:
            row = dict(zip(np.flatnonzero(seen).tolist(), range(seen.sum()), strict=True))
            first, others = (
                [[row[a], row[b]] for a, b in pairs if a in row and b in row]
                for pairs in candidate_pairs(len(rig))
            )
            given = rig.centres[seen] - middle, world[seen, :, n], precision[seen, n]
            points[:, n] = intersect_point(*given, first or others) + middle
    return points


def information(rig: CameraRig, point: Floats) -> Floats:
    """Return J'J `[view, 3, 3]` of the angles of each view by a point."""
    offset = point - rig.centres
    distance = np.linalg.norm(offset, axis=1)
    return across(offset / distance[:, None]) / distance[:, None, None] ** 2


def median_angles(rig: CameraRig, point: Floats, weight: Floats) -> Floats:
    """Return the medians `[view]` of the angles between rays and the point made of them.

    The point leaves 5 % at least of the variance of a ray's error.
    """
    each = information(rig, point)
    covariance = np.linalg.inv(np.einsum("v,vij->ij", weight, each))
    medians = []
    for taken in weight[:, None, None] * (covariance @ each):
        mean = max(2 - np.trace(taken), 2 * 0.05)
        square = max(2 - 2 * np.trace(taken) + np.trace(taken @ taken), 0.5 * mean**2)
        freedom = np.clip(mean**2 / square, 1.0, 2.0)
        medians.append(np.sqrt(mean * (1 - 2 / (9 * freedom)) ** 3))
    return np.array(medians)


# the adjustment


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


def normal_equations(rotation: Floats, linear) -> NormalEquations:
    """Return U = A'A, V = B'B, W = A'B and their gradients of Jacobians A and B.

    linear: `Linearised`.
    """
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
