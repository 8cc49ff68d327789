"""Train the networks; the same seed gives the same weights on the same machine."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, fields, replace
from typing import Any

import torch
from torch import Tensor, nn

from mocap_calib.config import LARGEST_GRADIENT, WARM_UP, WEIGHT_DECAY, PairsConfig, TrainConfig
from mocap_calib.errors import FormatError
from mocap_calib.lift.lifter import ModelConfig
from mocap_calib.training.dataset import Synthesiser
from mocap_calib.training.losses import displacement, lifting_loss
from mocap_calib.training.model import LifterModule
from mocap_calib.training.pairs import PairSynthesiser
from mocap_calib.training.poses import PoseSet
from mocap_calib.training.token import TokenConfig, TokenSteerer
from mocap_calib.types import Progress, Skeleton


def training_config(settings: Mapping[str, Any]) -> TrainConfig:
    """Return the defaults, changed by the section `training` of a skeleton's file.

    Raises FormatError for a setting that does not exist.
    """
    known = {field.name for field in fields(TrainConfig)}
    if unknown := sorted(set(settings) - known):
        raise FormatError(
            "training: expected settings of TrainConfig (docs/skeletons.md), "
            f"found {', '.join(unknown)}"
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
    """Minimise the loss of new batches: AdamW, its learning rate in one cycle.

    next_loss: synthesises a batch and returns the loss `[]` of the model on it.
    """
    optimiser = torch.optim.AdamW(
        model.parameters(), lr=config.learning_rate, weight_decay=WEIGHT_DECAY
    )
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
