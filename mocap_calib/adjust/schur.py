"""Minimise a robust reprojection error over cameras and points, with the points eliminated.

Levenberg and Marquardt's iteration on the reduced camera system (Triggs, McLauchlan, Hartley and
Fitzgibbon 2000: "Bundle Adjustment - A Modern Synthesis", section 6.1).
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mocap_calib.adjust.freedom import Freedom
from mocap_calib.adjust.residuals import (
    Observations,
    Slopes,
    State,
    blocks_of,
    part_of,
)
from mocap_calib.adjust.settling import Weighed, settle
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import (
    LM_DAMPING_FACTOR,
    LM_FIRST_DAMPING,
    LM_LEAST_DAMPING,
    LM_MOST_DAMPING,
    LM_STEPS,
)
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.kernels import schur as kernels
from mocap_calib.kernels.loading import contiguous
from mocap_calib.types import Floats


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


def minimise(
    state: State, seen: Observations, freedom: Freedom, *, loss_scale: float, tolerance: float
) -> State:
    """Return the state of least robust cost: Cauchy's loss at `loss_scale` standard deviations.

    The scale of the rig is free. The points settle after each step of the cameras. It ends with a
    step that promises to lower the cost by no more than the share `tolerance`, after which the
    points have yet to settle (`settle_points`).
    """
    damping = LM_FIRST_DAMPING
    now = _reduce(state, seen, freedom, loss_scale)
    for _ in range(LM_STEPS):
        step = _solve_cameras(now, freedom.basis, damping)
        moved = _move(now.state, step)
        promised = -float(step.ravel() @ now.gradient)
        if damping <= LM_FIRST_DAMPING and promised <= tolerance * now.cost:
            return moved
        then = _reduce(moved, seen, freedom, loss_scale)
        if then.cost < now.cost:
            now = then
            damping = max(damping / LM_DAMPING_FACTOR, LM_LEAST_DAMPING)
        else:
            damping *= LM_DAMPING_FACTOR
            if damping > LM_MOST_DAMPING:
                break
    return now.state


def settle_points(state: State, seen: Observations, *, loss_scale: float) -> State:
    """Return the state with its points where they cost least while the cameras stay."""

    def work(block: slice) -> Floats:
        part = part_of(block, state, seen)
        return settle(part.block, part.state, part.seen, loss_scale).points

    points = map_in_threads(work, blocks_of(state.points))
    return replace(state, points=np.concatenate(list(points), axis=1))


# The normal equations


def equations_of(
    rotation: Floats, in_camera: Floats, slopes: Slopes, residual: Floats
) -> NormalEquations:
    """Return the equations of some points, given their weighed derivatives.

    in_camera: `[view, 3, n]` the points; residual: `[view, 2, n]`, weighed. What is known of the
    intrinsics beforehand is not in them (`prior_of`).
    """
    (views, _, count), unknowns = in_camera.shape, 6 + slopes.intrinsics.shape[2]
    camera = np.empty((views, unknowns, 2, count))
    point, point_gradient = np.empty((3, 3, count)), np.empty((3, count))
    mixed = np.empty((views, unknowns, 3, count))
    given = contiguous(rotation, in_camera, slopes.in_camera, slopes.intrinsics, residual)
    kernels.normal_equations(*given, point, point_gradient, mixed, camera)
    blocks, gradient = _own_blocks(camera, residual)
    return NormalEquations(blocks, gradient, point, point_gradient, mixed)


# The reduced camera system


def eliminate_points(equations: NormalEquations) -> tuple[Floats, Floats, Floats]:
    """Return V^-1 `[3, 3, N]`, and the system S dc = -g of the cameras.

    S = U - W V^-1 W' is the Schur complement of V, `[C view, C view]`; g = a - W V^-1 b.
    """
    root, product = _rooted(equations)
    side = np.einsum("jkn,jn->kn", root, equations.point_gradient)
    gradient = equations.camera_gradient
    return (
        np.einsum("ikn,jkn->ijn", root, root),
        *_schur_complement(equations.camera, gradient, product, side),
    )


def _schur_complement(
    camera: Floats, gradient: Floats, product: Floats, side: Floats
) -> tuple[Floats, Floats]:
    """Return S and g of `eliminate_points`.

    camera, gradient: as of `NormalEquations`. product: W Q `[C view, 3, n]` with a root Q of V^-1;
    side: Q'b `[3, n]`.
    """
    rows, unknowns = product.reshape(len(product), -1), camera.shape[1]
    matrix = -(rows @ rows.T)
    for view, block in enumerate(camera):
        own = slice(unknowns * view, unknowns * (view + 1))
        matrix[own, own] += block
    return matrix, gradient.reshape(-1) - rows @ side.reshape(-1)


def _rooted(equations: NormalEquations) -> tuple[Floats, Floats]:
    """Return a root Q of V^-1 = QQ' `[3, 3, N]`, and W Q `[C view, 3, N]`."""
    mixed = equations.mixed.reshape(-1, *equations.point_gradient.shape)
    root, product = np.empty_like(equations.point), np.empty_like(mixed)
    kernels.rooted(equations.point, mixed, root, product)
    return root, product


@dataclass(frozen=True)
class _Reduced:
    """The system of the cameras about a state whose points have settled.

    matrix: `[C view, C view]` and gradient: `[C view]` as of `eliminate_points`.
    stiffness: `[C view]` the diagonals of the cameras' own blocks, which damping adds to.
    """

    state: State
    cost: float
    matrix: Floats
    gradient: Floats
    stiffness: Floats


def prior_of(freedom: Freedom, state: State) -> tuple[Floats, Floats]:
    """Return what is known of the intrinsics beforehand: stiffness and gradient `[view, C]`."""
    stiffness = np.zeros((len(state.rotation), 6 + state.intrinsics.shape[1]))
    stiffness[:, 6:] = freedom.precision
    gradient = np.zeros_like(stiffness)
    gradient[:, 6:] = freedom.precision * state.intrinsics
    return stiffness, gradient


def _reduce(state: State, seen: Observations, freedom: Freedom, loss_scale: float) -> _Reduced:
    """Let the points of a state settle, and return the system of the cameras about it."""
    work = partial(_reduce_block, state=state, seen=seen, loss_scale=loss_scale)
    blocks = list(map_in_threads(work, blocks_of(state.points)))
    points, costs, matrices, gradients, stiffness = zip(*blocks, strict=True)
    known, pull = (part.ravel() for part in prior_of(freedom, state))
    unlikely = float((freedom.precision * state.intrinsics**2).sum())
    return _Reduced(
        state=replace(state, points=np.concatenate(points, axis=1)),
        cost=sum(costs) * loss_scale**2 + unlikely,
        matrix=sum(matrices) + np.diag(known),
        gradient=sum(gradients) + pull,
        stiffness=sum(stiffness) + known,
    )


def _reduce_block(
    block: slice, *, state: State, seen: Observations, loss_scale: float
) -> tuple[Floats, float, Floats, Floats, Floats]:
    """Return a block of points where they settle, their cost / s^2, and their part of the rest."""
    part = part_of(block, state, seen)
    found = settle(part.block, part.state, part.seen, loss_scale)
    camera, matrix, gradient = _reduced_system(part.state.rotation, found)
    views, unknowns = len(state.rotation), camera.shape[1]
    own = (unknowns * part.views[:, None] + np.arange(unknowns)).ravel()
    of_all, vectors = np.zeros((views * unknowns,) * 2), np.zeros((2, views * unknowns))
    of_all[np.ix_(own, own)] = matrix
    vectors[:, own] = gradient, np.einsum("vii->vi", camera).ravel()
    return found.points, found.cost, of_all, *vectors


def _reduced_system(rotation: Floats, found: Weighed) -> tuple[Floats, Floats, Floats]:
    """Return the cameras' own blocks `[view, C, C]` and the reduced system of some points."""
    (views, _, count), unknowns = found.in_camera.shape, 6 + found.slopes.intrinsics.shape[2]
    camera, side = np.empty((views, unknowns, 2, count)), np.empty((3, count))
    product = np.empty((views * unknowns, 3, count))
    slopes = found.slopes.in_camera, found.slopes.intrinsics
    given = contiguous(rotation, found.in_camera, *slopes, found.residual)
    kernels.reduced(*given, camera, product, side)
    own = _own_blocks(camera, found.residual)
    return own[0], *_schur_complement(*own, product, side)


def _own_blocks(camera: Floats, residual: Floats) -> tuple[Floats, Floats]:
    """Return the cameras' blocks U `[view, C, C]` and gradients a `[view, C]`.

    camera: `[view, C, 2, n]` the derivatives; residual: `[view, 2, n]`.
    """
    rows = camera.reshape(*camera.shape[:2], -1)
    gradient = np.matmul(rows, residual.reshape(len(rows), -1, 1))[..., 0]
    return np.matmul(rows, np.swapaxes(rows, 1, 2)), gradient


# The step


def _solve_cameras(reduced: _Reduced, basis: Floats, damping: float) -> Floats:
    """Return the damped step of the cameras `[view, C]`, in the space of a basis.

    basis: `[C view, free]` as in `Freedom`.
    """
    damped = reduced.matrix + damping * np.diag(reduced.stiffness)
    matrix = basis.T @ damped @ basis
    stiffness = np.diag(matrix)
    # rounding may leave a direction that nothing constrains below zero
    scale = 1 / np.sqrt(np.maximum(stiffness, 1e-15 * stiffness.max() + 1e-150))
    scaled = scale[:, None] * matrix * scale + 1e-12 * np.eye(len(matrix))
    step = basis @ (-scale * np.linalg.solve(scaled, scale * (reduced.gradient @ basis)))
    return step.reshape(len(reduced.state.rotation), -1)


def _move(state: State, cameras: Floats) -> State:
    """Return the state after steps of the cameras `[view, C]`."""
    rotation = matrix_from_vector(cameras[:, :3])
    translation = np.einsum("vij,vj->vi", rotation, state.translation) + cameras[:, 3:6]
    return State(
        rotation=rotation @ state.rotation,
        translation=translation,
        points=state.points,
        intrinsics=state.intrinsics + cameras[:, 6:],
    )
