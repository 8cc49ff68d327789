"""Residuals of cameras and points against what was seen: rays, where lenses are known, or pixels.

The loss is Cauchy's. Points are optimised for fixed cameras, each by itself, and the residuals are
linearised there (embedded point iterations: Ruhe and Wedin 1980, "Algorithms for Separable
Nonlinear Least Squares Problems"). Kernels do both, in blocks of points that threads share.

Residuals against rays are taken in the plane that touches the unit sphere at the observed ray, to
first order in pixels: any lens will do, without its derivatives.
"""

from dataclasses import dataclass
from functools import cached_property

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
    intrinsics: `[view, intrinsic]` changes of log focal length, k1 and log aspect, or the offset of
        the clock in frames; none where all are known.
    """

    rotation: Floats
    translation: Floats
    points: Floats
    intrinsics: Floats


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


@dataclass(frozen=True, eq=False, repr=False)
class Residuals:
    """What the cameras saw of N points, as residuals.

    seen: `[view, 3, N]` unit rays in each camera's frame; or `[view, 2, N]` pixels, any number
        where nothing was seen, of cameras whose lenses are adjusted.
    weight: `[view, N]`, 0 = not seen.
    metric: `[view, 2, 3, N]` turns a direction into the residual at its ray, in standard
        deviations; `[view, 2, 3, 0]` of pixels.
    cameras: of pixels, with the intrinsics that a state changes: as many as it has of log focal
        length, k1 and log aspect. sigma: `[view]` of pixels, standard deviation of a coordinate.
    motion: `[2, 3, N]` velocity and acceleration, in lengths by frame, of points that move, each on
        a parabola about where it is in its own frame. The one intrinsic of a camera is then the
        offset of its clock in frames.
    """

    seen: Floats
    weight: Floats
    metric: Floats
    cameras: tuple[Camera, ...] = ()
    sigma: Floats | None = None
    motion: Floats | None = None

    @classmethod
    def of_rays(
        cls, cameras: tuple[Camera, ...], rays: Floats, noise: Floats, weight: Floats
    ) -> "Residuals":
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
        return cls(rays, weight, metric)

    @classmethod
    def of_pixels(
        cls, cameras: tuple[Camera, ...], pixels: Floats, sigma: Floats, weight: Floats
    ) -> "Residuals":
        """Return residuals of lenses that are adjusted; see the class."""
        return cls(pixels, weight, np.empty((len(pixels), 2, 3, 0)), cameras, sigma)

    @cached_property
    def blocks(self) -> "list[Block]":
        """The points in blocks, each with the cameras that see it."""
        starts = range(0, self.weight.shape[1], _BLOCK)
        return [self._block(slice(start, start + _BLOCK)) for start in starts]

    def _block(self, points: slice) -> "Block":
        """Return a block of points."""
        sees = (self.weight[:, points] > 0).any(1)
        views = np.flatnonzero(sees | ~sees.any())  # all where none sees any: no array is empty
        own = self.seen[views, :, points], self.weight[views, points]
        seen, weight, metric = contiguous(*own, self.metric[views, :, :, points])
        cameras = tuple(self.cameras[view] for view in views if self.cameras)
        sigma = None if self.sigma is None else self.sigma[views]
        motion = None if self.motion is None else self.motion[..., points]
        return Block(views, points, Residuals(seen, weight, metric, cameras, sigma, motion))

    def linearise(self, state: State, loss_scale: float, steps: int = POINT_STEPS) -> Linearised:
        """Return the residuals about a state, the points optimised first.

        Against rays u with the metric M they are r = M x / (u'x); of points that move, where each
        is at the time of its view. steps: of each point, at most; none leaves the points where they
        are.
        """
        points, origin = state.points.copy(order="C"), state.translation[:, :, None]
        (views, intrinsics), count = state.intrinsics.shape, points.shape[1]
        if self.motion is not None:
            time, (velocity, acceleration) = state.intrinsics[:, :, None], self.motion
            origin = origin + state.rotation @ (time * velocity + time**2 / 2 * acceleration)
        lenses = _NO_LENS
        if self.sigma is not None:  # kernels take all lengths in standard deviations
            lenses = lens.rows(changed_cameras(self.cameras, state.intrinsics))
            lenses[:, 1:6] /= self.sigma[:, None]
        in_camera, residual = np.empty((views, 3, count)), np.empty((views, 2, count))
        by_point = np.empty((views, 2, 3, count))
        by_intrinsics = np.empty((views, 2, intrinsics, count))
        options = np.array([loss_scale**2, _BEHIND, _POINT_GAIN])
        given = state.rotation, origin, lenses, self.seen, self.metric, self.weight, options
        found = points, in_camera, by_point, by_intrinsics, residual
        cost = kernels.optimise_points(*contiguous(*given), steps, *found)
        if self.motion is not None:
            by_time = state.rotation @ (velocity + time * acceleration)
            by_intrinsics[:, :, 0] = np.einsum("vkin,vin->vkn", by_point, by_time)
        return Linearised(*found, cost)


@dataclass(frozen=True)
class Block:
    """Points that are worked on at a time, and the cameras that see any: in a large hall, a few.

    views: their indices. points: those of the block. seen: what these cameras saw of these points.
    """

    views: Ints
    points: slice
    seen: Residuals

    def state(self, whole: State) -> State:
        """Return the part of a state that the block depends on."""
        views, points = self.views, whole.points[:, self.points]
        pose = whole.rotation[views], whole.translation[views]
        return State(*pose, points, whole.intrinsics[views])


def changed_cameras(cameras: tuple[Camera, ...], intrinsics: Floats) -> tuple[Camera, ...]:
    """Return cameras after changes `[view, intrinsic]` of log focal length, k1 and log aspect."""
    changes = np.zeros((len(cameras), 3))
    changes[:, : intrinsics.shape[1]] = intrinsics
    return tuple(
        lens.change_intrinsics(camera, log_focal=log_focal, k1=k1, log_aspect=log_aspect)
        for camera, (log_focal, k1, log_aspect) in zip(cameras, changes, strict=True)
    )


def _pixels_per_ray(camera: Camera, rays: Floats) -> Floats:
    """Return by how many pixels the image moves when rays turn, `[2, 3, N]`.

    rays: `[3, N]` in the camera's frame; along the ray nothing moves. NaN behind the camera.
    """
    depth = np.where(rays[2] > 1e-9, rays[2], np.nan)
    image = rays[:2] / depth
    slopes = image_slopes(camera, image).image / depth
    along = np.einsum("kin,in->kn", slopes, image)
    return np.concatenate([slopes, -along[:, None]], axis=1)


def motion_between(from_last: Floats, to_next: Floats, step: int) -> Floats:
    """Return the motion `[2, 3, N]` of points that are known `step` frames before and after, too.

    from_last, to_next: `[3, N]` how far they come and go.
    """
    return np.stack([(to_next + from_last) / (2 * step), (to_next - from_last) / step**2])
