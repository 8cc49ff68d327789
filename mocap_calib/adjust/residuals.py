"""Robust cost of cameras and points against what was seen, and its derivatives, in blocks.

What was seen are rays, where the lenses are known (`ray_residuals`), or pixels, where they are
adjusted too (`pixel_residuals`). The loss is Cauchy's.

Arrays are kept by component, `[view, component, N]`, so that every step runs along all points at
once, in blocks of points that threads share.
"""

from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np

from mocap_calib.types import Bools, Floats, Ints

_BLOCK = 1024  # points at a time: what is computed of them stays in the cache

# Cosine between ray and point that stands for all points behind the camera: such a point fits
# nothing, and moves nothing.
BEHIND = 1e-6


@dataclass(frozen=True)
class State:
    """What is adjusted.

    rotation: `[view, 3, 3]` and translation: `[view, 3]` of cam_from_world.
    points: `[3, N]` in world coordinates.
    intrinsics: `[view, intrinsic]` changes of log focal length and k1; none of either where the
        lenses are known.
    """

    rotation: Floats
    translation: Floats
    points: Floats
    intrinsics: Floats


@dataclass(frozen=True)
class Residuals:
    """Points about a state as the cameras see them.

    in_camera: `[view, 3, n]` the points in each camera's frame.
    depth: `[view, n]` distance along the viewing direction, never zero or below.
    residual: `[view, 2, n]` in standard deviations.
    behind: `[view, n]` the point is behind the camera.
    """

    in_camera: Floats
    depth: Floats
    residual: Floats
    behind: Bools


@dataclass(frozen=True)
class Slopes:
    """Derivatives of the residuals.

    in_camera: `[view, 2, 3, n]` by the points in each camera's frame.
    intrinsics: `[view, 2, intrinsic, n]`.
    """

    in_camera: Floats
    intrinsics: Floats


class Observations(Protocol):
    """What the cameras saw of N points.

    weight: `[view, N]`, 0 = not seen.
    """

    @property
    def weight(self) -> Floats:
        """What each detection counts for."""

    def residuals(self, block: slice, state: State) -> Residuals:
        """Return a block of points as the cameras see them."""

    def slopes(self, block: slice, state: State, found: Residuals, weight: Floats, /) -> Slopes:
        """Return the derivatives of residuals that were found, times a weight `[view, n]`."""

    def select(self, points: Ints, /) -> Self:
        """Return what was seen of some of the points, given their indices."""

    def part(self, views: Ints, block: slice, /) -> Self:
        """Return what some views saw of a block of points."""


def blocks_of(points: Floats) -> list[slice]:
    """Return the blocks of points `[3, N]` that are worked on at a time."""
    count = points.shape[1]
    return [slice(start, min(start + _BLOCK, count)) for start in range(0, count, _BLOCK)]


@dataclass(frozen=True)
class Part:
    """A block of points, and of the cameras those that see it.

    views: their indices. block: where the points are in `state` and `seen`.
    """

    views: Ints
    block: slice
    state: State
    seen: Observations


def part_of(block: slice, state: State, seen: Observations) -> Part:
    """Return a block of points and the cameras that see it: in a large hall, a few of all."""
    views = np.flatnonzero((seen.weight[:, block] > 0).any(1))
    if len(views) in (0, len(seen.weight)):
        return Part(np.arange(len(seen.weight)), block, state, seen)
    points = state.points[:, block]
    rotation, translation = state.rotation[views], state.translation[views]
    own = State(rotation, translation, points, state.intrinsics[views])
    return Part(views, slice(0, points.shape[1]), own, seen.part(views, block))


def points_in_cameras(block: slice, state: State) -> Floats:
    """Return a block of points in each camera's frame, `[view, 3, n]`."""
    rotated = np.matmul(state.rotation, state.points[:, block])
    return rotated + state.translation[:, :, None]


def positive_depth(in_camera: Floats, depth: Floats) -> tuple[Floats, Bools]:
    """Return depths `[view, n]` that are never zero or below, and which points are behind.

    in_camera: `[view, 3, n]` the points in each camera's frame.
    """
    depth = np.maximum(depth, BEHIND * np.abs(in_camera).max(1))
    return depth, is_behind(in_camera, depth)


def is_behind(in_camera: Floats, depth: Floats) -> Bools:
    """Return which points are behind their cameras, of depths that were made positive."""
    return np.asarray(depth <= 2 * BEHIND * np.abs(in_camera).max(1))


def slopes_of(
    block: slice, state: State, seen: Observations, loss_scale: float
) -> tuple[Residuals, Floats, Slopes]:
    """Return the residuals of a block of points, their robust weight and weighed derivatives.

    The square root of the weight, `[view, n]`.
    """
    found = seen.residuals(block, state)
    robust = _robust_weight(found, seen.weight[:, block], loss_scale)
    return found, robust, seen.slopes(block, state, found, robust)


def _robust_weight(residuals: Residuals, weight: Floats, loss_scale: float) -> Floats:
    """Return the square root of Cauchy's weight, w / (1 + r'r / s^2), `[view, n]`."""
    square = np.einsum("vkn,vkn->vn", residuals.residual, residuals.residual)
    weight = np.where(residuals.behind, 0.0, weight)
    return np.sqrt(weight / (1 + square / loss_scale**2))
