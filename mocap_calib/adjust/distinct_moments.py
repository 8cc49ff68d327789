"""How many moments frames show: where nobody has moved, they show the same one again.

A detector errs in a picture that it has seen as it did before: such errors do not average out.
"""

import numpy as np

from mocap_calib.adjust.bundle_adjustment import AdjustablePoints
from mocap_calib.config import UncertaintyConfig
from mocap_calib.geometry.bodies import mean_of_known
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import Floats, Ints

_TINY = 1e-9  # pixels, of the size of a body


def count_moments(points: AdjustablePoints, config: UncertaintyConfig) -> float:
    """Return how many moments the frames of points show, from 1 to the number of frames.

    If N moments are shown equally often, two frames that are taken at random show the same one with
    the probability 1 / N. That is measured, and its inverse returned (Simpson 1949).
    """
    frames = np.unique(points.frame)
    chosen = evenly_spaced(frames, config.compared_moments)
    views = evenly_spaced(np.flatnonzero(points.used.any(1)), config.compared_views)
    if len(chosen) < 2 or not len(views):
        return 1.0
    apart = mean_of_known(np.stack([_motion(points, view, chosen) for view in views.tolist()]), 0)
    pairs = ~np.eye(len(chosen), dtype=bool)
    same = float(np.nan_to_num(1 / (1 + (apart[pairs] / config.same_moment) ** 8)).mean())
    return 1 / (1 / len(frames) + (1 - 1 / len(frames)) * same)


def _motion(points: AdjustablePoints, view: int, frames: Ints) -> Floats:
    """Return how far the body that moves most is in a view between frames `[frame, frame]`.

    Names hold within a frame alone, so each body is compared with the nearest one of the other
    frame: by the mean distance of their joints, of which none counts for more than 1. In sizes of
    bodies: the RMS distance of joints from the middle of a body. NaN = nothing can be compared.
    """
    own = np.flatnonzero(points.used[view] & np.isin(points.frame, frames))
    body, keypoint = points.individual[own], points.keypoint[own]
    shape = (len(frames), body.max(initial=0) + 1, keypoint.max(initial=0) + 1)
    pixels = np.full((*shape, 2), np.nan)
    row = np.searchsorted(frames, points.frame[own])
    pixels[row, body, keypoint] = points.pixels[view][:, own].T
    spread = pixels - mean_of_known(pixels, 2)[:, :, None]
    size = np.sqrt(np.nanmean((spread**2).sum(-1))) if len(own) else 0.0
    apart = np.linalg.norm(pixels[:, None, :, None] - pixels[None, :, None], axis=-1)
    apart = mean_of_known(np.minimum(apart / (size + _TINY), 1.0), 4)  # [frame, frame, body, body]
    return np.asarray(np.fmax.reduce(np.fmin.reduce(apart, axis=3), axis=2))
