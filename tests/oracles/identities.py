"""Definitions in plain numpy of what kernels of the identities compute."""

import numpy as np


def squared_gaps(positions: np.ndarray, least_joints: int, step: float) -> np.ndarray:
    """Return `[frame - 1, I, J]` mean squared distances of detections from those of the next frame.

    Infinite where they have too few joints in common, or are farther apart than a step allows.
    """
    gap = positions[:-1, :, None] - positions[1:, None]
    square = (gap**2).sum(-1)
    common = np.isfinite(square).sum(-1)
    mean = np.nansum(square, -1) / np.maximum(common, 1)
    known = np.isfinite(positions[:-1, ..., :1])
    count = np.maximum(known.sum(-2), 1)
    middle = np.nansum(positions[:-1], -2) / count
    extent = np.nansum((positions[:-1] - middle[:, :, None]) ** 2, (-1, -2)) / count[..., 0]
    near = (common >= max(least_joints, 1)) & (mean < step**2 * extent[..., None])
    return np.where(near, mean, np.inf)
