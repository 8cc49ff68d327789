"""Residuals of cameras and points against observed rays, their robust cost and derivatives.

Residuals are taken in the plane that touches the unit sphere at the observed ray, to first order in
pixels: any lens will do, without its derivatives. The loss is Cauchy's.

Arrays are kept by component, `[view, component, N]`, so that every step runs along all points at
once, in blocks of points that threads share.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.types import Bools, Floats

_BLOCK = 1024  # points at a time: what is computed of them stays in the cache

# Cosine between ray and point that stands for all points behind the camera: such a point fits
# nothing, and moves nothing.
_BEHIND = 1e-6


@dataclass(frozen=True)
class RayObservations:
    """What the cameras saw of N points.

    rays: `[view, 3, N]` unit vectors in each camera's frame.
    metric: `[view, 2, 3, N]` turns a direction into the residual at its ray, in standard
        deviations.
    weight: `[view, N]`, 0 = not seen.
    """

    rays: Floats
    metric: Floats
    weight: Floats


@dataclass(frozen=True)
class State:
    """What is adjusted.

    rotation: `[view, 3, 3]` and translation: `[view, 3]` of cam_from_world.
    points: `[3, N]` in world coordinates.
    """

    rotation: Floats
    translation: Floats
    points: Floats


@dataclass(frozen=True)
class _Residuals:
    """Points about a state as the cameras see them.

    in_camera: `[view, 3, n]` the points in each camera's frame.
    depth: `[view, n]` distance along the observed ray, never zero or below.
    residual: `[view, 2, n]` in standard deviations.
    behind: `[view, n]` the point is behind the camera.
    """

    in_camera: Floats
    depth: Floats
    residual: Floats
    behind: Bools


@dataclass(frozen=True)
class Jacobian:
    """Derivatives of the residuals, and the residuals, both weighed by the robust loss.

    camera: `[view, 2, 6, n]` by a rotation of the camera's frame (3) and a translation (3).
    point: `[view, 2, 3, n]` by the point in world coordinates.
    residual: `[view, 2, n]`.
    """

    camera: Floats
    point: Floats
    residual: Floats


def blocks_of(points: Floats) -> list[slice]:
    """Return the blocks of points `[3, N]` that are worked on at a time."""
    return [slice(start, start + _BLOCK) for start in range(0, points.shape[1], _BLOCK)]


def robust_cost(state: State, seen: RayObservations, loss_scale: float) -> float:
    """Return the robust cost: the sum of w s^2 log(1 + r'r / s^2)."""
    work = partial(_cost_of_block, state=state, seen=seen, loss_scale=loss_scale)
    return sum(map_in_threads(work, blocks_of(state.points))) * loss_scale**2


def _cost_of_block(
    block: slice, *, state: State, seen: RayObservations, loss_scale: float
) -> float:
    """Return what a block of points adds to the cost, divided by s^2."""
    residual = _residuals(block, state, seen).residual
    square = np.einsum("vkn,vkn->vn", residual, residual)
    loss = np.log1p(square / loss_scale**2)
    return float((seen.weight[:, block] * loss).sum())


def _residuals(block: slice, state: State, seen: RayObservations) -> _Residuals:
    """Return a block of points as the cameras see them: r = M x / (u'x), x in the camera's frame.

    u is the observed ray and M its metric.
    """
    rotated = np.matmul(state.rotation, state.points[:, block])
    in_camera = rotated + state.translation[:, :, None]
    size = np.abs(in_camera).max(1)
    depth = np.einsum("vin,vin->vn", seen.rays[..., block], in_camera)
    depth = np.maximum(depth, _BEHIND * size)
    offset = np.einsum("vkin,vin->vkn", seen.metric[..., block], in_camera)
    return _Residuals(
        in_camera=in_camera,
        depth=depth,
        residual=offset / depth[:, None],
        behind=depth <= 2 * _BEHIND * size,
    )


def jacobian(block: slice, state: State, seen: RayObservations, loss_scale: float) -> Jacobian:
    """Return the derivatives of the residuals of a block of points.

    With r = M x / (u'x): dr/dx = (M - r u') / (u'x). A rotation w about the camera's centre and a
    translation t move x by w x x + t; the point p moves it by R p.
    """
    found = _residuals(block, state, seen)
    robust = _robust_weight(found, seen.weight[:, block], loss_scale)
    rays = seen.rays[:, None, :, block]
    slope = seen.metric[..., block] - found.residual[:, :, None] * rays
    slope = slope * (robust / found.depth)[:, None, None]
    return Jacobian(
        camera=_camera_derivatives(slope, found.in_camera),
        point=np.einsum("vkin,vij->vkjn", slope, state.rotation),
        residual=found.residual * robust[:, None],
    )


def _robust_weight(residuals: _Residuals, weight: Floats, loss_scale: float) -> Floats:
    """Return the square root of Cauchy's weight, w / (1 + r'r / s^2), `[view, n]`."""
    square = np.einsum("vkn,vkn->vn", residuals.residual, residuals.residual)
    weight = np.where(residuals.behind, 0.0, weight)
    return np.sqrt(weight / (1 + square / loss_scale**2))


def _camera_derivatives(slope: Floats, in_camera: Floats) -> Floats:
    """Return `[view, 2, 6, n]` derivatives by a rotation and a translation of the cameras.

    slope: `[view, 2, 3, n]` derivatives by the points in_camera `[view, 3, n]`.
    """
    views, rows, _, count = slope.shape
    camera = np.empty((views, rows, 6, count))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        camera[:, :, i] = (
            slope[:, :, k] * in_camera[:, None, j] - slope[:, :, j] * in_camera[:, None, k]
        )
    camera[:, :, 3:] = slope
    return camera
