"""The paper's solver: rotation and matches of two views by gradient descent through SteerPose (section 3.2).

Adam from a random rotation on L_match + lambda L_geom, up to five tries until the 3D poses reproject within 10 pixels.
Kept as a measured reference; `pairwise.py` is the program's own. Several pairs of views and tries run in one batch, each
as if it were alone.
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from mocap_calib.config import PaperConfig
from mocap_calib.steerpose.model import normalise
from mocap_calib.steerpose.paper.losses import (
    depths,
    geometric_loss,
    keypoint_distance,
    matching_loss,
    similarity,
    sinkhorn,
    translation_direction,
    with_dummies,
)
from mocap_calib.steerpose.steer import Model, matrix_from_vector, steering
from mocap_calib.types import Floats, Ints, Sample

_FAR_PX = 100.0  # a joint reprojected farther away, or behind a camera, counts as this
_LEAST_JOINTS = 4


@dataclass(frozen=True)
class TwoViews:
    """The detections of views a and b in the joints of the model.

    rays_a: `[frame, I, joint, 3]` unit rays, NaN = missing; rays_b: `[frame, J, joint, 3]`. focal: mean focal length, pixels.
    """

    rays_a: Floats
    rays_b: Floats
    focal: float


@dataclass(frozen=True)
class PaperSolution:
    """b_from_a: rotation `[3, 3]`, translation `[3]` (a direction); matches `[match, 3]` rows (frame, i, j).

    error: mean reprojection error in pixels, infinite without a match; tries: how many random starts were needed.
    """

    rotation: Floats
    translation: Floats
    matches: Ints
    error: float
    tries: int


@dataclass(frozen=True)
class _Batch:
    """Problems side by side. pose: `[B, F, I, N, 2]` image points, seen: `[B, F, I, N]`, ray: `[B, F, I, N, 3]`; focal `[B]`."""

    pose_a: Tensor
    pose_b: Tensor
    seen_a: Tensor
    seen_b: Tensor
    ray_a: Tensor
    ray_b: Tensor
    focal: Tensor

    def __getitem__(self, index: list[int]) -> "_Batch":
        return _Batch(*(part[index] for part in vars(self).values()))

    @property
    def there(self) -> tuple[Tensor, Tensor]:
        """`[B, F, I]`, `[B, F, J]` bodies with enough joints to be steered."""
        return self.seen_a.sum(-1) >= _LEAST_JOINTS, self.seen_b.sum(-1) >= _LEAST_JOINTS


def two_views(recording: Sample, a: int, b: int, frames: Ints, joints: int) -> TwoViews:
    """The detections of two views in these frames (indices), in the order of the model's joints."""
    first, second = (
        by_joint(recording.rays[view][frames], recording.vocabulary, joints) for view in (a, b)
    )
    return TwoViews(first, second, (recording.cameras[a].focal + recording.cameras[b].focal) / 2)


def by_joint(rays: Floats, vocabulary: Ints, joints: int) -> Floats:
    """Rays `[..., keypoint, 3]` in the order of the model's joints, `[..., joint, 3]`; NaN for joints that no keypoint is."""
    known = vocabulary >= 0
    out = np.full((*rays.shape[:-2], joints, 3), np.nan)
    out[..., vocabulary[known], :] = rays[..., known, :]
    return out


def seeded(seed: int) -> torch.Generator:
    """The source of the random starts."""
    return torch.Generator().manual_seed(seed)


def solve_pair(
    views: TwoViews,
    model: Model,
    config: PaperConfig,
    generator: torch.Generator,
    *,
    start: Tensor | None = None,
) -> PaperSolution:
    """Solves one pair of views; `start` `[3]` is the first rotation vector to try, otherwise a random one."""
    return solve_pairs(
        [views], model, config, generator, start=None if start is None else start[None]
    )[0]


def solve_pairs(
    problems: Sequence[TwoViews],
    model: Model,
    config: PaperConfig,
    generator: torch.Generator,
    *,
    start: Tensor | None = None,
) -> list[PaperSolution]:
    """Solves pairs of views of equal numbers of frames, instances and joints; those that fail are tried again.

    start: `[problem, 3]` rotation vectors of the first try. Of five failures the one with the least error is returned.
    """
    batch = _batch(problems)
    model = copy.deepcopy(model).requires_grad_(False)  # frozen: no gradients of weights are needed
    best: list[PaperSolution | None] = [None] * len(problems)
    for number in range(1, config.tries + 1):
        open_ = [
            k for k, found in enumerate(best) if found is None or found.error >= config.success_px
        ]
        if not open_:
            break
        first = (
            start if start is not None and number == 1 else random_rotations(len(open_), generator)
        )
        for k, found in zip(
            open_, _descend(batch[open_], model, first, config, number), strict=True
        ):
            before = best[k]
            better = before is None or found.error < before.error
            best[k] = found if better else replace(before, tries=number)  # type: ignore[type-var]
    return [found for found in best if found is not None]


def random_rotations(count: int, generator: torch.Generator) -> Tensor:
    """`[count, 3]` rotation vectors, uniform over all rotations (random unit quaternions)."""
    quaternion = torch.nn.functional.normalize(torch.randn(count, 4, generator=generator), dim=1)
    quaternion = torch.where(quaternion[:, :1] < 0, -quaternion, quaternion)
    sine = quaternion[:, 1:].norm(dim=1, keepdim=True)
    return quaternion[:, 1:] / sine.clamp_min(1e-9) * 2 * torch.atan2(sine, quaternion[:, :1])


def _batch(problems: Sequence[TwoViews]) -> _Batch:
    def side(rays: list[Floats]) -> tuple[Tensor, Tensor, Tensor]:
        stacked = np.stack(rays)
        seen = np.nan_to_num(stacked[..., 2]) > 0.05  # rays that have an image point
        pose = stacked[..., :2] / np.where(seen, stacked[..., 2], 1.0)[..., None]
        known = np.where(seen[..., None], pose, 0.0), seen, np.where(seen[..., None], stacked, 0.0)
        return (
            torch.from_numpy(known[0]).float(),
            torch.from_numpy(known[1]),
            torch.from_numpy(known[2]).float(),
        )

    pose_a, seen_a, ray_a = side([p.rays_a for p in problems])
    pose_b, seen_b, ray_b = side([p.rays_b for p in problems])
    return _Batch(
        pose_a, pose_b, seen_a, seen_b, ray_a, ray_b, torch.tensor([p.focal for p in problems])
    )


def _descend(
    batch: _Batch, model: Model, start: Tensor, config: PaperConfig, number: int
) -> list[PaperSolution]:
    """One try of each problem: 1,000 iterations of Adam on the rotation vectors, everything else frozen."""
    with torch.no_grad():
        both = _steering_both_ways(batch, model)
    vector = start.clone().requires_grad_()
    optimiser = torch.optim.Adam([vector], lr=config.learning_rate)
    schedule = torch.optim.lr_scheduler.LinearLR(
        optimiser, 1.0, config.final_rate, config.iterations
    )
    for iteration in range(config.iterations):
        optimiser.zero_grad(set_to_none=True)
        loss, mutual = _match(batch, both, vector, config)
        if config.geometric_weight > 0 and iteration >= config.geometric_from * config.iterations:
            loss = loss + config.geometric_weight * _geometry(batch, vector, mutual, config)
        loss.sum().backward()  # type: ignore[no-untyped-call]  # problems do not mix: Adam goes by element
        vector.grad = torch.nan_to_num(vector.grad) if vector.grad is not None else None
        optimiser.step()
        schedule.step()
    with torch.no_grad():
        mutual = _match(batch, both, vector, config)[1]
        return [_solution(batch, k, vector[k], mutual[k], number) for k in range(len(vector))]


def _steering_both_ways(batch: _Batch, model: Model) -> Callable[[Tensor], tuple[Tensor, Tensor]]:
    """Q(R) of a's poses in b, and of b's poses in a by the inverse, in one pass: `[B, 3]` -> `[B, F, I, N, 2]`, `[B, F, J, N, 2]`."""
    shape_a, shape_b = batch.pose_a.shape, batch.pose_b.shape
    pose = torch.cat([batch.pose_a.flatten(0, 2), batch.pose_b.flatten(0, 2)])
    seen = torch.cat([batch.seen_a.flatten(0, 2), batch.seen_b.flatten(0, 2)])
    turn = steering(model, normalise(pose, seen)[0], seen)
    split = shape_a[:3].numel()

    def both(vector: Tensor) -> tuple[Tensor, Tensor]:
        there = vector[:, None, None].expand(*shape_a[:3], 3).flatten(0, 2)
        back = -vector[:, None, None].expand(*shape_b[:3], 3).flatten(0, 2)
        steered = turn(torch.cat([there, back]))
        return steered[:split].view(shape_a), steered[split:].view(shape_b)

    return both


def _match(
    batch: _Batch,
    both: Callable[[Tensor], tuple[Tensor, Tensor]],
    vector: Tensor,
    config: PaperConfig,
) -> tuple[Tensor, Tensor]:
    """L_match `[B]`, mean over the possible matches and both directions, and the mutual matches `[B, F, I, J]` (bool)."""
    in_b, in_a = both(vector)
    forth = keypoint_distance(in_b, batch.pose_b, batch.seen_b)
    back = keypoint_distance(in_a, batch.pose_a, batch.seen_a).transpose(-1, -2)
    score = similarity(torch.stack([forth, back]), config.alpha)  # (2, B, F, I, J)
    there_a, there_b = batch.there
    weight = sinkhorn(
        with_dummies(score, there_a, there_b), sharpness=config.sharpness, sweeps=config.sweeps
    )
    possible = torch.minimum(there_a.sum(-1), there_b.sum(-1)).sum(-1).clamp_min(1)
    loss = matching_loss(weight, score, there_a, there_b).sum((0, 2)) / (2 * possible)
    best = (weight == weight.amax(-1, keepdim=True)) & (weight == weight.amax(-2, keepdim=True))
    rows, columns = score.shape[-2:]
    real = there_a[..., :, None] & there_b[..., None, :]
    return loss, best.all(0)[..., :rows, :columns] & real


def _geometry(batch: _Batch, vector: Tensor, mutual: Tensor, config: PaperConfig) -> Tensor:
    """L_geom `[B]` of the mutual matches, 0 where there are too few. A view with one body in all can have but one match."""
    there_a, there_b = batch.there
    needed = torch.minimum(there_a.sum(-1), there_b.sum(-1)).sum(-1).clamp(1, config.mutual)
    rays_a, rays_b, weight = _matched_rays(batch, mutual)
    loss = geometric_loss(matrix_from_vector(vector), rays_a, rays_b, weight)
    return torch.where(mutual.sum((1, 2, 3)) >= needed, loss, torch.zeros_like(loss))


def _matched_rays(batch: _Batch, mutual: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Rays `[B, P, 3]` of all joints of all possible matches, and their weight `[B, P]`: 1 for those of mutual matches."""
    weight = (
        mutual[..., None] & batch.seen_a[:, :, :, None] & batch.seen_b[:, :, None]
    )  # (B, F, I, J, N)
    rays_a = batch.ray_a[:, :, :, None].expand(*weight.shape, 3)
    rays_b = batch.ray_b[:, :, None].expand(*weight.shape, 3)
    return rays_a.flatten(1, 4), rays_b.flatten(1, 4), weight.flatten(1).to(rays_a.dtype)


def _solution(batch: _Batch, k: int, vector: Tensor, mutual: Tensor, number: int) -> PaperSolution:
    """Translation, cheirality and reprojection error of one problem, in double precision."""
    rays_a, rays_b, weight = (part[0].double() for part in _matched_rays(batch[[k]], mutual[None]))
    rays_a, rays_b = rays_a[weight > 0], rays_b[weight > 0]
    rotation = matrix_from_vector(vector.double())
    matches = torch.nonzero(mutual).numpy().astype(np.int64)
    if len(rays_a) < _LEAST_JOINTS:
        return PaperSolution(rotation.numpy(), np.array([0.0, 0.0, 1.0]), matches, np.inf, number)
    t, _ = translation_direction(rotation, rays_a, rays_b, torch.ones(len(rays_a)).double())
    error = reprojection_error(rotation, t, rays_a, rays_b) * batch.focal[k].item()
    return PaperSolution(
        rotation.numpy(), t.numpy(), matches, error.clamp_max(_FAR_PX).mean().item(), number
    )


def reprojection_error(
    rotation: Tensor, translation: Tensor, rays_a: Tensor, rays_b: Tensor
) -> Tensor:
    """`[N]` mean distance in both normalised images of the triangulated points from what was seen; infinite behind a camera."""
    near_a, near_b = depths(rotation, translation, rays_a, rays_b)
    point = (near_a[:, None] * rays_a + (near_b[:, None] * rays_b - translation) @ rotation) / 2
    moved = point @ rotation.T + translation
    ahead = (point[:, 2] > 1e-9) & (moved[:, 2] > 1e-9)
    pairs = ((point, rays_a), (moved, rays_b))
    errors = [
        (p[:, :2] / p[:, 2:].clamp_min(1e-9) - u[:, :2] / u[:, 2:]).norm(dim=-1) for p, u in pairs
    ]
    return torch.where(ahead, (errors[0] + errors[1]) / 2, torch.full_like(errors[0], torch.inf))
