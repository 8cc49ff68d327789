"""Training of the lifter, and its error on poses it has never seen."""

from dataclasses import asdict

import torch
from torch import Tensor

from mocap_calib.config import TrainConfig
from mocap_calib.steerpose.dataset import Batch, PoseSet, Synthesiser
from mocap_calib.steerpose.model import Lifter, ModelConfig
from mocap_calib.types import Progress, Skeleton


def train_lifter(poses: PoseSet, skeleton: Skeleton, config: TrainConfig, *, device: str = "cpu", progress: Progress) -> Lifter:
    """Trains on synthesised views; the same seed gives the same weights on the same machine.

    The pose is fitted by its mean joint distance (the paper's eq. 1 in 3D, which bounds it for every R), the
    uncertainty by the Laplace likelihood of the errors that remain.
    """
    torch.manual_seed(config.seed)
    lifter = Lifter(ModelConfig(len(skeleton.keypoints), config.width, config.layers)).to(device).train()
    source = Synthesiser(poses, skeleton, config, config.seed)
    optimiser = torch.optim.AdamW(lifter.parameters(), lr=config.learning_rate, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, config.learning_rate, total_steps=config.steps, pct_start=0.05)
    for step in range(config.steps):
        batch = source.batch(config.batch)
        loss = lifting_loss(lifter, Batch(batch.pose.to(device), batch.seen.to(device), batch.target.to(device)))
        optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(lifter.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        progress(f"train (loss {loss.item():.3f})", step + 1, config.steps)
    return lifter.eval()


def lifting_loss(lifter: Lifter, batch: Batch) -> Tensor:
    """Mean joint distance, plus the Laplace likelihood of what remains across and along the ray."""
    joints, log_spread = lifter(batch.pose, batch.seen)
    error = joints - batch.target
    distance = torch.sqrt(error.square().sum(-1) + 1e-8).mean()
    remains = torch.stack([error[..., :2].detach().norm(dim=-1), error[..., 2].detach().abs()], -1)
    likelihood = (remains * torch.exp(-log_spread) + log_spread).mean()
    return distance + 0.1 * likelihood


@torch.no_grad()
def held_out_error(lifter: Lifter, poses: PoseSet, skeleton: Skeleton, config: TrainConfig, *, examples: int = 8192) -> dict[str, float]:
    """Errors on unseen poses, in units of the visible pose's RMS radius.

    joint_3d: mean joint distance. steered_2d: mean keypoint displacement (the paper's eq. 1) after a rotation about
    the vertical drawn uniformly. completed_2d: the same without rotation, over the joints that were not seen.
    """
    source = Synthesiser(poses, skeleton, config, seed=12345)
    batch = source.batch(examples)
    joints, _ = lifter(batch.pose, batch.seen)
    error = joints - batch.target
    angle = 2 * torch.pi * torch.rand(examples, 1, generator=torch.Generator().manual_seed(54321))
    steered = torch.stack([error[..., 0] * angle.cos() + error[..., 2] * angle.sin(), error[..., 1]], -1)
    return {
        "joint_3d": round(error.norm(dim=-1).mean().item(), 4),
        "steered_2d": round(steered.norm(dim=-1).mean().item(), 4),
        "completed_2d": round(error[..., :2].norm(dim=-1)[~batch.seen].mean().item(), 4),
    }


def model_card(config: TrainConfig, errors: dict[str, float], *, command: str, data: str, terms: str) -> dict[str, object]:
    """What a user of the weights should know, as stored in the file."""
    return {"data": data, "terms": terms, "command": command, "config": asdict(config), "held_out_error": errors}
