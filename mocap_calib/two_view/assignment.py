"""Matching the detections of two views, all frames and hypotheses at once."""

import numpy as np

from mocap_calib.types import Bools, Floats

_SWEEPS = 12


def sinkhorn(affinity: Floats, *, dummy: float, sharpness: float = 8.0) -> Floats:
    """Doubly stochastic weights with dummy targets for the unmatched (Cuturi 2013; the paper, section 3.2).

    affinity: `[..., I, J]` in 0..1, 0 = impossible; dummy: the affinity at which staying alone is as good.
    Returns `[..., I, J]`: rows and columns sum to at most 1.
    """
    *batch, rows, columns = affinity.shape
    weight = np.empty((*batch, rows + 1, columns + 1))
    weight[..., :rows, :columns] = np.where(affinity > 0, np.exp(sharpness * affinity), 0.0)
    weight[..., rows, :] = weight[..., :, columns] = np.exp(sharpness * dummy)
    for _ in range(_SWEEPS):  # the dummy row and column have no capacity: they are never normalised
        weight[..., :rows, :] /= weight[..., :rows, :].sum(-1, keepdims=True)
        weight[..., :, :columns] /= weight[..., :, :columns].sum(-2, keepdims=True)
    return weight[..., :rows, :columns]


def mutual_best(weight: Floats, *, least: float) -> Bools:
    """`[..., I, J]` true where a weight is the largest of its row and of its column, and above `least`."""
    return (
        (weight > least)
        & (weight == weight.max(-1, keepdims=True))
        & (weight == weight.max(-2, keepdims=True))
    )
