"""Residuals of cameras and points against observed pixels, for lenses that are adjusted too."""

from dataclasses import dataclass, field, replace

import numpy as np

from mocap_calib.adjust.residuals import (
    Residuals,
    Slopes,
    State,
    points_in_cameras,
    positive_depth,
)
from mocap_calib.geometry import lens
from mocap_calib.kernels.loading import contiguous
from mocap_calib.types import Camera, Floats, Ints

_LENS_ROW = 14  # numbers of a lens, as kernels take it


@dataclass(frozen=True)
class PixelObservations:
    """What the cameras saw of N points.

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
    _changed: dict[bytes, tuple[Camera, ...]] = field(default_factory=dict, init=False)

    def select(self, points: Ints) -> "PixelObservations":
        """Return what was seen of some of the points, given their indices."""
        pixels, weight = contiguous(self.pixels[..., points], self.weight[:, points])
        return replace(self, pixels=pixels, weight=weight)

    def part(self, views: Ints, block: slice) -> "PixelObservations":
        """Return what some views saw of a block of points."""
        pixels, weight = contiguous(self.pixels[views, :, block], self.weight[views, block])
        cameras = tuple(self.cameras[view] for view in views)
        return PixelObservations(cameras, pixels, self.sigma[views], weight)

    def residuals(self, block: slice, state: State) -> Residuals:
        """Return a block of points as the cameras see them."""
        in_camera = points_in_cameras(block, state)
        depth, behind = positive_depth(in_camera, in_camera[:, 2])
        on_plane = in_camera / depth[:, None]
        on_plane[:, 2] = 1.0  # also what is behind, which fits nothing there
        cameras = self._cameras_of(state)
        images = map(lens.project, cameras, on_plane)
        gap = np.stack(list(images)) - self.pixels[..., block]
        return Residuals(
            in_camera=in_camera,
            depth=depth,
            residual=gap / self.sigma[:, None, None],
            behind=behind,
        )

    def slopes(self, _block: slice, state: State, found: Residuals, weight: Floats, /) -> Slopes:
        """Return the weighed derivatives, by the chain of the lens and the division by depth."""
        image = found.in_camera[:, :2] / found.depth[:, None]
        scale = weight / self.sigma[:, None]
        views, _, count = image.shape
        by_point = np.empty((views, 2, 3, count))
        by_intrinsic = np.empty((views, 2, state.intrinsics.shape[1], count))
        for view, camera in enumerate(self._cameras_of(state)):
            slopes = lens.image_slopes(camera, image[view])
            by_image = slopes.image * (scale[view] / found.depth[view])
            by_point[view, :, :2] = by_image
            by_point[view, :, 2] = -np.einsum("kin,in->kn", by_image, image[view])
            both = np.stack([slopes.log_focal, slopes.k1], axis=1)
            by_intrinsic[view] = both[:, : by_intrinsic.shape[2]] * scale[view]
        return Slopes(in_camera=by_point, intrinsics=by_intrinsic)

    def lens_rows(self, state: State) -> Floats:
        """Return the lenses `[view, 14]` with the intrinsics of a state.

        Kind (1 Brown and Conrady's, 2 fisheye), a pixel, focal lengths and principal point, all in
        standard deviations, and coefficients.
        """
        rows = np.zeros((len(self.cameras), _LENS_ROW))
        for row, camera, sigma in zip(rows, self._cameras_of(state), self.sigma, strict=True):
            coefficients = camera.distortion[: 4 if camera.fisheye else 8]
            row[:2] = 2 if camera.fisheye else 1, 1 / sigma
            row[2:4] = camera.matrix[[0, 1], [0, 1]] / sigma
            row[4:6] = camera.matrix[:2, 2] / sigma
            row[6 : 6 + len(coefficients)] = coefficients
        return rows

    def _cameras_of(self, state: State) -> tuple[Camera, ...]:
        """Return the cameras with the intrinsics of a state, for which all blocks of points ask."""
        key = state.intrinsics.tobytes()
        found = self._changed.get(key)
        if found is None:
            self._changed.clear()
            found = self._changed[key] = changed_cameras(self.cameras, state)
        return found


def changed_cameras(cameras: tuple[Camera, ...], state: State) -> tuple[Camera, ...]:
    """Return the cameras with the intrinsics of a state."""
    changes = np.zeros((len(cameras), 2))
    changes[:, : state.intrinsics.shape[1]] = state.intrinsics
    return tuple(
        lens.change_intrinsics(camera, log_focal=log_focal, k1=k1)
        for camera, (log_focal, k1) in zip(cameras, changes, strict=True)
    )
