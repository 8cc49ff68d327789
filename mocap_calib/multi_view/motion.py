"""How triangulated points move from frame to frame."""

import numpy as np

from mocap_calib.types import Floats, Ints

_USUAL_SHARE = 0.98  # of the motions, the smaller ones


def usual_step(frames: Ints) -> int:
    """Return by how much frame numbers `[frame]` go up mostly: these frames follow each other."""
    return max(1, int(np.median(np.diff(frames)))) if len(frames) > 1 else 1


def smoothness(before: Floats, points: Floats, after: Floats) -> float:
    """Return how smoothly points move: 1 without jerks, 0 as by chance.

    Each is `[3, N]`, the same points in frames that follow each other. Where errors are independent
    and of variance s^2, or frames do not follow each other, half of the way from before to after
    varies by s^2 / 2, and the way of a point off the middle of the two by 3 s^2 / 2. The largest
    motions, which are mistaken identities, do not count.
    """
    along = (((after - before) / 2) ** 2).sum(0)
    aside = ((points - (after + before) / 2) ** 2).sum(0)
    usual = along + aside <= np.quantile(along + aside, _USUAL_SHARE)
    total = along[usual].sum()
    return float(1 - aside[usual].sum() / (3 * total)) if total > 0 else 0.0
