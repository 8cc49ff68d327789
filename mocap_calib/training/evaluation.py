"""Measure the errors of networks on poses that they have never seen."""

from dataclasses import replace

import torch
from torch import Tensor

from mocap_calib.config import (
    EVALUATION_EXAMPLES,
    EVALUATION_SEED,
    EVALUATION_SEED_OF_ANGLES,
    PairsConfig,
    TrainConfig,
)
from mocap_calib.training.dataset import Synthesiser
from mocap_calib.training.losses import displacement
from mocap_calib.training.model import LifterModule
from mocap_calib.training.pairs import PairSynthesiser
from mocap_calib.training.poses import PoseSet
from mocap_calib.training.steer import Model, steer
from mocap_calib.types import Skeleton


@torch.no_grad()
def held_out_error(
    lifter: LifterModule,
    poses: PoseSet,
    skeleton: Skeleton,
    config: TrainConfig,
    *,
    examples: int = EVALUATION_EXAMPLES,
) -> dict[str, float]:
    """Return the errors of a lifter on unseen poses, in units of the visible pose's RMS radius.

    joint_3d: mean joint distance.
    steered_2d: mean keypoint displacement (the paper's eq. 1) after a rotation about the vertical
        drawn uniformly.
    completed_2d: the same without rotation, over the joints that were not seen.
    """
    batch = Synthesiser(poses, skeleton, config, seed=EVALUATION_SEED).batch(examples)
    joints, _ = lifter(batch.pose, batch.seen)
    error = joints - batch.target  # (B, J, 3)
    steered = _project_turned(error)
    hidden = error[..., :2].norm(dim=-1)[~batch.seen]
    return {
        "joint_3d": _rounded_mean(error.norm(dim=-1)),
        "steered_2d": _rounded_mean(steered.norm(dim=-1)),
        "completed_2d": _rounded_mean(hidden),
    }


@torch.no_grad()
def measure_steering_error(
    model: Model,
    poses: PoseSet,
    skeleton: Skeleton,
    config: PairsConfig,
    *,
    examples: int = EVALUATION_EXAMPLES,
) -> dict[str, float]:
    """Return the errors of either architecture on pairs and poses that were held out.

    In units of the visible pose's RMS radius.

    steered_2d: L_kp (eq. 1).
    identity_2d: the displacement of the seen joints when nothing is turned, without noise.
    """
    batch = PairSynthesiser(poses, skeleton, config, split="test", seed=EVALUATION_SEED).batch(
        examples
    )
    steered = steer(model, batch.pose, batch.seen, batch.vector)
    exact = replace(config, noise=1e-6)
    still = PairSynthesiser(poses, skeleton, exact, split="test", seed=EVALUATION_SEED).batch(
        examples
    )
    unturned = steer(model, still.pose, still.seen, torch.zeros_like(still.vector))
    seen = still.seen[..., None]
    square = torch.where(seen, (unturned - still.pose).square(), torch.zeros_like(unturned))
    identity = square.sum(-1).sqrt()[still.seen]
    return {
        "steered_2d": round(displacement(steered, batch.target).mean().item(), 4),
        "identity_2d": round(identity.mean().item(), 4),
    }


def _project_turned(error: Tensor) -> Tensor:
    """Return errors `[B, J, 3]` in the image `[B, J, 2]` after random turns about the vertical."""
    generator = torch.Generator().manual_seed(EVALUATION_SEED_OF_ANGLES)
    angle = 2 * torch.pi * torch.rand(len(error), 1, generator=generator)
    across = error[..., 0] * angle.cos() + error[..., 2] * angle.sin()
    return torch.stack([across, error[..., 1]], -1)


def _rounded_mean(values: Tensor) -> float:
    """Return the mean of values `[...]`, those that are not known left out, to four digits."""
    return round(values.nanmean().item(), 4)
