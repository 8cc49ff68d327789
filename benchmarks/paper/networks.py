"""Compare a network for one species with one for all quadrupeds (the paper's Table 4).

Mean keypoint displacement (the paper's eq. 1) after a rotation about the vertical, in units of the
visible pose's RMS radius, on the last tenth of each set; 10-30 % of the joints masked, 3 % noise.
The networks for one species are trained here, on the first 70 % of its set, and thrown away: the
sets are for evaluation only. The one for all is the shipped model, which has seen no recorded
animal.
"""

from dataclasses import replace
from pathlib import Path

import torch

from mocap_calib.recording.joints import load_section, load_skeleton
from mocap_calib.training.model import Model, load_steerer, steer
from mocap_calib.training.poses import load_poses
from mocap_calib.training.synthesis import Batch, Synthesiser
from mocap_calib.training.train import train_lifter, training_config
from mocap_calib.types import silent

from .scenes import Kind

EXAMPLES = 4096


def displacements(poses: Path, kind: Kind, steps: int) -> tuple[float, float, float]:
    """Return those of a network trained for so many steps on the species, and of the shipped one.

    Of the shipped one without and with keypoint completion.
    """
    skeleton = load_skeleton(kind.model)
    config = replace(  # the paper's: 3 % noise, joints masked at random
        training_config(load_section(kind.model, "training")),
        steps=steps,
        batch=128,
        noise=(0.03, 0.03),
        outliers=0.0,
        joint_dropout=0.0,
        occlusion=0.4,
    )
    training, testing = (
        load_poses(poses / kind.file, skeleton, split, up=kind.up) for split in ("train", "test")
    )
    own = train_lifter(training, skeleton, config, progress=silent)
    shared, _ = load_steerer(kind.model)
    batch = Synthesiser(testing, skeleton, config, seed=12345).batch(EXAMPLES)
    angle = 2 * torch.pi * torch.rand(EXAMPLES, 1, generator=torch.Generator().manual_seed(54321))
    return (
        _displaced(own, batch, angle),
        _displaced(shared, batch, angle),
        _displaced(shared, batch, angle, completing=True),
    )


@torch.no_grad()
def _displaced(
    model: Model, batch: Batch, angle: torch.Tensor, *, completing: bool = False
) -> float:
    """Return the mean displacement of the joints that the set has, turned by `angle [B, 1]`."""
    pose, seen = batch.pose, batch.seen
    if completing:
        # appendix D of the paper: joints that are not seen where the network expects them
        predicted = steer(model, pose, seen, torch.zeros(len(pose), 3))  # (B, J, 2)
        pose, seen = torch.where(seen[..., None], pose, predicted), torch.ones_like(seen)
    found = steer(model, pose, seen, angle * torch.tensor([0.0, 1.0, 0.0]))
    across = batch.target[..., 0] * angle.cos() + batch.target[..., 2] * angle.sin()
    target = torch.stack([across, batch.target[..., 1]], -1)
    return (found - target).norm(dim=-1).nanmean().item()
