"""Find detections that a file has twice in one frame: they are one body.

Files that were put together, and detectors without a suppression of doubles, have the same body
again, to the last digit. It would be matched twice, and count twice.
"""

import numpy as np

from mocap_calib.types import Bools, Reals

_LEAST_JOINTS = 3  # seen: single points of two bodies may be the same pixel


def find_repeated(positions: Reals) -> Bools:
    """Return `[frame, instance]` whether an earlier detection of the frame is the same.

    Two are the same where they have the same keypoints, three at least, at the same places.
    positions: `[frame, instance, keypoint, 2]` in pixels, NaN = missing.
    """
    frames, instances = positions.shape[:2]
    repeated = np.zeros((frames, instances), dtype=bool)
    if instances < 2:
        return repeated
    seen = np.isfinite(positions[..., 0])
    enough = seen.sum(-1) >= _LEAST_JOINTS
    key = np.where(enough, np.where(seen, positions[..., 0], 0.0).sum(-1), np.nan)
    for later in range(1, instances):
        for earlier in range(later):
            alike = np.flatnonzero(key[:, earlier] == key[:, later])
            first, second = positions[alike, earlier], positions[alike, later]
            same = (first == second) | (np.isnan(first) & np.isnan(second))
            repeated[alike, later] |= same.all((-1, -2))
    return repeated
