"""Residuals of cameras and points against observed rays, for lenses that are known.

Clocks may differ: `TimedRayObservations`.

Residuals are taken in the plane that touches the unit sphere at the observed ray, to first order in
pixels: any lens will do, without its derivatives.
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib.adjust.motion import Motion
from mocap_calib.adjust.residuals import (
    Residuals,
    Slopes,
    State,
    points_in_cameras,
    positive_depth,
)
from mocap_calib.kernels.loading import contiguous
from mocap_calib.types import Floats, Ints


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

    def select(self, points: Ints) -> "RayObservations":
        """Return what was seen of some of the points, given their indices."""
        return RayObservations(
            *contiguous(self.rays[..., points], self.metric[..., points], self.weight[:, points])
        )

    def part(self, views: Ints, block: slice) -> "RayObservations":
        """Return what some views saw of a block of points."""
        rays, metric = self.rays[views, :, block], self.metric[views, :, :, block]
        return RayObservations(*contiguous(rays, metric, self.weight[views, block]))

    def residuals(self, block: slice, state: State) -> Residuals:
        """Return a block of points as the cameras see them: r = M x / (u'x).

        x is the point in the camera's frame, u the observed ray and M its metric.
        """
        return self.residuals_of(block, points_in_cameras(block, state))

    def residuals_of(self, block: slice, in_camera: Floats) -> Residuals:
        """Return the residuals of a block of points `[view, 3, n]` in each camera's frame."""
        along = np.einsum("vin,vin->vn", self.rays[..., block], in_camera)
        depth, behind = positive_depth(in_camera, along)
        offset = np.einsum("vkin,vin->vkn", self.metric[..., block], in_camera)
        return Residuals(
            in_camera=in_camera,
            depth=depth,
            residual=offset / depth[:, None],
            behind=behind,
        )

    def slopes(self, block: slice, _state: State, found: Residuals, weight: Floats, /) -> Slopes:
        """Return the weighed derivatives: with r = M x / (u'x), dr/dx = (M - r u') / (u'x)."""
        views, rows, count = found.residual.shape
        none = np.empty((views, rows, 0, count))
        rays = self.rays[:, None, :, block]
        slope = self.metric[..., block] - found.residual[:, :, None] * rays
        slope = slope * (weight / found.depth)[:, None, None]
        return Slopes(in_camera=slope, intrinsics=none)


@dataclass(frozen=True)
class TimedRayObservations:
    """What cameras whose clocks differ saw of N points that move.

    A state's one intrinsic of a camera is the offset of its clock in frames: it sees each point
    where that is so much later.

    motion: of the points in the world.
    """

    rays: RayObservations
    motion: Motion

    @property
    def weight(self) -> Floats:
        """What each detection counts for."""
        return self.rays.weight

    def select(self, points: Ints) -> "TimedRayObservations":
        """Return what was seen of some of the points, given their indices."""
        return TimedRayObservations(self.rays.select(points), self.motion.select(points))

    def part(self, views: Ints, block: slice) -> "TimedRayObservations":
        """Return what some views saw of a block of points."""
        return TimedRayObservations(self.rays.part(views, block), self.motion.select(block))

    def residuals(self, block: slice, state: State) -> Residuals:
        """Return a block of points as the cameras see them, each at its own time."""
        in_camera = points_in_cameras(block, state) + self.shifts(block, state)
        return self.rays.residuals_of(block, in_camera)

    def slopes(self, block: slice, state: State, found: Residuals, weight: Floats, /) -> Slopes:
        """Return the weighed derivatives."""
        by_point = self.rays.slopes(block, state, found, weight).in_camera
        return Slopes(in_camera=by_point, intrinsics=self.by_offset(block, state, by_point))

    def shifts(self, block: slice, state: State) -> Floats:
        """Return how far points move until cameras see them, in their frames: `[view, 3, n]`."""
        moved = self.motion.select(block).displacement(state.intrinsics[:, 0])
        return np.asarray(np.matmul(state.rotation, moved))

    def by_offset(self, block: slice, state: State, by_point: Floats) -> Floats:
        """Return derivatives by the offset of each clock, `[view, 2, 1, n]`: by the velocity then.

        by_point: `[view, 2, 3, n]` those by the points in each camera's frame.
        """
        velocity = self.motion.select(block).velocity_after(state.intrinsics[:, 0])
        in_camera = np.matmul(state.rotation, velocity)
        return np.asarray(np.einsum("vkin,vin->vkn", by_point, in_camera)[:, :, None])
