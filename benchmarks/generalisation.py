"""Compare a network for one species with one for all quadrupeds (the paper's Table 4).

With and without keypoint completion.

    .venv/bin/python benchmarks/generalisation.py --poses FOLDER [--steps 1500]

Mean keypoint displacement (the paper's eq. 1) after a rotation about the vertical, in units of the
visible pose's RMS radius, on the last tenth of each set; 10-30 % of the joints masked, 3 % noise.
The networks for one species are trained here, on the first 70 % of its set, and thrown away: the
sets are for evaluation only. The one for all is the shipped model, which has seen no recorded
animal.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import torch

from mocap_calib.config import TrainConfig
from mocap_calib.recording.joints import load_section, load_skeleton
from mocap_calib.steerpose.checkpoint import load_steerer
from mocap_calib.steerpose.steer import Model, complete, steer
from mocap_calib.steerpose.training.dataset import Synthesiser
from mocap_calib.steerpose.training.poses import PoseSet, load_poses
from mocap_calib.steerpose.training.train import train_lifter, training_config
from mocap_calib.types import Skeleton, silent

SETS = {"dog": ("train_dog_mocap", "+y"), "cheetah": ("train_cheetah_fte", "+z")}
EXAMPLES = 4096


def main() -> None:
    """One table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--poses", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=1500)
    options = parser.parse_args()
    torch.set_num_threads(1)
    skeleton = load_skeleton("quadruped")
    shared, _ = load_steerer("quadruped")
    config = training_config(load_section("quadruped", "training"))
    config = replace(
        config,
        steps=options.steps,
        batch=128,
        noise=(0.03, 0.03),
        outliers=0.0,
        joint_dropout=0.0,
        occlusion=0.4,
    )
    print(
        "| target | class-specific | class-agnostic, no completion "
        "| class-agnostic, with completion |"
    )
    print("|---|---|---|---|")
    for name, (file, up) in SETS.items():
        training, testing = (
            load_poses(options.poses / file, skeleton, split, up=up) for split in ("train", "test")
        )
        own = train_lifter(training, skeleton, config, progress=silent)
        figures = [
            displaced(own, testing, skeleton, config),
            *(displaced(shared, testing, skeleton, config, completing=c) for c in (False, True)),
        ]
        print(f"| {name} | {' | '.join(f'{figure:.3f}' for figure in figures)} |", flush=True)


@torch.no_grad()
def displaced(
    lifter: Model,
    poses: PoseSet,
    skeleton: Skeleton,
    config: TrainConfig,
    *,
    completing: bool = False,
) -> float:
    """Mean displacement of the joints that the set has, after a rotation about the vertical."""
    batch = Synthesiser(poses, skeleton, config, seed=12345).batch(EXAMPLES)
    angle = 2 * torch.pi * torch.rand(EXAMPLES, 1, generator=torch.Generator().manual_seed(54321))
    vector = angle * torch.tensor([0.0, 1.0, 0.0])
    pose, seen = batch.pose, batch.seen
    if completing:
        pose, seen = complete(lifter, pose, seen), torch.ones_like(seen)
    found = steer(lifter, pose, seen, vector)
    true = (
        batch.target[..., 0] * angle.cos() + batch.target[..., 2] * angle.sin(),
        batch.target[..., 1],
    )
    return (found - torch.stack(true, -1)).norm(dim=-1).nanmean().item()


if __name__ == "__main__":
    main()
