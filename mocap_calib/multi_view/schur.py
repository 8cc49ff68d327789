"""Minimise a robust reprojection error over cameras and points, with the points eliminated.

Levenberg and Marquardt's iteration on the reduced camera system (Triggs, McLauchlan, Hartley and
Fitzgibbon 2000: "Bundle Adjustment - A Modern Synthesis", section 6.1).
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import (
    LM_DAMPING_FACTOR,
    LM_FIRST_DAMPING,
    LM_LEAST_DAMPING,
    LM_MOST_DAMPING,
    LM_STEPS,
)
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.multi_view.ray_residuals import (
    RayObservations,
    State,
    blocks_of,
    jacobian,
    robust_cost,
)
from mocap_calib.types import Floats


@dataclass(frozen=True)
class _NormalEquations:
    """The Gauss-Newton system about a state, with A and B the Jacobians of cameras and points.

    camera: `[view, 6, 6]` the blocks U = A'A of the cameras.
    camera_gradient: `[view, 6]` a = A'r.
    point: `[3, 3, N]` the blocks V = B'B of the points.
    point_gradient: `[3, N]` b = B'r.
    mixed: `[view, 6, 3, N]` the blocks W = A'B of a camera and a point.
    """

    camera: Floats
    camera_gradient: Floats
    point: Floats
    point_gradient: Floats
    mixed: Floats


def minimise(state: State, seen: RayObservations, *, loss_scale: float, tolerance: float) -> State:
    """Return the state of least robust cost: Cauchy's loss at `loss_scale` standard deviations.

    The first camera stays where it is; the scale of the rig is free. It ends when a step lowers
    the cost by no more than the share `tolerance`.
    """
    damping = LM_FIRST_DAMPING
    cost = robust_cost(state, seen, loss_scale)
    equations = _linearise(state, seen, loss_scale)
    for _ in range(LM_STEPS):
        candidate = _step(state, equations, damping)
        candidate_cost = robust_cost(candidate, seen, loss_scale)
        if not candidate_cost < cost:
            damping *= LM_DAMPING_FACTOR
            if damping > LM_MOST_DAMPING:
                break
            continue
        converged = cost - candidate_cost <= tolerance * cost
        state = candidate
        cost = candidate_cost
        damping = max(damping / LM_DAMPING_FACTOR, LM_LEAST_DAMPING)
        if converged:
            break
        equations = _linearise(state, seen, loss_scale)
    return state


# The normal equations


def _linearise(state: State, seen: RayObservations, loss_scale: float) -> _NormalEquations:
    """Return the normal equations about a state."""
    views, count = seen.weight.shape
    equations = _NormalEquations(
        camera=np.zeros((views, 6, 6)),
        camera_gradient=np.zeros((views, 6)),
        point=np.empty((3, 3, count)),
        point_gradient=np.empty((3, count)),
        mixed=np.empty((views, 6, 3, count)),
    )
    work = partial(
        _linearise_block, state=state, seen=seen, loss_scale=loss_scale, equations=equations
    )
    for camera, camera_gradient in map_in_threads(work, blocks_of(state.points)):
        equations.camera[:] += camera
        equations.camera_gradient[:] += camera_gradient
    return equations


def _linearise_block(
    block: slice,
    *,
    state: State,
    seen: RayObservations,
    loss_scale: float,
    equations: _NormalEquations,
) -> tuple[Floats, Floats]:
    """Fill in the equations of a block of points.

    Returns what the block adds to the cameras' blocks `[view, 6, 6]` and gradient `[view, 6]`.
    """
    found = jacobian(block, state, seen, loss_scale)
    equations.point[..., block] = np.einsum("vkin,vkjn->ijn", found.point, found.point)
    equations.point_gradient[:, block] = np.einsum("vkin,vkn->in", found.point, found.residual)
    equations.mixed[..., block] = np.einsum("vkin,vkjn->vijn", found.camera, found.point)
    camera = np.einsum("vkin,vkjn->vij", found.camera, found.camera, optimize=True)
    camera_gradient = np.einsum("vkin,vkn->vi", found.camera, found.residual)
    return camera, camera_gradient


# The step


def _step(state: State, equations: _NormalEquations, damping: float) -> State:
    """Return the state after a damped Gauss-Newton step of cameras and points.

    First the reduced camera system S dc = -(a - W V^-1 b), where S = U - W V^-1 W' is the Schur
    complement of V; then each point by itself, dp = -V^-1 (b + W' dc).
    """
    inverse, schur, gradient = _eliminate_points(equations, damping)
    cameras = _solve_cameras(schur, gradient)
    from_cameras = cameras @ equations.mixed.reshape(len(cameras), -1)  # W' dc
    gradient = equations.point_gradient + from_cameras.reshape(state.points.shape)
    points = -np.einsum("ijn,jn->in", inverse, gradient)
    return _move(state, cameras.reshape(-1, 6), points)


def _eliminate_points(equations: _NormalEquations, damping: float) -> tuple[Floats, Floats, Floats]:
    """Return V^-1 `[3, 3, N]`, S `[6 view, 6 view]` and a - W V^-1 b `[6 view]`."""
    views, count = len(equations.camera), equations.point_gradient.shape[1]
    blocks = blocks_of(equations.point_gradient)
    work = partial(_eliminate_block, equations=equations, damping=damping)
    inverse = np.empty((3, 3, count))
    schur = np.zeros((6 * views, 6 * views))
    gradient = equations.camera_gradient.reshape(-1).copy()
    for block, (of_block, matrix, side) in zip(blocks, map_in_threads(work, blocks), strict=True):
        inverse[..., block] = of_block
        schur -= matrix
        gradient -= side
    for view, camera in enumerate(equations.camera):
        own = slice(6 * view, 6 * view + 6)
        schur[own, own] += camera + damping * np.diag(np.diag(camera))
    return inverse, schur, gradient


def _eliminate_block(
    block: slice, *, equations: _NormalEquations, damping: float
) -> tuple[Floats, Floats, Floats]:
    """Return V^-1 `[3, 3, n]`, W V^-1 W' `[6 view, 6 view]` and W V^-1 b `[6 view]` of a block."""
    inverse = _damped_inverse(equations.point[..., block], damping)
    mixed = equations.mixed.reshape(-1, *equations.point_gradient.shape)[..., block]
    rows = len(mixed)
    # written out: einsum has no fast way for it
    columns = [sum(mixed[:, j] * inverse[j, k] for j in range(3)) for k in range(3)]
    product = np.stack(columns, axis=1).reshape(rows, -1)
    matrix = product @ mixed.reshape(rows, -1).T
    side = product @ equations.point_gradient[:, block].reshape(-1)
    return inverse, matrix, side


def _damped_inverse(matrix: Floats, damping: float) -> Floats:
    """Return the inverses of matrices `[3, 3, n]` whose diagonals are damped."""
    damped = matrix.transpose(2, 0, 1).copy()  # [n, 3, 3]
    diagonal = np.einsum("nii->ni", damped)  # a view: what is added to it is added to `damped`
    diagonal *= 1 + damping
    largest = diagonal.max(1, keepdims=True)
    # a point that no view sees stays where it is
    diagonal += np.where(largest > 0, 1e-12 * largest, 1.0)
    inverse = np.linalg.inv(damped).transpose(1, 2, 0)
    return np.ascontiguousarray(inverse, dtype=np.float64)


def _solve_cameras(schur: Floats, gradient: Floats) -> Floats:
    """Return the step of the cameras `[6 view]`, S dc = -gradient; that of the first is zero."""
    free = slice(6, None)  # the first camera is the frame of the world
    matrix = schur[free, free]
    stiffness = np.diag(matrix)
    # rounding may leave a direction that nothing constrains below zero
    scale = 1 / np.sqrt(np.maximum(stiffness, 1e-15 * stiffness.max() + 1e-150))
    scaled = scale[:, None] * matrix * scale + 1e-12 * np.eye(len(matrix))
    step = np.zeros(len(gradient))
    step[free] = -scale * np.linalg.solve(scaled, scale * gradient[free])
    return step


def _move(state: State, cameras: Floats, points: Floats) -> State:
    """Return the state after steps of the cameras `[view, 6]` and of the points `[3, N]`."""
    rotation = matrix_from_vector(cameras[:, :3])
    translation = np.einsum("vij,vj->vi", rotation, state.translation) + cameras[:, 3:]
    return State(
        rotation=rotation @ state.rotation,
        translation=translation,
        points=state.points + points,
    )
