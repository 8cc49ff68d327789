"""How many moments frames show: where nobody has moved, they show the same one again.

A detector errs in a picture that it has seen as it did before: such errors do not average out.
"""

import numpy as np

from mocap_calib.config import UncertaintyConfig
from mocap_calib.geometry.bodies import mean_of_known
from mocap_calib.multi_view.bundle_adjustment import AdjustablePoints
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import Floats, Ints


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
    same = float((apart[pairs] < config.same_moment).mean())
    return 1 / (1 / len(frames) + (1 - 1 / len(frames)) * same)


def _motion(points: AdjustablePoints, view: int, frames: Ints) -> Floats:
    """Return how far the body that moves most is in a view between frames `[frame, frame]`.

    In sizes of bodies, each of which is the spread of its joints: the mean over these, of which
    none counts for more than a size. NaN where nobody is in both frames.
    """
    own = np.flatnonzero(points.used[view] & np.isin(points.frame, frames))
    individual, keypoint = points.individual[own], points.keypoint[own]
    shape = (len(frames), individual.max(initial=0) + 1, keypoint.max(initial=0) + 1)
    pixels = np.full((*shape, 2), np.nan)
    row = np.searchsorted(frames, points.frame[own])
    pixels[row, individual, keypoint] = points.pixels[view][:, own].T
    spread = pixels - mean_of_known(pixels, 2)[:, :, None]
    size = np.sqrt(mean_of_known((spread**2).sum(-1), 2))  # [frame, individual]
    size = mean_of_known(size, 0)[:, None]
    apart = np.linalg.norm(pixels[:, None] - pixels[None], axis=-1) / np.where(size > 0, size, 1.0)
    of_bodies = mean_of_known(np.minimum(apart, 1.0), 3)  # [frame, frame, individual]
    return np.asarray(np.fmax.reduce(of_bodies, axis=2))
