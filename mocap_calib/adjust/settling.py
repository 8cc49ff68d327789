"""Points where they cost least while the cameras stay, and the system of the cameras about them.

A point is three numbers: it settles at once, while in the steps of all cameras together it lags
behind wherever what was seen of it disagrees (Ruhe and Wedin 1980: "Algorithms for Separable
Nonlinear Least Squares Problems").
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.adjust.pixel_residuals import PixelObservations
from mocap_calib.adjust.ray_residuals import RayObservations, TimedRayObservations
from mocap_calib.adjust.residuals import (
    BEHIND,
    Observations,
    Slopes,
    State,
    slopes_of,
)
from mocap_calib.config import LM_POINT_GAIN, LM_POINT_STEPS
from mocap_calib.kernels.loading import compiled, contiguous
from mocap_calib.types import Floats

KERNELS = "mocap_calib.kernels.settling"


@dataclass(frozen=True)
class Weighed:
    """A block of points that have settled, as the cameras see them.

    points: `[3, n]` in world coordinates; in_camera: `[view, 3, n]` in each camera's frame.
    slopes and residual, `[view, 2, n]`: weighed by the root of their robust weight.
    cost: divided by the square of the loss scale.
    """

    points: Floats
    in_camera: Floats
    slopes: Slopes
    residual: Floats
    cost: float


def settle(block: slice, state: State, seen: Observations, loss_scale: float) -> Weighed:
    """Return a block of points of a state where they cost least, about as the state has them.

    They end as soon as a step hardly lowers the cost, or would raise it.
    """
    kernels = compiled(KERNELS)
    origin = state.translation[:, :, None]
    if kernels is not None and isinstance(seen, RayObservations):
        given = origin, seen.rays, seen.metric, seen.weight
        return _settle_by_kernel(kernels.settle_rays, given, block, state, loss_scale)
    if kernels is not None and isinstance(seen, TimedRayObservations):
        rays = seen.rays
        given = origin + seen.shifts(block, state), rays.rays, rays.metric, rays.weight
        found = _settle_by_kernel(kernels.settle_rays, given, block, state, loss_scale)
        by_point = found.slopes.in_camera
        return replace(found, slopes=Slopes(by_point, seen.by_offset(block, state, by_point)))
    if kernels is not None and isinstance(seen, PixelObservations):
        given = origin, seen.lens_rows(state), seen.pixels, seen.weight
        return _settle_by_kernel(kernels.settle_pixels, given, block, state, loss_scale)
    seen = seen.select(np.arange(state.points.shape[1])[block])
    state = replace(state, points=state.points[:, block])
    return _weigh(replace(state, points=_settle(state, seen, loss_scale)), seen, loss_scale)


def _settle_by_kernel(
    kernel: Callable[..., float],
    given: tuple[Floats, ...],
    block: slice,
    state: State,
    loss_scale: float,
) -> Weighed:
    """Return what `settle` returns; given: what was seen, as the kernel takes it."""
    points = state.points[:, block].copy(order="C")
    (views, intrinsics), count = state.intrinsics.shape, points.shape[1]
    in_camera, residual = np.empty((views, 3, count)), np.empty((views, 2, count))
    slope, own = np.empty((views, 2, 3, count)), np.empty((views, 2, intrinsics, count))
    options = np.array([loss_scale**2, BEHIND, LM_POINT_GAIN])
    given = (*contiguous(state.rotation, *given), options)
    changed = (points, in_camera, slope, own, residual)
    cost = kernel(block.start, *given, LM_POINT_STEPS, *changed)
    return Weighed(points, in_camera, Slopes(slope, own), residual, cost)


def _settle(state: State, seen: Observations, loss_scale: float) -> Floats:
    """Return the points `[3, N]` of a state where they cost least."""
    points = state.points.copy(order="C")
    moving = np.arange(points.shape[1])
    now = _pull(state, seen, loss_scale)
    for _ in range(LM_POINT_STEPS):
        step = np.linalg.solve(now.matrix, now.gradient[..., None])[..., 0].T
        tried = replace(state, points=points[:, moving] - step)
        seen_then = seen.select(moving)
        then = _pull(tried, seen_then, loss_scale)
        better = (now.weight * (then.square - now.square)).sum(0) <= 0
        points[:, moving[better]] = tried.points[:, better]
        goes_on = better & (np.einsum("nk,kn->n", now.gradient, step) > LM_POINT_GAIN)
        moving, now = moving[goes_on], then.select(goes_on)
        if not len(moving):
            break
    return points


@dataclass(frozen=True)
class _Pull:
    """What moves points: B'B `[n, 3, 3]` and B'r `[n, 3]` of what was seen of them.

    square, weight: `[view, n]` of the residuals.
    """

    matrix: Floats
    gradient: Floats
    square: Floats
    weight: Floats

    def select(self, points: Floats) -> "_Pull":
        """Return what moves some of the points."""
        return _Pull(
            self.matrix[points],
            self.gradient[points],
            self.square[:, points],
            self.weight[:, points],
        )


def _pull(state: State, seen: Observations, loss_scale: float) -> _Pull:
    """Return what moves the points of a state."""
    found, robust, slopes = slopes_of(slice(0, state.points.shape[1]), state, seen, loss_scale)
    by_point = np.einsum("vkin,vij->kvjn", slopes.in_camera, state.rotation)
    residual = np.swapaxes(found.residual * robust[:, None], 0, 1)
    rows = by_point.reshape(-1, *by_point.shape[2:])
    matrix = np.einsum("rin,rjn->nij", rows, rows)
    diagonal = np.einsum("nii->ni", matrix)  # a view: what is added to it is added to `matrix`
    largest = diagonal.max(1, keepdims=True)
    diagonal += np.where(largest > 0, 1e-12 * largest, 1.0)
    return _Pull(
        matrix=matrix,
        gradient=np.einsum("rin,rn->ni", rows, residual.reshape(len(rows), -1)),
        square=np.einsum("vkn,vkn->vn", found.residual, found.residual),
        weight=robust**2,
    )


def _weigh(state: State, seen: Observations, loss_scale: float) -> Weighed:
    """Return all points of a state as the cameras see them."""
    found, robust, slopes = slopes_of(slice(0, state.points.shape[1]), state, seen, loss_scale)
    square = np.einsum("vkn,vkn->vn", found.residual, found.residual)
    share = square / loss_scale**2
    return Weighed(
        points=state.points,
        in_camera=found.in_camera,
        slopes=slopes,
        residual=found.residual * robust[:, None],
        cost=float((seen.weight * np.log1p(share)).sum()),
    )
