"""Minimise a robust reprojection error over cameras and points, with the points eliminated.

Levenberg and Marquardt's iteration on the reduced camera system (Triggs, McLauchlan, Hartley and
Fitzgibbon 2000: "Bundle Adjustment - A Modern Synthesis", section 6.1).
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from mocap_calib.compute.kernels import compiled, contiguous
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import (
    LM_DAMPING_FACTOR,
    LM_FIRST_DAMPING,
    LM_LEAST_DAMPING,
    LM_MOST_DAMPING,
    LM_STEPS,
)
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.multi_view.residuals import (
    KERNELS,
    Observations,
    State,
    blocks_of,
    jacobian,
    robust_cost,
    slopes_of,
)
from mocap_calib.types import Bools, Floats, Ints


@dataclass(frozen=True)
class Freedom:
    """What of the cameras may change, and how far their intrinsics are likely to.

    basis: `[C view, free]` 1 where an unknown of a camera is one of the free ones, else 0.
    precision: `[view, intrinsic]` inverse variance of a change of intrinsics, as much of it as
        one view of those that share them has.
    """

    basis: Floats
    precision: Floats

    @property
    def intrinsics(self) -> Ints:
        """Index `[view, intrinsic]` of the free unknown that each of the intrinsics is."""
        views, intrinsics = self.precision.shape
        by_view = self.basis.reshape(views, 6 + intrinsics, -1)
        return np.asarray(by_view[:, 6:].argmax(2), dtype=np.int64)


@dataclass(frozen=True)
class NormalEquations:
    """The Gauss-Newton system about a state, with A and B the Jacobians of cameras and points.

    camera: `[view, C, C]` the blocks U = A'A of the cameras, of C unknowns each.
    camera_gradient: `[view, C]` a = A'r.
    point: `[3, 3, N]` the blocks V = B'B of the points.
    point_gradient: `[3, N]` b = B'r.
    mixed: `[view, C, 3, N]` the blocks W = A'B of a camera and a point.
    """

    camera: Floats
    camera_gradient: Floats
    point: Floats
    point_gradient: Floats
    mixed: Floats


def free_poses(views: int) -> Freedom:
    """Return the freedom of cameras whose intrinsics are known.

    The first camera stays where it is: it is the frame of the world.
    """
    return Freedom(basis=np.eye(6 * views)[:, 6:], precision=np.zeros((views, 0)))


def free_intrinsics(group: Ints, sigma: Floats) -> Freedom:
    """Return the freedom of cameras some of whose intrinsics are adjusted with their poses.

    group: `[view]` cameras of one number share the changes of their intrinsics.
    sigma: `[view, intrinsic]` standard deviation of a change, the same in all views of a group.
    """
    views, intrinsics = sigma.shape
    first_free = 6 * (views - 1)
    groups, of_view, sizes = np.unique(group, return_inverse=True, return_counts=True)
    basis = np.zeros((views, 6 + intrinsics, first_free + len(groups) * intrinsics))
    for view in range(views):
        if view > 0:
            basis[view, :6, 6 * (view - 1) : 6 * view] = np.eye(6)
        start = first_free + of_view[view] * intrinsics
        basis[view, 6:, start : start + intrinsics] = np.eye(intrinsics)
    precision = 1 / (sigma**2 * sizes[of_view][:, None])
    return Freedom(basis=basis.reshape(-1, basis.shape[2]), precision=precision)


def free_clocks(free: Bools, sigma: float) -> Freedom:
    """Return the freedom of cameras the offsets of whose clocks are adjusted with their poses.

    free: `[view]` the cameras whose clocks may change; that of the first camera must stay.
    sigma: standard deviation of an offset, in frames.
    """
    every = np.eye(7 * len(free)).reshape(len(free), 7, -1)
    unknown = np.ones((len(free), 7), dtype=bool)
    unknown[0, :6] = False
    unknown[:, 6] = free
    basis = every.reshape(7 * len(free), -1)[:, unknown.ravel()]
    return Freedom(basis=basis, precision=np.full((len(free), 1), sigma**-2))


def minimise(
    state: State, seen: Observations, freedom: Freedom, *, loss_scale: float, tolerance: float
) -> State:
    """Return the state of least robust cost: Cauchy's loss at `loss_scale` standard deviations.

    The scale of the rig is free. It ends when a step lowers the cost by no more than the share
    `tolerance`.
    """
    damping = LM_FIRST_DAMPING
    cost = total_cost(state, seen, freedom, loss_scale)
    equations = linearise(state, seen, freedom, loss_scale)
    for _ in range(LM_STEPS):
        candidate = _step(state, equations, freedom, damping)
        candidate_cost = total_cost(candidate, seen, freedom, loss_scale)
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
        equations = linearise(state, seen, freedom, loss_scale)
    return state


def total_cost(state: State, seen: Observations, freedom: Freedom, loss_scale: float) -> float:
    """Return the robust cost of a state and of how far its intrinsics have changed."""
    unlikely = float((freedom.precision * state.intrinsics**2).sum())
    return robust_cost(state, seen, loss_scale) + unlikely


# The normal equations


def linearise(
    state: State, seen: Observations, freedom: Freedom, loss_scale: float
) -> NormalEquations:
    """Return the normal equations about a state."""
    views, count = seen.weight.shape
    unknowns = 6 + state.intrinsics.shape[1]
    equations = NormalEquations(
        camera=np.zeros((views, unknowns, unknowns)),
        camera_gradient=np.zeros((views, unknowns)),
        point=np.empty((3, 3, count)),
        point_gradient=np.empty((3, count)),
        mixed=np.empty((views, unknowns, 3, count)),
    )
    work = partial(
        _linearise_block, state=state, seen=seen, loss_scale=loss_scale, equations=equations
    )
    for camera, camera_gradient in map_in_threads(work, blocks_of(state.points)):
        equations.camera[:] += camera
        equations.camera_gradient[:] += camera_gradient
    own = np.arange(6, unknowns)
    equations.camera[:, own, own] += freedom.precision
    equations.camera_gradient[:, own] += freedom.precision * state.intrinsics
    return equations


def _linearise_block(
    block: slice,
    *,
    state: State,
    seen: Observations,
    loss_scale: float,
    equations: NormalEquations,
) -> tuple[Floats, Floats]:
    """Fill in the equations of a block of points.

    Returns what the block adds to the cameras' blocks `[view, C, C]` and gradient `[view, C]`.
    """
    kernels = compiled(KERNELS)
    if kernels is None:
        found = jacobian(block, state, seen, loss_scale)
        equations.point[..., block] = np.einsum("vkin,vkjn->ijn", found.point, found.point)
        equations.point_gradient[:, block] = np.einsum("vkin,vkn->in", found.point, found.residual)
        equations.mixed[..., block] = np.einsum("vkin,vkjn->vijn", found.camera, found.point)
        camera = np.einsum("vkin,vkjn->vij", found.camera, found.camera, optimize=True)
        return camera, np.einsum("vkin,vkn->vi", found.camera, found.residual)
    residuals, robust, slopes = slopes_of(block, state, seen, loss_scale)
    residual = residuals.residual * robust[:, None]
    views, unknowns = equations.camera_gradient.shape
    camera = np.empty((views, unknowns, *residual.shape[1:]))
    kernels.normal_equations(
        block.start,
        *contiguous(state.rotation, residuals.in_camera),
        slopes.in_camera,
        slopes.intrinsics,
        residual,
        equations.point,
        equations.point_gradient,
        equations.mixed,
        camera,
    )
    rows = camera.reshape(views, unknowns, -1)
    gradient = np.matmul(rows, residual.reshape(views, -1, 1))[..., 0]
    return np.matmul(rows, np.swapaxes(rows, 1, 2)), gradient


# The step


def _step(state: State, equations: NormalEquations, freedom: Freedom, damping: float) -> State:
    """Return the state after a damped Gauss-Newton step of cameras and points.

    First the reduced camera system S dc = -(a - W V^-1 b), where S = U - W V^-1 W' is the Schur
    complement of V; then each point by itself, dp = -V^-1 (b + W' dc).
    """
    inverse, schur, gradient = eliminate_points(equations, damping)
    cameras = _solve_cameras(schur, gradient, freedom.basis)
    from_cameras = cameras @ equations.mixed.reshape(len(cameras), -1)  # W' dc
    gradient = equations.point_gradient + from_cameras.reshape(state.points.shape)
    points = -np.einsum("ijn,jn->in", inverse, gradient)
    return _move(state, cameras.reshape(len(state.rotation), -1), points)


def eliminate_points(equations: NormalEquations, damping: float) -> tuple[Floats, Floats, Floats]:
    """Return V^-1 `[3, 3, N]`, S `[C view, C view]` and a - W V^-1 b `[C view]`."""
    (views, unknowns), count = equations.camera_gradient.shape, equations.point.shape[2]
    inverse = np.empty((3, 3, count))
    work = partial(_eliminate_block, equations=equations, damping=damping, inverse=inverse)
    schur = np.zeros((unknowns * views, unknowns * views))
    gradient = equations.camera_gradient.reshape(-1).copy()
    for matrix, side in map_in_threads(work, blocks_of(equations.point_gradient)):
        schur -= matrix
        gradient -= side
    for view, camera in enumerate(equations.camera):
        own = slice(unknowns * view, unknowns * (view + 1))
        schur[own, own] += camera + damping * np.diag(np.diag(camera))
    return inverse, schur, gradient


def _eliminate_block(
    block: slice, *, equations: NormalEquations, damping: float, inverse: Floats
) -> tuple[Floats, Floats]:
    """Return W V^-1 W' `[C view, C view]` and W V^-1 b `[C view]` of a block.

    inverse: `[3, 3, N]`, of which V^-1 of the block is filled in.
    """
    root, product = _rooted(block, equations, damping, inverse)
    rows = product.reshape(len(product), -1)
    side = np.einsum("jkn,jn->kn", root, equations.point_gradient[:, block])
    return rows @ rows.T, rows @ side.reshape(-1)


def _rooted(
    block: slice, equations: NormalEquations, damping: float, inverse: Floats
) -> tuple[Floats, Floats]:
    """Return a root Q of V^-1 = QQ' `[3, 3, n]` of a block, and W Q `[C view, 3, n]`.

    inverse: as of `_eliminate_block`.
    """
    kernels = compiled(KERNELS)
    if kernels is None:
        root = _damped_root(equations.point[..., block], damping)
        inverse[..., block] = np.einsum("ikn,jkn->ijn", root, root)
        mixed = equations.mixed.reshape(-1, *equations.point_gradient.shape)[..., block]
        return root, np.einsum("rjn,jkn->rkn", mixed, root)
    views, unknowns = equations.camera_gradient.shape
    count = equations.point_gradient[:, block].shape[1]
    root, product = np.empty((3, 3, count)), np.empty((views * unknowns, 3, count))
    kernels.damped_products(
        block.start, damping, equations.point, equations.mixed, inverse, root, product
    )
    return root, product


def _damped_root(matrix: Floats, damping: float) -> Floats:
    """Return Q of QQ' = V^-1 of matrices V `[3, 3, n]` whose diagonals are damped."""
    damped = matrix.transpose(2, 0, 1).copy()  # [n, 3, 3]
    diagonal = np.einsum("nii->ni", damped)  # a view: what is added to it is added to `damped`
    diagonal *= 1 + damping
    largest = diagonal.max(1, keepdims=True)
    # a point that no view sees stays where it is
    diagonal += np.where(largest > 0, 1e-12 * largest, 1.0)
    root = np.linalg.inv(np.linalg.cholesky(damped)).transpose(2, 1, 0)
    return np.ascontiguousarray(root, dtype=np.float64)


def _solve_cameras(schur: Floats, gradient: Floats, basis: Floats) -> Floats:
    """Return the step of the cameras `[C view]`, S dc = -gradient, in the space of a basis.

    basis: `[C view, free]` as in `Freedom`.
    """
    matrix = basis.T @ schur @ basis
    stiffness = np.diag(matrix)
    # rounding may leave a direction that nothing constrains below zero
    scale = 1 / np.sqrt(np.maximum(stiffness, 1e-15 * stiffness.max() + 1e-150))
    scaled = scale[:, None] * matrix * scale + 1e-12 * np.eye(len(matrix))
    return basis @ (-scale * np.linalg.solve(scaled, scale * (gradient @ basis)))


def _move(state: State, cameras: Floats, points: Floats) -> State:
    """Return the state after steps of the cameras `[view, C]` and of the points `[3, N]`."""
    rotation = matrix_from_vector(cameras[:, :3])
    translation = np.einsum("vij,vj->vi", rotation, state.translation) + cameras[:, 3:6]
    return State(
        rotation=rotation @ state.rotation,
        translation=translation,
        points=state.points + points,
        intrinsics=state.intrinsics + cameras[:, 6:],
    )
