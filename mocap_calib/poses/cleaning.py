"""Detections that a fit exposes: left and right taken for each other, and what is far off.

And points that no body can have, however well the views agree on them.
"""

from dataclasses import replace

import numpy as np

from mocap_calib.config import PosesConfig
from mocap_calib.poses.fit import squared_errors
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
    there = seen.precision > 0
    fits = paired[:, None] & there & (other < config.outlier**2)
    # logarithms are never more than what they are of, and few detections are so far off
    far = as_seen + as_seen[:, mirror] > 2 * config.exchange_gain
    exchanged = fits & fits[:, mirror] & far
    view, joint, frame = np.nonzero(exchanged)
    scale = config.losses[0] ** 2
    gain = sum(
        np.log1p(as_seen[view, each, frame] / scale) - np.log1p(other[view, each, frame] / scale)
        for each in (joint, mirror[joint])
    )
    exchanged[view, joint, frame] = gain * scale / 2 > config.exchange_gain
    if not exchanged.any():
        return seen, exchanged
    return (
        replace(
            seen,
            rays=np.where(exchanged, seen.rays[:, :, mirror], seen.rays),
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


def are_beyond_reach(points: Floats, reach: Floats) -> Bools:
    """Return which points `[frame, keypoint]` are farther from most of the others than is possible.

    Two views that take the same thing in the background for a joint agree on where it is. What the
    bones allow, they do not.

    points: `[frame, keypoint, 3]`. reach: `[keypoint, keypoint]` the largest possible distances.
    """
    known = np.triu(np.isfinite(reach), k=1)
    a, b = np.nonzero(known)
    square = sum((axis[:, a] - axis[:, b]) ** 2 for axis in points.transpose(2, 0, 1))
    ends = ((a[:, None] == np.arange(len(reach))) | (b[:, None] == np.arange(len(reach)))) * 1.0
    beyond, compared = square > reach[known] ** 2, np.isfinite(square)
    return np.asarray(2 * (beyond @ ends) > compared @ ends)
