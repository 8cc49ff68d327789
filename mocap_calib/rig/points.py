"""Triangulate single points: pixels of any meaning, of which nothing else is known."""

import numpy as np

from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import TriangulateConfig
from mocap_calib.geometry.reprojection import reprojection_error
from mocap_calib.geometry.view_blocks import POINT_BLOCK, point_blocks
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.rig.noise import least_noise, measure_errors
from mocap_calib.rig.observations import Observations, observe
from mocap_calib.rig.triangulation import triangulate_rays
from mocap_calib.types import CameraRig, Floats

_LEAST_POINTS = 30  # of a view: fewer do not tell the noise of its own


def triangulate_pixels(
    rig: CameraRig,
    pixels: Floats,
    confidence: Floats,
    config: TriangulateConfig = TriangulateConfig(),
) -> tuple[Floats, Floats]:
    """Return the points `[..., 3]` that pixels show, in the rig's unit, and their errors `[...]`.

    Of each point by itself, as `triangulate` does it: no points need belong together. A view of
    which few points are known is taken to be as noisy as all views together.

    pixels: `[view, ..., 2]`, NaN = missing. confidence: `[view, ...]`, 0 = missing.

    Errors are RMS reprojection errors in pixels over the views that were used.
    """
    shape = confidence.shape[1:]
    flat = pixels.reshape(len(rig), -1, 2)
    weight = np.where(np.isfinite(flat).all(-1), np.nan_to_num(confidence.reshape(len(rig), -1)), 0)
    count = flat.shape[1]
    sample = evenly_spaced(np.arange(count), POINT_BLOCK)
    noise = _noise_of_few(rig, observe(rig.cameras, flat[:, sample], weight[:, sample]), config)

    def triangulate_block(block: slice) -> tuple[Floats, Floats]:
        """Return points `[3, n]` and errors `[n]` of some of the points."""
        seen = observe(rig.cameras, flat[:, block], weight[:, block])
        points, used = triangulate_rays(
            rig, seen.rays, weight=seen.confidence, noise=noise, config=config
        )
        return points, reprojection_error(rig, points, pixels=seen.pixels, used=used)

    found = list(map_in_threads(triangulate_block, point_blocks(count)))
    points = np.concatenate([block for block, _ in found], axis=1)
    error = np.concatenate([block for _, block in found])
    return points.T.reshape(*shape, 3), error.reshape(shape)


def _noise_of_few(rig: CameraRig, seen: Observations, config: TriangulateConfig) -> Floats:
    """Return the robust standard deviation `[view]` of each view's angular error, in radians.

    The median of few points is not robust: views with few have that of all views together.
    """
    error, counted = measure_errors(rig, seen, config)
    together = config.unknown_noise
    if counted.any():
        together = float(np.median(error[counted]))
    noise = np.full(len(rig), together)
    for view in np.flatnonzero(counted.sum(1) >= _LEAST_POINTS):
        noise[view] = np.median(error[view, counted[view]])
    return np.maximum(noise, least_noise(rig, config))
