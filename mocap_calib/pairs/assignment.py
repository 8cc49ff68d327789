"""Match the detections of two views, all frames and hypotheses at once."""

import numpy as np

from mocap_calib.config import SINKHORN_SHARPNESS, SINKHORN_SWEEPS
from mocap_calib.types import Bools, Floats


def sinkhorn(affinity: Floats, *, dummy: float) -> Floats:
    """Return doubly stochastic weights, with dummy targets for the unmatched.

    Sinkhorn's algorithm (Cuturi 2013, algorithm 1; the paper, section 3.2). The dummy row and
    column have no capacity: they are never normalised.

    affinity: `[..., I, J]` in 0..1, 0 or NaN = impossible.
    dummy: the affinity at which staying unmatched is as good.
    Returns `[..., I, J]`: rows and columns sum to at most 1.
    """
    # instances first: sums over a few numbers that lie side by side take several times as long
    affinity = np.moveaxis(affinity, (-2, -1), (0, 1))
    rows, columns, *batch = affinity.shape
    weight = np.empty((rows + 1, columns + 1, *batch))
    possible = weight[:rows, :columns]
    np.exp(SINKHORN_SHARPNESS * affinity, out=possible)
    possible[~(affinity > 0)] = 0.0
    weight[rows] = weight[:, columns] = np.exp(SINKHORN_SHARPNESS * dummy)
    for _ in range(SINKHORN_SWEEPS):
        weight[:rows] /= weight[:rows].sum(1, keepdims=True)
        weight[:, :columns] /= weight[:, :columns].sum(0)
    return np.moveaxis(possible, (0, 1), (-2, -1))


def mutual_best(weight: Floats, *, least: float) -> Bools:
    """Return where a weight is the largest of its row and of its column, and above `least`.

    Nobody is matched twice: of equal weights, as of a detection that a file has twice, the first
    counts.

    weight: `[..., I, J]`. Returns `[..., I, J]`.
    """
    best_of_row = weight == weight.max(-1, keepdims=True)
    best_of_column = weight == weight.max(-2, keepdims=True)
    matched: Bools = (weight > least) & best_of_row & best_of_column
    for axis in (-1, -2):
        if (matched.sum(axis) > 1).any():
            matched &= matched.cumsum(axis) == 1
    return matched
