"""When feet stand on the floor."""

from collections.abc import Sequence

import numpy as np

from mocap_calib.config import KinematicsConfig
from mocap_calib.kinematics.motion import mean_known
from mocap_calib.types import Floats


def leg_lengths(positions: Floats, legs: Sequence[Sequence[int]]) -> Floats:
    """Return how long the legs of each individual are, `[individual]`; NaN = not known.

    positions: `[frame, individual, keypoint, 3]`. legs: chains of keypoints from the hip down.
    """
    lengths = np.full((len(legs), positions.shape[1]), np.nan)
    for k, chain in enumerate(legs):
        bones = np.linalg.norm(np.diff(positions[:, :, list(chain)], axis=2), axis=-1)
        lengths[k] = _median_known(bones).sum(-1)
    return mean_known(lengths)


def find_contacts(height: Floats, speed: Floats, leg: Floats, config: KinematicsConfig) -> Floats:
    """Return 1 where a point stands on the floor, 0 where not, NaN where nobody knows.

    A joint lies above the sole: what counts is its height above the lowest that it usually has,
    as far as that is near to the floor.

    height: `[frame, individual, point]` above the floor. speed: the same, per second. leg:
        `[individual]` length of a leg.
    """
    if not height.shape[0]:
        return np.full(height.shape, np.nan)
    length = leg[:, None]
    rest = _low_quantile(height, config.rest_quantile)
    rest = np.clip(rest, -config.most_rest_height * length, config.most_rest_height * length)
    with np.errstate(invalid="ignore"):
        low = height - rest < config.contact_height * length
        slow = speed < config.contact_speed * length
    known = np.isfinite(height) & np.isfinite(speed) & np.isfinite(length)
    return np.where(known, low & slow, np.nan)


def _low_quantile(values: Floats, share: float) -> Floats:
    """Return the quantile along the frames of the values that are not NaN."""
    ordered = np.sort(values, axis=0)  # NaN comes last
    last = np.isfinite(values).sum(0) - 1
    rows = np.clip(np.rint(share * last).astype(np.int64), 0, None)
    return np.take_along_axis(ordered, rows[None], axis=0)[0]


def _median_known(values: Floats) -> Floats:
    """Return the median along the frames of the values that are not NaN; NaN where all are."""
    return _low_quantile(values, 0.5) if len(values) else np.full(values.shape[1:], np.nan)
