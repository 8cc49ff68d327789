"""Bringing two frames of reference together."""

import numpy as np

from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.rotation import nearest_rotation
from mocap_calib.types import Floats


def similarity(source: Floats, target: Floats) -> tuple[float, Floats, Floats]:
    """s, R, t that minimise sum |s R x + t - y|^2 (Umeyama 1991, eqs. 38-42). source, target: `[N, 3]`.

    Raises DegenerateError when all source points coincide.
    """
    mean_x, mean_y = source.mean(0), target.mean(0)
    x, y = source - mean_x, target - mean_y
    rotation = nearest_rotation(y.T @ x)
    variance = (x**2).sum()
    if variance < 1e-18:
        raise DegenerateError(
            "alignment: expected points in different places, all of them coincide"
        )
    scale = float(np.trace(rotation @ x.T @ y) / variance)
    return scale, rotation, mean_y - scale * rotation @ mean_x
