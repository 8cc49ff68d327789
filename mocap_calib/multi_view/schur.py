"""Robust bundle adjustment of cameras and points by Levenberg and Marquardt, the points eliminated (Schur; Triggs et al. 2000).

Arrays are kept by component, `[view, component, N]`, so that every step runs along all points at once. Residuals are taken in
the plane that touches the unit sphere at the observed ray, to first order in pixels: any lens will do, without its derivatives.
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib.compute.parallel import in_order
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.types import Floats

_STEPS = 50
_MOST_DAMPING = 1e8
_BEHIND = 1e-6  # cosine between ray and point that stands for all that is behind: it fits nothing, and pulls at nothing
_BLOCK = 1024  # points at a time: what is computed of them stays in the cache


@dataclass(frozen=True)
class Sightings:
    """What was seen.

    rays: `[view, 3, N]` unit vectors in the camera's axes; metric: `[view, 2, 3, N]` turns a direction into the residual at its
    ray, in standard deviations; weight: `[view, N]`, 0 = not seen.
    """

    rays: Floats
    metric: Floats
    weight: Floats


@dataclass(frozen=True)
class State:
    """Cameras (cam_from_world `[view, 3, 3]`, `[view, 3]`) and points `[3, N]`."""

    rotation: Floats
    translation: Floats
    points: Floats


@dataclass(frozen=True)
class _Linear:
    """The normal equations about a state.

    camera: `[view, 6, 6]`, camera_side: `[view, 6]`; point: `[3, 3, N]`, point_side: `[3, N]`; mixed: `[view, 6, 3, N]`.
    """

    camera: Floats
    camera_side: Floats
    point: Floats
    point_side: Floats
    mixed: Floats


def minimise(state: State, seen: Sightings, scale: float, *, settled: float = 1e-5) -> State:
    """The state of least robust cost (Cauchy's loss at `scale` standard deviations). The first camera stays; the scale is free.

    It ends when a step lowers the cost by less than the share `settled`.
    """
    damping = 1e-4
    cost = _cost(state, seen, scale)
    linear = _linearise(state, seen, scale)
    for _ in range(_STEPS):
        moved = _step(state, linear, damping)
        after = _cost(moved, seen, scale)
        if not after < cost:
            damping *= 10
            if damping > _MOST_DAMPING:
                break
            continue
        last = cost - after <= settled * cost
        state, cost, damping = moved, after, max(damping / 10, 1e-10)
        if last:
            break
        linear = _linearise(state, seen, scale)
    return state


def _residuals(state: State, seen: Sightings, part: slice) -> tuple[Floats, Floats, Floats]:
    """Points in the cameras' axes `[view, 3, n]`, their distance along the ray `[view, n]` and the residuals `[view, 2, n]`."""
    inside = np.matmul(state.rotation, state.points[:, part]) + state.translation[:, :, None]
    along = np.einsum("vin,vin->vn", seen.rays[..., part], inside)
    along = np.maximum(along, _BEHIND * np.abs(inside).max(1))
    return (
        inside,
        along,
        np.einsum("vkin,vin->vkn", seen.metric[..., part], inside) / along[:, None],
    )


def _cost(state: State, seen: Sightings, scale: float) -> float:
    def work(part: slice) -> float:
        residual = _residuals(state, seen, part)[2]
        square = np.einsum("vkn,vkn->vn", residual, residual)
        return float((seen.weight[:, part] * np.log1p(square / scale**2)).sum())

    return sum(in_order(work, _blocks(state))) * scale**2


def _linearise(state: State, seen: Sightings, scale: float) -> _Linear:
    views, count = seen.weight.shape
    made = _Linear(
        np.zeros((views, 6, 6)),
        np.zeros((views, 6)),
        np.empty((3, 3, count)),
        np.empty((3, count)),
        np.empty((views, 6, 3, count)),
    )

    def work(part: slice) -> tuple[Floats, Floats]:
        camera, point, residual = _slopes(state, seen, part, scale)
        made.point[..., part] = np.einsum("vkin,vkjn->ijn", point, point)
        made.point_side[:, part] = np.einsum("vkin,vkn->in", point, residual)
        made.mixed[..., part] = np.einsum("vkin,vkjn->vijn", camera, point)
        return np.einsum("vkin,vkjn->vij", camera, camera, optimize=True), np.einsum(
            "vkin,vkn->vi", camera, residual
        )

    for matrix, side in in_order(work, _blocks(state)):
        made.camera[:] += matrix
        made.camera_side[:] += side
    return made


def _slopes(
    state: State, seen: Sightings, part: slice, scale: float
) -> tuple[Floats, Floats, Floats]:
    """Robustly weighted slopes of the residuals in cameras and points, and the residuals.

    Cameras: `[view, 2, 6, n]`, a turn about the camera, then a shift; points: `[view, 2, 3, n]`; residuals: `[view, 2, n]`.
    """
    inside, along, residual = _residuals(state, seen, part)
    behind = along <= 2 * _BEHIND * np.abs(inside).max(1)
    robust = np.sqrt(
        np.where(behind, 0.0, seen.weight[:, part])
        / (1 + np.einsum("vkn,vkn->vn", residual, residual) / scale**2)
    )
    slope = (seen.metric[..., part] - residual[:, :, None] * seen.rays[:, None, :, part]) * (
        robust / along
    )[:, None, None]
    camera = np.empty((*residual.shape[:2], 6, residual.shape[2]))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        camera[:, :, i] = slope[:, :, k] * inside[:, None, j] - slope[:, :, j] * inside[:, None, k]
    camera[:, :, 3:] = slope
    return camera, np.einsum("vkin,vij->vkjn", slope, state.rotation), residual * robust[:, None]


def _step(state: State, linear: _Linear, damping: float) -> State:
    """The damped Gauss-Newton step: the reduced system of the cameras, then each point by itself."""
    views, count = len(linear.camera), linear.point_side.shape[1]
    inverse = np.empty((3, 3, count))
    mixed = linear.mixed.reshape(6 * views, 3, count)

    def work(part: slice) -> tuple[Floats, Floats]:
        """What the points of a block take from the cameras' matrix and side."""
        square = linear.point[..., part].transpose(2, 0, 1).copy()  # (n, 3, 3)
        diagonal = np.einsum("nii->ni", square)
        diagonal *= 1 + damping
        largest = diagonal.max(1, keepdims=True)
        diagonal += np.where(
            largest > 0, 1e-12 * largest, 1.0
        )  # a point that no view holds stays where it is
        own = inverse[..., part] = np.linalg.inv(square).transpose(1, 2, 0).copy()
        # explicit: einsum has no fast way for it
        solved = np.stack(
            [sum(mixed[:, j, part] * own[j, k] for j in range(3)) for k in range(3)], axis=1
        ).reshape(6 * views, -1)
        return solved @ mixed[..., part].reshape(6 * views, -1).T, solved @ linear.point_side[
            :, part
        ].reshape(-1)

    reduced, side = np.zeros((6 * views, 6 * views)), linear.camera_side.reshape(-1).copy()
    for matrix, taken in in_order(work, _blocks(state)):
        reduced -= matrix
        side -= taken
    for view in range(views):
        block = slice(6 * view, 6 * view + 6)
        reduced[block, block] += linear.camera[view] + damping * np.diag(
            np.diag(linear.camera[view])
        )
    free = slice(6, None)  # the first camera is the frame of the world
    matrix = reduced[free, free]
    stiff = np.diag(matrix)  # rounding may leave what nothing holds below zero
    scale = 1 / np.sqrt(np.maximum(stiff, 1e-15 * stiff.max() + 1e-150))
    regular = scale[:, None] * matrix * scale + 1e-12 * np.eye(len(matrix))
    turn = np.zeros(6 * views)
    turn[free] = -scale * np.linalg.solve(regular, scale * side[free])
    shift = -np.einsum(
        "ijn,jn->in",
        inverse,
        linear.point_side + (turn @ mixed.reshape(6 * views, -1)).reshape(3, count),
    )
    small = matrix_from_vector(turn.reshape(views, 6)[:, :3])
    translation = np.einsum("vij,vj->vi", small, state.translation) + turn.reshape(views, 6)[:, 3:]
    return State(small @ state.rotation, translation, state.points + shift)


def _blocks(state: State) -> list[slice]:
    return [slice(k, k + _BLOCK) for k in range(0, state.points.shape[1], _BLOCK)]
