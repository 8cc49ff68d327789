"""The paper's losses: similarity, differentiable matching, and geometric consistency.

SteerPose (Lee et al., BMVC 2025), section 3.2, on batches of pairs of views.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from mocap_calib.config import LEAST_FORWARD, LEAST_JOINTS
from mocap_calib.types import Floats

_EPSILON = 1e-12


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
    def possible(self) -> Tensor:
        """`[B, F, I, J]` pairs of bodies with enough joints to be steered."""
        present_a, present_b = (seen.sum(-1) >= LEAST_JOINTS for seen in (self.seen_a, self.seen_b))
        return present_a[..., :, None] & present_b[..., None, :]

    @property
    def most_matches(self) -> Tensor:
        """`[B]` how many matches there can be in all frames together."""
        bodies_a, bodies_b = (self.possible.any(axis).sum(-1) for axis in (-1, -2))
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
    seen = np.nan_to_num(depth) > LEAST_FORWARD
    pose = stacked[..., :2] / np.where(seen, depth, 1.0)[..., None]
    pose = np.where(seen[..., None], pose, 0.0)
    ray = np.where(seen[..., None], stacked, 0.0)
    return torch.from_numpy(pose).float(), torch.from_numpy(seen), torch.from_numpy(ray).float()


def similarity(displacement: Tensor, *, alpha: float) -> Tensor:
    """Return s = 2 / (1 + exp(alpha L_kp)) of section 3.2: 1 for the same pose, 0 for the farthest.

    displacement: `[...]` L_kp (eq. 1), any shape.
    """
    return 2 * torch.sigmoid(-alpha * displacement)


def keypoint_distance(steered: Tensor, pose: Tensor, seen: Tensor) -> Tensor:
    """Return L_kp (eq. 1) of all pairs of poses: `[..., I, J]` mean distance of the seen joints.

    steered: `[..., I, N, 2]` complete poses; pose: `[..., J, N, 2]` observed ones; seen:
    `[..., J, N]` bool. The size and place of a body in an image are not comparable between views:
    both poses are centred and scaled over the joints that pose j shows.
    """
    weight = seen.to(pose.dtype)
    weight = weight / weight.sum(-1, keepdim=True).clamp_min(1.0)  # (..., J, N)
    known = torch.where(seen[..., None], pose, torch.zeros_like(pose))
    observed = _centre_and_scale(known, weight)  # (..., J, N, 2)
    weight = weight[..., None, :, :]  # (..., 1, J, N)
    rotated = _centre_and_scale(steered[..., :, None, :, :], weight)  # (..., I, J, N, 2)
    offset = rotated - observed[..., None, :, :, :]
    distance = torch.sqrt(offset.square().sum(-1) + _EPSILON)  # (..., I, J, N)
    return (distance * weight).sum(-1)


def _centre_and_scale(pose: Tensor, weight: Tensor) -> Tensor:
    """Return poses `[..., N, 2]` centred, with an RMS radius of 1, under weights `[..., N]`."""
    weight = weight[..., None]
    offset = pose - (pose * weight).sum(-2, keepdim=True)
    square = (offset.square() * weight).sum((-1, -2), keepdim=True)
    return offset / torch.sqrt(square + _EPSILON)


def sinkhorn(score: Tensor, *, sharpness: float, sweeps: int) -> Tensor:
    """Return the doubly stochastic weights `[..., S, S]` of a square of similarities.

    Cuturi 2013, differentiable; in logarithms, so that any sharpness is safe; the columns are
    normalised last. Where one side has fewer instances, `with_dummies` has filled it up: rows and
    columns each sum to 1, dummies included.
    """
    weight = sharpness * score
    for _ in range(sweeps):
        weight = weight - weight.logsumexp(-1, keepdim=True)
        weight = weight - weight.logsumexp(-2, keepdim=True)
    return weight.exp()


def with_dummies(score: Tensor, possible: Tensor) -> Tensor:
    """Fill similarities `[..., I, J]` up to a square `[..., S, S]` with zeros: dummy targets.

    For numbers of instances that differ (N != N' in section 3.2). possible: `[..., I, J]` bool,
    whether both instances exist; one that does not is a dummy as well.
    """
    rows, columns = score.shape[-2:]
    size = max(rows, columns)
    known = torch.where(possible, score, torch.zeros_like(score))
    return torch.nn.functional.pad(known, (0, size - columns, 0, size - rows))


def matching_loss(weight: Tensor, score: Tensor, possible: Tensor) -> Tensor:
    """Return L_match = sum w (1 - s) `[...]` over pairs of instances that exist.

    Section 3.2, one direction. weight: `[..., S, S]` of `sinkhorn`; score: `[..., I, J]`;
    possible: `[..., I, J]` bool, whether both instances exist.
    """
    rows, columns = score.shape[-2:]
    return (weight[..., :rows, :columns] * (1 - score) * possible).sum((-1, -2))


def geometric_loss(rotation: Tensor, rays_a: Tensor, rays_b: Tensor, weight: Tensor) -> Tensor:
    """Return L_geom `[...]` (section 3.2): 0 where rotation and matches allow a translation.

    sigma_1 / sigma_2 of the rows n = (R u_a) x u_b, from the eigenvalues of sum w n n'. This is
    the paper's system of collinearity with the points eliminated (Kneip and Lynen 2013), without
    its factor 1 + 1 / (2 |n|^2) of a row: n of rays that are nearly parallel, where |n| is small,
    is noise, and a factor changes no zero, which is where the loss is led to.

    rotation: `[..., 3, 3]` b_from_a; rays: `[..., N, 3]` of unit length; weight: `[..., N]`, 0 = no
    match.
    """
    normal = torch.linalg.cross(rays_a @ rotation.transpose(-1, -2), rays_b)
    matrix = torch.einsum("...n,...ni,...nj->...ij", weight, normal, normal)
    trace = matrix.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    values = torch.linalg.eigvalsh(matrix / (trace + _EPSILON))  # (..., 3) ascending
    # The root has no slope at zero: an angle of 1e-5 is below what any image resolves.
    smallest, second = (values[..., :2].clamp_min(0) + 1e-10).unbind(-1)
    return torch.sqrt(smallest / second)
