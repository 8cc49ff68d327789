"""Train the networks and measure their errors; a seed gives the same weights on a machine."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, fields, replace
from typing import Any

import torch
from torch import Tensor, nn

from mocap_calib.errors import FormatError
from mocap_calib.lift.lifter import ModelConfig
from mocap_calib.training import (
    EVALUATION_EXAMPLES,
    EVALUATION_SEED,
    LARGEST_GRADIENT,
    UNCERTAINTY_WEIGHT,
    WARM_UP,
    PairsConfig,
    TrainConfig,
)
from mocap_calib.training.model import LifterModule, Model, TokenConfig, TokenSteerer, steer
from mocap_calib.training.poses import PoseSet
from mocap_calib.training.synthesis import Batch, PairSynthesiser, Synthesiser
from mocap_calib.types import Progress, Skeleton


def training_config(settings: Mapping[str, Any]) -> TrainConfig:
    """Return the defaults, changed by the section `training` of a skeleton's file.

    Raises FormatError for a setting that does not exist.
    """
    known = {field.name for field in fields(TrainConfig)}
    if unknown := sorted(set(settings) - known):
        raise FormatError(
            "training",
            "settings of TrainConfig (docs/skeletons.md)",
            ", ".join(unknown),
            "rename or remove them",
        )
    values: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in settings.items()
    }
    return replace(TrainConfig(), **values)


def train_lifter(
    poses: PoseSet,
    skeleton: Skeleton,
    config: TrainConfig,
    *,
    device: str = "cpu",
    progress: Progress,
) -> LifterModule:
    """Train a lifter on synthesised views of poses, by `lifting_loss`."""
    torch.manual_seed(config.seed)
    size = ModelConfig(len(skeleton.keypoints), config.width, config.layers)
    lifter = LifterModule(size).to(device).train()
    source = Synthesiser(poses, skeleton, config, seed=config.seed)

    def next_loss() -> Tensor:
        """Return the loss `[]` on a new batch."""
        return lifting_loss(lifter, source.batch(config.batch).to(device))

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
    """Train the paper's network by its loss L_kp (eq. 1) on its pairs (appendix C).

    Of `config` only the size, the steps, the batch, the learning rate and the seed count.
    """
    torch.manual_seed(config.seed)
    size = TokenConfig(len(skeleton.keypoints), config.width, config.layers)
    model = TokenSteerer(size).to(device).train()
    source = PairSynthesiser(poses, skeleton, pairs, split="train", seed=config.seed)

    def next_loss() -> Tensor:
        """Return L_kp `[]` on a new batch."""
        batch = source.batch(config.batch)
        steered = model(batch.pose.to(device), batch.seen.to(device), batch.vector.to(device))
        return displacement(steered, batch.target.to(device)).mean()

    optimise(model, next_loss, config, progress=progress)
    return model.eval()


def optimise(
    model: nn.Module, next_loss: Callable[[], Tensor], config: TrainConfig, *, progress: Progress
) -> None:
    """Minimise the loss of new batches: Adam, its learning rate in one cycle.

    next_loss: synthesises a batch and returns the loss `[]` of the model on it.
    """
    optimiser = torch.optim.Adam(model.parameters(), lr=config.learning_rate)
    # torch divides by the number of steps after the first in which the rate rises
    warm_up = WARM_UP if WARM_UP * config.steps > 1 else 0.0
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, config.learning_rate, total_steps=config.steps, pct_start=warm_up
    )
    for step in range(config.steps):
        loss = next_loss()
        optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(model.parameters(), LARGEST_GRADIENT)
        optimiser.step()
        schedule.step()
        progress(f"train (loss {loss.item():.3f})", step + 1, config.steps)


def model_card(
    config: TrainConfig, errors: dict[str, float], *, command: str, data: str, terms: str
) -> dict[str, object]:
    """Return what a user of the weights should know, as stored in the file."""
    return {
        "data": data,
        "terms": terms,
        "command": command,
        "config": asdict(config),
        "held_out_error": errors,
    }


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
    steered_2d: mean keypoint displacement (the paper's eq. 1) after rotations about the vertical
        by all angles alike.
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
    batch, still = (
        PairSynthesiser(poses, skeleton, each, split="test", seed=EVALUATION_SEED).batch(examples)
        for each in (config, replace(config, noise=1e-6))
    )
    steered = steer(model, batch.pose, batch.seen, batch.vector)
    unturned = steer(model, still.pose, still.seen, torch.zeros_like(still.vector))
    return {
        "steered_2d": _rounded_mean(displacement(steered, batch.target)),
        "identity_2d": _rounded_mean((unturned - still.pose).norm(dim=-1)[still.seen]),
    }


def _project_turned(error: Tensor) -> Tensor:
    """Return errors `[B, J, 3]` in the image `[B, J, 2]` after turns about the vertical.

    The angles are spread evenly over the examples.
    """
    angle = 2 * torch.pi * torch.arange(len(error))[:, None] / len(error)
    across = error[..., 0] * angle.cos() + error[..., 2] * angle.sin()
    return torch.stack([across, error[..., 1]], -1)


def _rounded_mean(values: Tensor) -> float:
    """Return the mean of values `[...]`, those that are not known left out, to four digits."""
    return round(values.nanmean().item(), 4)
