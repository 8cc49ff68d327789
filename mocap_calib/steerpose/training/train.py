"""Training of the lifter, and its error on poses it has never seen."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, fields, replace
from typing import Any

import torch
from torch import Tensor, nn

from mocap_calib.config import PairsConfig, TrainConfig
from mocap_calib.errors import FormatError
from mocap_calib.steerpose.model import Lifter, ModelConfig
from mocap_calib.steerpose.steer import Model, steer
from mocap_calib.steerpose.token import TokenConfig, TokenSteerer
from mocap_calib.steerpose.training.dataset import Batch, Synthesiser
from mocap_calib.steerpose.training.pairs import PairSynthesiser
from mocap_calib.steerpose.training.poses import PoseSet
from mocap_calib.types import Progress, Skeleton


def training_config(settings: Mapping[str, Any]) -> TrainConfig:
    """The defaults with the section `training` of a skeleton's file. Raises FormatError for a setting that does not exist."""
    if strangers := sorted(set(settings) - {field.name for field in fields(TrainConfig)}):
        raise FormatError(
            f"training: expected settings of TrainConfig (docs/skeletons.md), found {', '.join(strangers)}"
        )
    chosen: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in settings.items()
    }
    return replace(TrainConfig(), **chosen)


def train_lifter(
    poses: PoseSet,
    skeleton: Skeleton,
    config: TrainConfig,
    *,
    device: str = "cpu",
    progress: Progress,
) -> Lifter:
    """Trains on synthesised views; the same seed gives the same weights on the same machine.

    The pose is fitted by its mean joint distance (the paper's eq. 1 in 3D, which bounds it for every R), the
    uncertainty by the Laplace likelihood of the errors that remain.
    """
    torch.manual_seed(config.seed)
    lifter = (
        Lifter(ModelConfig(len(skeleton.keypoints), config.width, config.layers)).to(device).train()
    )
    source = Synthesiser(poses, skeleton, config, config.seed)

    def next_loss() -> Tensor:
        batch = source.batch(config.batch)
        return lifting_loss(
            lifter, Batch(batch.pose.to(device), batch.seen.to(device), batch.target.to(device))
        )

    optimise(lifter, next_loss, config, progress=progress)
    return lifter.eval()


def train_steerer(
    poses: PoseSet,
    skeleton: Skeleton,
    config: TrainConfig,
    pairs: PairsConfig,
    *,
    device: str = "cpu",
    progress: Progress,
) -> TokenSteerer:
    """Trains the paper's network with its loss L_kp (eq. 1) on its pairs; of `config` only size, steps, batch, rate and seed count."""
    torch.manual_seed(config.seed)
    model = (
        TokenSteerer(TokenConfig(len(skeleton.keypoints), config.width, config.layers))
        .to(device)
        .train()
    )
    source = PairSynthesiser(poses, skeleton, pairs, "train", config.seed)

    def next_loss() -> Tensor:
        batch = source.batch(config.batch)
        steered = model(batch.pose.to(device), batch.seen.to(device), batch.vector.to(device))
        return displacement(steered, batch.target.to(device)).mean()

    optimise(model, next_loss, config, progress=progress)
    return model.eval()


def optimise(
    model: nn.Module, next_loss: Callable[[], Tensor], config: TrainConfig, *, progress: Progress
) -> None:
    """The training loop of both architectures: AdamW, one cycle."""
    optimiser = torch.optim.AdamW(model.parameters(), lr=config.learning_rate, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, config.learning_rate, total_steps=config.steps, pct_start=0.05
    )
    for step in range(config.steps):
        loss = next_loss()
        optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        progress(f"train (loss {loss.item():.3f})", step + 1, config.steps)


def displacement(steered: Tensor, target: Tensor) -> Tensor:
    """`[B]` mean keypoint displacement D(q, p') of eq. 1, poses `[B, J, 2]`."""
    return torch.sqrt((steered - target).square().sum(-1) + 1e-8).mean(-1)


def lifting_loss(lifter: Lifter, batch: Batch) -> Tensor:
    """Mean joint distance, plus the Laplace likelihood of what remains across and along the ray, over the joints with a target."""
    joints, log_spread = lifter(batch.pose, batch.seen)
    known = torch.isfinite(batch.target[..., 0])
    error = torch.where(known[..., None], joints - batch.target.nan_to_num(), 0.0)
    distance = torch.sqrt(error.square().sum(-1) + 1e-8)
    remains = torch.stack([error[..., :2].detach().norm(dim=-1), error[..., 2].detach().abs()], -1)
    likelihood = (remains * torch.exp(-log_spread) + log_spread).mean(-1)
    return ((distance + 0.1 * likelihood) * known).sum() / known.sum()


@torch.no_grad()
def held_out_error(
    lifter: Lifter, poses: PoseSet, skeleton: Skeleton, config: TrainConfig, *, examples: int = 8192
) -> dict[str, float]:
    """Errors on unseen poses, in units of the visible pose's RMS radius.

    joint_3d: mean joint distance. steered_2d: mean keypoint displacement (the paper's eq. 1) after a rotation about
    the vertical drawn uniformly. completed_2d: the same without rotation, over the joints that were not seen.
    """
    source = Synthesiser(poses, skeleton, config, seed=12345)
    batch = source.batch(examples)
    joints, _ = lifter(batch.pose, batch.seen)
    error = joints - batch.target
    angle = 2 * torch.pi * torch.rand(examples, 1, generator=torch.Generator().manual_seed(54321))
    steered = torch.stack(
        [error[..., 0] * angle.cos() + error[..., 2] * angle.sin(), error[..., 1]], -1
    )
    return {
        "joint_3d": round(error.norm(dim=-1).nanmean().item(), 4),
        "steered_2d": round(steered.norm(dim=-1).nanmean().item(), 4),
        "completed_2d": round(error[..., :2].norm(dim=-1)[~batch.seen].nanmean().item(), 4),
    }


@torch.no_grad()
def steering_error(
    model: Model, poses: PoseSet, skeleton: Skeleton, config: PairsConfig, *, examples: int = 8192
) -> dict[str, float]:
    """L_kp (eq. 1) of either architecture on pairs and poses held out, in units of the visible pose's RMS radius.

    identity_2d: the displacement of the seen joints when nothing is turned.
    """
    batch = PairSynthesiser(poses, skeleton, config, "test", seed=12345).batch(examples)
    steered = displacement(steer(model, batch.pose, batch.seen, batch.vector), batch.target)
    upright = PairSynthesiser(
        poses, skeleton, replace(config, noise=1e-6), "test", seed=12345
    ).batch(examples)
    still = steer(model, upright.pose, upright.seen, torch.zeros_like(upright.vector))
    to_first = (
        torch.where(
            upright.seen[..., None], (still - upright.pose).square(), torch.zeros_like(still)
        )
        .sum(-1)
        .sqrt()
    )
    return {
        "steered_2d": round(steered.mean().item(), 4),
        "identity_2d": round(to_first[upright.seen].mean().item(), 4),
    }


def model_card(
    config: TrainConfig, errors: dict[str, float], *, command: str, data: str, terms: str
) -> dict[str, object]:
    """What a user of the weights should know, as stored in the file."""
    return {
        "data": data,
        "terms": terms,
        "command": command,
        "config": asdict(config),
        "held_out_error": errors,
    }
