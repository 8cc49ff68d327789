"""The losses that the networks are trained with."""

import torch
from torch import Tensor

from mocap_calib.config import UNCERTAINTY_WEIGHT
from mocap_calib.training.dataset import Batch
from mocap_calib.training.model import LifterModule

_EPSILON = 1e-8  # the root has a gradient also at zero


def displacement(steered: Tensor, target: Tensor) -> Tensor:
    """Return the mean keypoint displacement `[B]`, D(q, p') of the paper's eq. 1.

    steered and target: poses `[B, J, 2]`.
    """
    square = (steered - target).square().sum(-1)  # (B, J)
    return torch.sqrt(square + _EPSILON).mean(-1)


def lifting_loss(lifter: LifterModule, batch: Batch) -> Tensor:
    """Return the scalar loss of a lifter on a batch `[B, J, ...]`, over the joints with a target.

    The mean joint distance (the paper's eq. 1 in 3D, which bounds it for every R), plus the
    Laplace likelihood of the errors that remain across the ray and along it.
    """
    joints, log_deviation = lifter(batch.pose, batch.seen)  # (B, J, 3), (B, J, 2)
    known = torch.isfinite(batch.target[..., 0])
    error = torch.where(known[..., None], joints - batch.target.nan_to_num(), 0.0)
    distance = torch.sqrt(error.square().sum(-1) + _EPSILON)  # (B, J)
    across = error[..., :2].detach().norm(dim=-1)
    along = error[..., 2].detach().abs()
    remaining = torch.stack([across, along], -1)  # (B, J, 2)
    likelihood = (remaining * torch.exp(-log_deviation) + log_deviation).mean(-1)
    return ((distance + UNCERTAINTY_WEIGHT * likelihood) * known).sum() / known.sum()
