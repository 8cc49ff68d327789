"""Minimise a robust reprojection error over cameras and points, with the points eliminated.

Levenberg and Marquardt's iteration on the reduced camera system (Triggs, McLauchlan, Hartley and
Fitzgibbon 2000: "Bundle Adjustment - A Modern Synthesis", section 6.1). The points are optimised
after each step of the cameras. The same iteration fits one camera to known points (`camera_fit`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from mocap_calib.adjust.residuals import POINT_STEPS, Block, Linearised, Residuals, State
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.kernels import adjustment as kernels
from mocap_calib.kernels.jit import contiguous
from mocap_calib.types import POSE, Floats, Ints

# Levenberg and Marquardt's damping; more of it after a step that raised the cost, less after others
_STEPS = 50
_FIRST_DAMPING, _MOST_DAMPING = 1e-4, 1e8
_DAMPING_FACTOR = 10.0

Unknowns = TypeVar("Unknowns")


# --- which parameters are free


@dataclass(frozen=True)
class Parameters:
    """The free parameters of cameras: poses, and intrinsics with a prior.

    Each camera has C parameters: turn, shift, and its intrinsics.
    basis: `[C view, free]` 1 where a parameter of a camera is one of the free ones, else 0.
    precision: `[view, intrinsic]` inverse variance of a change of intrinsics; views that share them
        have a part of it each.
    """

    basis: Floats
    precision: Floats

    @property
    def intrinsics(self) -> Ints:
        """Index `[view, intrinsic]` of the free parameter that each of the intrinsics is."""
        return np.asarray(self.by_view[:, POSE:].argmax(2), dtype=np.int64)

    @property
    def by_view(self) -> Floats:
        """The basis as `[view, C, free]`."""
        return self.basis.reshape(len(self.precision), -1, self.basis.shape[1])

    def prior(self, intrinsics: Floats) -> tuple[Floats, Floats]:
        """Return stiffness and gradient `[view, C]` of the prior at changes of intrinsics."""
        of_pose = np.zeros((len(intrinsics), POSE))
        gradient = np.concatenate([of_pose, self.precision * intrinsics], axis=1)
        return np.concatenate([of_pose, self.precision], axis=1), gradient


# --- the iteration


@dataclass(frozen=True)
class System(Generic[Unknowns]):
    """Gauss and Newton's equations of the free parameters about some unknowns.

    cost: robust, in squared residuals. matrix: `[free, free]` and gradient: `[free]`.
    stiffness: `[free]` what damping adds a share of to the diagonal of the matrix.
    """

    unknowns: Unknowns
    cost: float
    matrix: Floats
    gradient: Floats
    stiffness: Floats


def levenberg_marquardt(
    start: Unknowns,
    linearise: Callable[[Unknowns], System[Unknowns]],
    move: Callable[[Unknowns, Floats], Unknowns],
    *,
    tolerance: float,
    steps: int = _STEPS,
) -> Unknowns:
    """Return the unknowns of least cost.

    move: applies a step `[free]`. It ends with a step that promises to lower the cost by no more
    than the share `tolerance`, or after so many steps.
    """
    damping = _FIRST_DAMPING
    now = linearise(start)
    for _ in range(steps):
        step = solve_damped(now, damping)
        moved = move(now.unknowns, step)
        promised = -float(step @ now.gradient)
        if damping <= _FIRST_DAMPING and promised <= tolerance * now.cost:
            return moved
        then = linearise(moved)
        if then.cost < now.cost:
            now = then
            damping /= _DAMPING_FACTOR
        else:
            damping *= _DAMPING_FACTOR
            if damping > _MOST_DAMPING:
                break
    return now.unknowns


def solve_damped(system: System[Unknowns], damping: float) -> Floats:
    """Return the damped step `[free]`."""
    matrix = system.matrix + damping * np.diag(system.stiffness)
    stiffness = np.diag(matrix)
    # rounding may leave a direction that nothing constrains below zero
    scale = 1 / np.sqrt(np.maximum(stiffness, 1e-15 * stiffness.max() + 1e-150))
    scaled = scale[:, None] * matrix * scale + 1e-12 * np.eye(len(matrix))
    return -scale * np.asarray(np.linalg.solve(scaled, scale * system.gradient))


# --- a rig


def minimise(
    state: State, seen: Residuals, parameters: Parameters, *, loss_scale: float, tolerance: float
) -> State:
    """Return the state of least robust cost: Cauchy's loss at `loss_scale` standard deviations.

    The scale of the rig is free. tolerance: see `levenberg_marquardt`; the points have yet to be
    optimised after its last step (`optimise_points`).
    """
    return levenberg_marquardt(
        state,
        lambda now: _reduce(now, seen, parameters, loss_scale),
        lambda now, step: _move(now, (parameters.basis @ step).reshape(len(now.rotation), -1)),
        tolerance=tolerance,
    )


def optimise_points(state: State, seen: Residuals, *, loss_scale: float) -> State:
    """Return the state with the points of least cost for its cameras."""

    def work(block: Block) -> Floats:
        return block.seen.linearise(block.state(state), loss_scale).points

    points = map_in_threads(work, seen.blocks)
    return replace(state, points=np.concatenate(list(points), axis=1))


# --- the reduced camera system


def _reduce(
    state: State, seen: Residuals, parameters: Parameters, loss_scale: float
) -> System[State]:
    """Optimise the points of a state, and return the system of the free parameters about it."""
    unknowns = POSE + state.intrinsics.shape[1]
    size = unknowns * len(state.rotation)
    matrix, gradient, stiffness = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    points, cost = [], 0.0
    work = map_in_threads(lambda block: eliminate_points(block, state, loss_scale), seen.blocks)
    for block, found in zip(seen.blocks, work, strict=True):
        own = (unknowns * block.views[:, None] + np.arange(unknowns)).ravel()
        matrix[np.ix_(own, own)] += found.matrix
        gradient[own] += found.gradient
        stiffness[own] += found.stiffness
        points.append(found.linear.points)
        cost += found.linear.cost
    known, pull = (each.ravel() for each in parameters.prior(state.intrinsics))
    basis = parameters.basis
    return System(
        unknowns=replace(state, points=np.concatenate(points, axis=1)),
        cost=cost * loss_scale**2 + float((parameters.precision * state.intrinsics**2).sum()),
        matrix=basis.T @ (matrix + np.diag(known)) @ basis,
        gradient=basis.T @ (gradient + pull),
        stiffness=basis.T @ (stiffness + known),
    )


@dataclass(frozen=True)
class Eliminated:
    """The Gauss-Newton system S dc = -g of cameras, of which a block of points is eliminated.

    With the Jacobians A and B of C parameters of each camera and of the points, and residuals r:
    S = U - W V^-1 W' and g = A'r - W V^-1 B'r, where U = A'A, V = B'B and W = A'B. What is known of
    the intrinsics beforehand is not in it (`Parameters.prior`).

    linear: the residuals. camera: `[view, C, 2, n]` A. product: `[C view, 3, n]` W Q and side:
    `[3, n]` Q'B'r of a root Q of V^-1. matrix: S; gradient: g; stiffness: the diagonal of U.
    """

    linear: Linearised
    camera: Floats
    product: Floats
    side: Floats
    matrix: Floats
    gradient: Floats
    stiffness: Floats


def eliminate_points(
    block: Block, state: State, loss_scale: float, *, steps: int = POINT_STEPS
) -> Eliminated:
    """Return the system of the cameras of a block, its points optimised by so many steps.

    state: of all cameras and points.
    """
    rotation = state.rotation[block.views]
    linear = block.seen.linearise(block.state(state), loss_scale, steps)
    (views, _, count), unknowns = linear.in_camera.shape, POSE + linear.by_intrinsics.shape[2]
    camera, side = np.empty((views, unknowns, 2, count)), np.empty((3, count))
    product = np.empty((views * unknowns, 3, count))
    given = linear.in_camera, linear.by_point, linear.by_intrinsics, linear.residual
    kernels.reduced(*contiguous(rotation, *given, camera, product, side))
    rows, turned = camera.reshape(views, unknowns, -1), product.reshape(len(product), -1)
    blocks = np.matmul(rows, np.swapaxes(rows, 1, 2))
    gradient = np.matmul(rows, linear.residual.reshape(views, -1, 1)).ravel()
    matrix = -(turned @ turned.T)
    for view, diagonal in enumerate(blocks):
        own = slice(unknowns * view, unknowns * (view + 1))
        matrix[own, own] += diagonal
    return Eliminated(
        linear=linear,
        camera=camera,
        product=product,
        side=side,
        matrix=matrix,
        gradient=gradient - turned @ side.ravel(),
        stiffness=np.einsum("vii->vi", blocks).ravel(),
    )


def _move(state: State, cameras: Floats) -> State:
    """Return the state after steps of the cameras `[view, C]`."""
    rotation = matrix_from_vector(cameras[:, :3])
    translation = np.einsum("vij,vj->vi", rotation, state.translation) + cameras[:, 3:POSE]
    return State(
        rotation=rotation @ state.rotation,
        translation=translation,
        points=state.points,
        intrinsics=state.intrinsics + cameras[:, POSE:],
    )
