"""Detections that a fit exposes: left and right taken for each other, and what is far off."""

from dataclasses import replace

import numpy as np

from mocap_calib.config import PosesConfig
from mocap_calib.poses.energy import squared_errors
from mocap_calib.poses.track import Detections
from mocap_calib.types import Bools, Floats, Ints


def exchange_sides(
    points: Floats, seen: Detections, mirror: Ints, config: PosesConfig
) -> tuple[Detections, Bools]:
    """Return the detections with left and right exchanged where that explains a view.

    points: `[keypoint, frame, 3]`. mirror: `[keypoint]` the joint of the other side, itself where
    there is none. A pair is exchanged in one view of one frame where both were seen.

    Returns which were, `[view, keypoint, frame]`, both of a pair.
    """
    paired = mirror != np.arange(len(mirror))
    as_seen = squared_errors(points, seen)
    other = squared_errors(points[mirror], seen)
    scale = config.losses[0] ** 2
    gain = np.log1p(as_seen / scale) - np.log1p(other / scale)
    both = (seen.precision > 0) & (seen.precision[:, mirror] > 0) & paired[:, None]
    gain = np.where(both, (gain + gain[:, mirror]) * scale / 2, 0.0)
    fits = np.maximum(other, other[:, mirror]) < config.outlier**2
    exchanged = both & fits & (gain > config.exchange_gain)
    return (
        replace(
            seen,
            axes=np.where(exchanged, seen.axes[:, :, :, mirror], seen.axes),
            precision=np.where(exchanged, seen.precision[:, mirror], seen.precision),
        ),
        exchanged,
    )


def drop_outliers(
    points: Floats, seen: Detections, config: PosesConfig
) -> tuple[Detections, Bools]:
    """Return the detections without those far from the points, and which these are.

    points: `[keypoint, frame, 3]`. Which: `[view, keypoint, frame]`.
    """
    far = (seen.precision > 0) & (squared_errors(points, seen) > config.outlier**2)
    return replace(seen, precision=np.where(far, 0.0, seen.precision)), far
