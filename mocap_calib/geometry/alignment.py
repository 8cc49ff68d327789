"""Align two frames of reference."""

import numpy as np

from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.rotation import nearest_rotation
from mocap_calib.types import Floats


def align_by_similarity(source: Floats, target: Floats) -> tuple[float, Floats, Floats]:
    """Return scale s, rotation R `[3, 3]` and shift t `[3]` that minimise sum |s R x + t - y|^2.

    source: `[N, 3]` points x. target: `[N, 3]` points y (Umeyama 1991, eqs. 38-42).

    Raises DegenerateError where all source points coincide.
    """
    source_mean = source.mean(0)
    target_mean = target.mean(0)
    x = source - source_mean
    y = target - target_mean
    variance = (x**2).sum()
    if variance < 1e-18:
        raise DegenerateError(
            "alignment: expected points in different places, all of them coincide"
        )
    rotation = nearest_rotation(y.T @ x)
    scale = float(np.trace(rotation @ x.T @ y) / variance)
    shift = target_mean - scale * rotation @ source_mean
    return scale, rotation, shift
