"""Residuals of cameras and points against what was seen: rays, where lenses are known, or pixels.

The loss is Cauchy's. Points are optimised for fixed cameras, each by itself, and the residuals are
linearised there (embedded point iterations: Ruhe and Wedin 1980, "Algorithms for Separable
Nonlinear Least Squares Problems"). Kernels do both, in blocks of points that threads share.

Residuals against rays are taken in the plane that touches the unit sphere at the observed ray, to
first order in pixels: any lens will do, without its derivatives.
"""

from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np

from mocap_calib.geometry import lens
from mocap_calib.geometry.lens import image_slopes
from mocap_calib.kernels import adjustment as kernels
from mocap_calib.kernels.jit import contiguous
from mocap_calib.types import Camera, Floats, Ints

_BLOCK = 1024  # points at a time: what is computed of them stays in the cache
_NO_LENS = np.empty((0, 14))  # of a camera whose rays are known

# Cosine between ray and point that stands for all points behind the camera: such a point fits
# nothing, and moves nothing.
_BEHIND = 1e-6
POINT_STEPS = 10  # of a point, at most, until one
_POINT_GAIN = 1e-4  # lowers its cost by less, in squared standard deviations


@dataclass(frozen=True)
class State:
    """The unknowns of an adjustment.

    rotation: `[view, 3, 3]` and translation: `[view, 3]` of cam_from_world.
    points: `[3, N]` in world coordinates.
    intrinsics: `[view, intrinsic]` changes of log focal length and k1, or the offset of the clock
        in frames; none where all are known.
    """

    rotation: Floats
    translation: Floats
    points: Floats
    intrinsics: Floats

    def with_points(self, points: Floats) -> "State":
        """Return the state with other points `[3, N]`."""
        return replace(self, points=points)


@dataclass(frozen=True)
class Linearised:
    """Residuals of a block of points and their derivatives, times the root of robust weights.

    points: `[3, n]` in world coordinates; in_camera: `[view, 3, n]` in each camera's frame.
    by_point: `[view, 2, 3, n]` derivatives by the points in each camera's frame.
    by_intrinsics: `[view, 2, intrinsic, n]`.
    residual: `[view, 2, n]` in standard deviations.
    cost: divided by the square of the loss scale.
    """

    points: Floats
    in_camera: Floats
    by_point: Floats
    by_intrinsics: Floats
    residual: Floats
    cost: float


class Residuals(Protocol):
    """What the cameras saw of N points, as residuals; weight: `[view, N]`, 0 = not seen."""

    @property
    def weight(self) -> Floats:
        """What each detection counts for."""

    def linearise(
        self, block: slice, state: State, loss_scale: float, steps: int = POINT_STEPS
    ) -> Linearised:
        """Return the residuals of a block of points about a state, the points optimised first.

        steps: of each point, at most; none leaves the points where they are.
        """

    def part(self, views: Ints, block: slice, /) -> Self:
        """Return the residuals of a block of points in some views."""


@dataclass(frozen=True)
class RayResiduals:
    """Residuals against rays.

    rays: `[view, 3, N]` unit vectors in each camera's frame.
    metric: `[view, 2, 3, N]` turns a direction into the residual at its ray, in standard
        deviations.
    weight: `[view, N]`, 0 = not seen.
    """

    rays: Floats
    metric: Floats
    weight: Floats

    @classmethod
    def of(
        cls, cameras: tuple[Camera, ...], rays: Floats, noise: Floats, weight: Floats
    ) -> "RayResiduals":
        """Return residuals in standard deviations, to first order those of pixels.

        rays: `[view, 3, N]`, NaN = missing. noise: `[view]` in radians. weight: `[view, N]`.
        """
        used = np.asarray(weight > 0)
        axis = np.array([0.0, 0.0, 1.0])[:, None]
        rays = np.where(used[:, None], rays, axis)
        metric = np.zeros((len(rays), 2, *rays.shape[1:]))
        for view, camera in enumerate(cameras):
            slopes = _pixels_per_ray(camera, rays[view]) / (noise[view] * camera.focal)
            metric[view] = np.where(used[view], np.nan_to_num(slopes), 0.0)
        return cls(*contiguous(rays, metric, weight))

    def part(self, views: Ints, block: slice) -> "RayResiduals":
        """Return the residuals of a block of points in some views."""
        rays, metric = self.rays[views, :, block], self.metric[views, :, :, block]
        return RayResiduals(*contiguous(rays, metric, self.weight[views, block]))

    def linearise(
        self, block: slice, state: State, loss_scale: float, steps: int = POINT_STEPS
    ) -> Linearised:
        """Return the residuals about a state, r = M x / (u'x) of a ray u and its metric M."""
        given = state.translation[:, :, None], _NO_LENS, self.rays, self.metric, self.weight
        return _linearise(given, block, state, loss_scale=loss_scale, steps=steps)


@dataclass(frozen=True)
class PixelResiduals:
    """Residuals against pixels, of lenses that are adjusted.

    cameras: with the intrinsics that a state changes: log focal length and, where it has two
        intrinsics, k1.
    pixels: `[view, 2, N]`, any number where nothing was seen.
    sigma: `[view]` standard deviation of a coordinate, in pixels.
    weight: `[view, N]`, 0 = not seen.
    """

    cameras: tuple[Camera, ...]
    pixels: Floats
    sigma: Floats
    weight: Floats

    def part(self, views: Ints, block: slice) -> "PixelResiduals":
        """Return the residuals of a block of points in some views."""
        pixels, weight = contiguous(self.pixels[views, :, block], self.weight[views, block])
        cameras = tuple(self.cameras[view] for view in views)
        return PixelResiduals(cameras, pixels, self.sigma[views], weight)

    def linearise(
        self, block: slice, state: State, loss_scale: float, steps: int = POINT_STEPS
    ) -> Linearised:
        """Return the residuals about a state."""
        origin = state.translation[:, :, None]
        no_metric = np.empty((len(self.pixels), 2, 3, 0))
        given = origin, self._lens_rows(state), self.pixels, no_metric, self.weight
        return _linearise(given, block, state, loss_scale=loss_scale, steps=steps)

    def _lens_rows(self, state: State) -> Floats:
        """Return the lenses `[view, 14]` with the intrinsics of a state.

        Kind (1 Brown and Conrady's, 2 fisheye), a pixel, focal lengths and principal point, all in
        standard deviations, and coefficients.
        """
        rows = lens.rows(changed_cameras(self.cameras, state.intrinsics))
        rows[:, 1:6] /= self.sigma[:, None]
        return rows


def changed_cameras(cameras: tuple[Camera, ...], intrinsics: Floats) -> tuple[Camera, ...]:
    """Return cameras after changes `[view, intrinsic]` of log focal length and k1."""
    changes = np.zeros((len(cameras), 2))
    changes[:, : intrinsics.shape[1]] = intrinsics
    return tuple(
        lens.change_intrinsics(camera, log_focal=log_focal, k1=k1)
        for camera, (log_focal, k1) in zip(cameras, changes, strict=True)
    )


@dataclass(frozen=True)
class Part:
    """A block of points, and the cameras that see it: in a large hall, a few of all.

    views: their indices. points: the block. block: where it is in `state` and `seen`.
    """

    views: Ints
    points: slice
    block: slice
    state: State
    seen: Residuals


def parts_of(state: State, seen: Residuals) -> list[Part]:
    """Return the blocks of points that are worked on at a time."""
    count = state.points.shape[1]
    starts = range(0, count, _BLOCK)
    return [_part_of(slice(start, min(start + _BLOCK, count)), state, seen) for start in starts]


def _part_of(block: slice, state: State, seen: Residuals) -> Part:
    """Return a block of points and the cameras that see it."""
    views = np.flatnonzero((seen.weight[:, block] > 0).any(1))
    if len(views) in (0, len(seen.weight)):
        return Part(np.arange(len(seen.weight)), block, block, state, seen)
    points = state.points[:, block]
    own = State(state.rotation[views], state.translation[views], points, state.intrinsics[views])
    return Part(views, block, slice(0, points.shape[1]), own, seen.part(views, block))


def _linearise(
    given: tuple[Floats, ...],
    block: slice,
    state: State,
    *,
    loss_scale: float,
    steps: int,
) -> Linearised:
    """Return what the kernel makes of a block of points; given: what was seen, as it takes it."""
    points = state.points[:, block].copy(order="C")
    (views, intrinsics), count = state.intrinsics.shape, points.shape[1]
    in_camera, residual = np.empty((views, 3, count)), np.empty((views, 2, count))
    by_point = np.empty((views, 2, 3, count))
    by_intrinsics = np.empty((views, 2, intrinsics, count))
    options = np.array([loss_scale**2, _BEHIND, _POINT_GAIN])
    given = (*contiguous(state.rotation, *given), options)
    found = points, in_camera, by_point, by_intrinsics, residual
    cost = kernels.optimise_points(block.start, *given, steps, *found)
    return Linearised(*found, cost)


def _pixels_per_ray(camera: Camera, rays: Floats) -> Floats:
    """Return by how many pixels the image moves when rays turn, `[2, 3, N]`.

    rays: `[3, N]` in the camera's frame; along the ray nothing moves. NaN behind the camera.
    """
    depth = np.where(rays[2] > 1e-9, rays[2], np.nan)
    image = rays[:2] / depth
    slopes = image_slopes(camera, image).image / depth
    along = np.einsum("kin,in->kn", slopes, image)
    return np.concatenate([slopes, -along[:, None]], axis=1)


# --- points that move


@dataclass(frozen=True, eq=False, repr=False)
class Motion:
    """The parabolas on which N points move, about where each is in its own frame.

    velocity: `[3, N]` in lengths by frame. acceleration: `[3, N]` in lengths by frame squared.
    """

    velocity: Floats
    acceleration: Floats

    def displacement(self, frames: Floats) -> Floats:
        """Return how far the points move in times `[view]` in frames, `[view, 3, N]`."""
        time = frames[:, None, None]
        return time * self.velocity + time**2 / 2 * self.acceleration

    def velocity_after(self, frames: Floats) -> Floats:
        """Return the velocity of the points after times `[view]` in frames, `[view, 3, N]`."""
        return self.velocity + frames[:, None, None] * self.acceleration

    def select(self, points: slice | Ints) -> "Motion":
        """Return the motion of some of the points."""
        return Motion(self.velocity[:, points], self.acceleration[:, points])


@dataclass(frozen=True)
class TimedRayResiduals:
    """Residuals of points that move, against the rays of cameras whose clocks differ.

    The one intrinsic of a camera is the offset of its clock in frames.
    motion: of the points in the world.
    """

    rays: RayResiduals
    motion: Motion

    @property
    def weight(self) -> Floats:
        """What each detection counts for."""
        return self.rays.weight

    def part(self, views: Ints, block: slice) -> "TimedRayResiduals":
        """Return the residuals of a block of points in some views."""
        return TimedRayResiduals(self.rays.part(views, block), self.motion.select(block))

    def linearise(
        self, block: slice, state: State, loss_scale: float, steps: int = POINT_STEPS
    ) -> Linearised:
        """Return the residuals about a state, each point where it is at the time of its view."""
        motion, offset = self.motion.select(block), state.intrinsics[:, 0]
        shift = np.matmul(state.rotation, motion.displacement(offset))
        origin = state.translation[:, :, None] + shift
        given = origin, _NO_LENS, self.rays.rays, self.rays.metric, self.weight
        found = _linearise(given, block, state, loss_scale=loss_scale, steps=steps)
        velocity = np.matmul(state.rotation, motion.velocity_after(offset))
        by_offset = np.einsum("vkin,vin->vkn", found.by_point, velocity)[:, :, None]
        return replace(found, by_intrinsics=np.ascontiguousarray(by_offset))


def motion_between(from_last: Floats, to_next: Floats, step: int) -> Motion:
    """Return the motion of points that are known `step` frames before and after, too.

    from_last, to_next: `[3, N]` how far they come and go.
    """
    return Motion((to_next + from_last) / (2 * step), (to_next - from_last) / step**2)
