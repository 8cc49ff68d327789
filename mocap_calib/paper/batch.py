"""Settings of the paper's solver, and the pairs of views that it solves as tensors."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from mocap_calib.types import Floats


@dataclass(frozen=True)
class PaperConfig:
    """The paper's solver (section 3.2 and appendix C.3); what the paper leaves open is marked."""

    frames: int = 5  # of a pair of views at a time; the paper has one
    iterations: int = 1000
    learning_rate: float = 0.01
    final_rate: float = 0.01  # of the learning rate, reached linearly
    alpha: float = 3.0  # of the similarity
    sharpness: float = 10.0  # of Sinkhorn; open in the paper
    sweeps: int = 10  # of Sinkhorn; open in the paper
    geometric_weight: float = 1.0  # lambda, "empirically determined"; 0 leaves L_geom out
    # L_geom of the whole system as in the paper, or with its points eliminated, which is 3 x 3
    full_system: bool = False
    geometric_from: float = 0.4  # share of the iterations before L_geom is active
    mutual: int = 2  # matches, mutual in both directions, before L_geom is active
    tries: int = 5
    success_px: float = 10.0


LEAST_JOINTS = 4  # seen joints of a body that is steered
_LEAST_RAY_DEPTH = 0.05  # z of a unit ray that has an image point


@dataclass(frozen=True)
class TwoViews:
    """The detections of views a and b in the joints of the model.

    rays_a: `[frame, I, joint, 3]` unit rays, NaN = missing.
    rays_b: `[frame, J, joint, 3]` likewise.
    focal: mean focal length of both cameras in pixels.
    """

    rays_a: Floats
    rays_b: Floats
    focal: float


@dataclass(frozen=True)
class Batch:
    """Problems side by side: B problems, F frames, I and J instances, N joints.

    pose: `[B, F, I, N, 2]` normalised image points, 0 where not seen.
    seen: `[B, F, I, N]` bool.
    ray: `[B, F, I, N, 3]` unit rays, 0 where not seen.
    focal: `[B]` pixels.
    """

    pose_a: Tensor
    pose_b: Tensor
    seen_a: Tensor
    seen_b: Tensor
    ray_a: Tensor
    ray_b: Tensor
    focal: Tensor

    def select(self, problems: list[int]) -> "Batch":
        """Return these problems (indices) alone."""
        return Batch(**{name: part[problems] for name, part in vars(self).items()})

    @property
    def present_a(self) -> Tensor:
        """`[B, F, I]` bodies of view a with enough joints to be steered."""
        return self.seen_a.sum(-1) >= LEAST_JOINTS

    @property
    def present_b(self) -> Tensor:
        """`[B, F, J]` bodies of view b with enough joints to be steered."""
        return self.seen_b.sum(-1) >= LEAST_JOINTS

    @property
    def most_matches(self) -> Tensor:
        """`[B]` how many matches there can be in all frames together."""
        bodies_a, bodies_b = self.present_a.sum(-1), self.present_b.sum(-1)
        return torch.minimum(bodies_a, bodies_b).sum(-1)


def stack_problems(problems: Sequence[TwoViews]) -> Batch:
    """Return pairs of views with equal numbers of frames, instances and joints as one batch."""
    pose_a, seen_a, ray_a = _stack_view([problem.rays_a for problem in problems])
    pose_b, seen_b, ray_b = _stack_view([problem.rays_b for problem in problems])
    focal = torch.tensor([problem.focal for problem in problems])
    return Batch(pose_a, pose_b, seen_a, seen_b, ray_a, ray_b, focal)


def _stack_view(rays: list[Floats]) -> tuple[Tensor, Tensor, Tensor]:
    """Return pose, seen and ray of `Batch` for one of the views of all problems."""
    stacked = np.stack(rays)
    depth = stacked[..., 2]
    seen = np.nan_to_num(depth) > _LEAST_RAY_DEPTH
    pose = stacked[..., :2] / np.where(seen, depth, 1.0)[..., None]
    pose = np.where(seen[..., None], pose, 0.0)
    ray = np.where(seen[..., None], stacked, 0.0)
    return torch.from_numpy(pose).float(), torch.from_numpy(seen), torch.from_numpy(ray).float()
