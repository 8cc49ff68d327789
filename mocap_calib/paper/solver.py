"""The paper's solver: rotation and matches of two views by gradient descent through SteerPose.

Lee et al., BMVC 2025, section 3.2 and appendix C.3: Adam from a random rotation on
L_match + lambda L_geom, up to five tries until the 3D poses reproject within 10 pixels. A measured
reference; `pairs.solve` is the program's own. Pairs of views and tries run in one batch.
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from mocap_calib.config import PairwiseConfig
from mocap_calib.lift.lift import rays_by_joint
from mocap_calib.pairs.solve import PairProblem, judge_pair, mean_focal
from mocap_calib.paper.batch import LEAST_JOINTS, Batch, PaperConfig, TwoViews, stack_problems
from mocap_calib.paper.losses import (
    depths,
    full_geometric_loss,
    geometric_loss,
    keypoint_distance,
    matching_loss,
    possible_matches,
    similarity,
    sinkhorn,
    translation_direction,
    with_dummies,
)
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import PairwiseCalibration
from mocap_calib.training.device import torch_threads
from mocap_calib.training.model import Model, matrix_from_vector, normalise, prepare_steering
from mocap_calib.types import Floats, Ints

_FAR_PX = 100.0  # a joint reprojected farther away, or behind a camera, counts as this


# Rotation vectors [B, 3] to the steered poses [B, F, I, N, 2] and [B, F, J, N, 2].
SteerBoth = Callable[[Tensor], tuple[Tensor, Tensor]]


@dataclass(frozen=True)
class PaperSolution:
    """What the solver found of one pair of views.

    rotation: `[3, 3]` of b_from_a.
    translation: `[3]` of b_from_a, a direction.
    matches: `[match, 3]` rows (frame, i, j).
    error: mean reprojection error in pixels, infinite without a match.
    tries: how many starts were needed.
    """

    rotation: Floats
    translation: Floats
    matches: Ints
    error: float
    tries: int


def solve_pair(
    views: TwoViews,
    model: Model,
    config: PaperConfig,
    generator: torch.Generator,
    *,
    start: Tensor | None = None,
) -> PaperSolution:
    """Solve one pair of views.

    start: `[3]` the first rotation vector to try; without it a random one.
    """
    starts = None if start is None else start[None]
    return solve_pairs([views], model, config, generator, start=starts)[0]


def solve_pairs(
    problems: Sequence[TwoViews],
    model: Model,
    config: PaperConfig,
    generator: torch.Generator,
    *,
    start: Tensor | None = None,
) -> list[PaperSolution]:
    """Solve pairs of views of equal numbers of frames, instances and joints.

    Those that fail are tried again; of five failures the one with the smallest error is returned.

    start: `[problem, 3]` rotation vectors of the first try; without them random ones.
    """
    batch = stack_problems(problems)
    model = copy.deepcopy(model).requires_grad_(False)  # gradients of weights are not needed
    best: dict[int, PaperSolution] = {}
    for number in range(1, config.tries + 1):
        unsolved = [
            k for k in range(len(problems)) if k not in best or best[k].error >= config.success_px
        ]
        if not unsolved:
            break
        vectors = start if number == 1 else None
        if vectors is None:
            vectors = random_rotations(len(unsolved), generator)
        found = _descend(batch.select(unsolved), model, vectors, config)
        for k, solution in zip(unsolved, found, strict=True):
            if k not in best or solution.error < best[k].error:
                best[k] = solution
            best[k] = replace(best[k], tries=number)
    return [best[k] for k in sorted(best)]


def random_rotations(count: int, generator: torch.Generator) -> Tensor:
    """Return rotation vectors `[count, 3]`, uniform over all rotations.

    From random unit quaternions (Shoemake 1992).
    """
    quaternion = torch.nn.functional.normalize(torch.randn(count, 4, generator=generator), dim=1)
    quaternion = torch.where(quaternion[:, :1] < 0, -quaternion, quaternion)
    cosine, axis = quaternion[:, :1], quaternion[:, 1:]
    sine = axis.norm(dim=1, keepdim=True)
    return axis / sine.clamp_min(1e-9) * 2 * torch.atan2(sine, cosine)


def _descend(batch: Batch, model: Model, start: Tensor, config: PaperConfig) -> list[PaperSolution]:
    """Try each problem once: Adam on the rotation vectors `[B, 3]`, everything else frozen."""
    with torch.no_grad():
        steer_both = _prepare_steering_both_ways(batch, model)
    vector = start.clone().requires_grad_()
    optimiser = torch.optim.Adam([vector], lr=config.learning_rate)
    schedule = torch.optim.lr_scheduler.LinearLR(
        optimiser, 1.0, config.final_rate, config.iterations
    )
    for iteration in range(config.iterations):
        optimiser.zero_grad(set_to_none=True)
        loss, mutual = _match(batch, steer_both, vector, config)
        if config.geometric_weight > 0 and iteration >= config.geometric_from * config.iterations:
            loss = loss + config.geometric_weight * _geometric_term(batch, vector, mutual, config)
        # Problems do not mix in the sum: Adam goes by element.
        loss.sum().backward()  # type: ignore[no-untyped-call]
        if vector.grad is not None:
            vector.grad = torch.nan_to_num(vector.grad)
        optimiser.step()
        schedule.step()
    with torch.no_grad():
        _, mutual = _match(batch, steer_both, vector, config)
        return [_solution(batch, k, vector[k], mutual[k]) for k in range(len(vector))]


def _prepare_steering_both_ways(batch: Batch, model: Model) -> SteerBoth:
    """Return a function that steers a's poses into b, and by the inverse b's into a, at once."""
    shape_a, shape_b = batch.pose_a.shape, batch.pose_b.shape
    pose = torch.cat([batch.pose_a.flatten(0, 2), batch.pose_b.flatten(0, 2)])  # (M, N, 2)
    seen = torch.cat([batch.seen_a.flatten(0, 2), batch.seen_b.flatten(0, 2)])  # (M, N)
    normalised, _, _ = normalise(pose, seen)
    steer = prepare_steering(model, normalised, seen)
    bodies_a = shape_a[:3].numel()

    def steer_both(vector: Tensor) -> tuple[Tensor, Tensor]:
        """Steer by rotation vectors `[B, 3]` of b_from_a."""
        b_from_a = vector[:, None, None].expand(*shape_a[:3], 3).flatten(0, 2)  # (B F I, 3)
        a_from_b = -vector[:, None, None].expand(*shape_b[:3], 3).flatten(0, 2)  # (B F J, 3)
        steered = steer(torch.cat([b_from_a, a_from_b]))  # (M, N, 2)
        return steered[:bodies_a].view(shape_a), steered[bodies_a:].view(shape_b)

    return steer_both


def _match(
    batch: Batch, steer_both: SteerBoth, vector: Tensor, config: PaperConfig
) -> tuple[Tensor, Tensor]:
    """Return L_match `[B]` and the mutual matches `[B, F, I, J]` (bool) of rotations `[B, 3]`.

    The loss is the mean over the possible matches and both directions.
    """
    score = _similarity_both_ways(batch, steer_both, vector, config)  # (2, B, F, I, J)
    present_a, present_b = batch.present_a, batch.present_b
    weight = sinkhorn(
        with_dummies(score, present_a, present_b),
        sharpness=config.sharpness,
        sweeps=config.sweeps,
    )  # (2, B, F, S, S)
    losses = matching_loss(weight, score, present_a, present_b)  # (2, B, F)
    loss = losses.sum((0, 2)) / (2 * batch.most_matches.clamp_min(1))
    best_of_row = weight == weight.amax(-1, keepdim=True)
    best_of_column = weight == weight.amax(-2, keepdim=True)
    rows, columns = score.shape[-2:]
    mutual = (best_of_row & best_of_column).all(0)[..., :rows, :columns]
    return loss, mutual & possible_matches(present_a, present_b)


def _similarity_both_ways(
    batch: Batch, steer_both: SteerBoth, vector: Tensor, config: PaperConfig
) -> Tensor:
    """Return the similarities `[2, B, F, I, J]` in view b and in view a."""
    in_b, in_a = steer_both(vector)
    distance_in_b = keypoint_distance(in_b, batch.pose_b, batch.seen_b)  # (B, F, I, J)
    distance_in_a = keypoint_distance(in_a, batch.pose_a, batch.seen_a)  # (B, F, J, I)
    distances = torch.stack([distance_in_b, distance_in_a.transpose(-1, -2)])
    return similarity(distances, alpha=config.alpha)


def _geometric_term(batch: Batch, vector: Tensor, mutual: Tensor, config: PaperConfig) -> Tensor:
    """Return L_geom `[B]` of the mutual matches, 0 where they are too few.

    Views with one body in all can have but one match.
    """
    needed = batch.most_matches.clamp(1, config.mutual)
    rays_a, rays_b, weight = _matched_rays(batch, mutual)
    loss_of = full_geometric_loss if config.full_system else geometric_loss
    loss = loss_of(matrix_from_vector(vector), rays_a, rays_b, weight)
    return torch.where(mutual.sum((1, 2, 3)) >= needed, loss, torch.zeros_like(loss))


def _matched_rays(batch: Batch, mutual: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the rays `[B, P, 3]` of all joints of all possible matches, and their weight `[B, P]`.

    The weight is 1 for the joints of mutual matches, else 0.
    """
    seen_a, seen_b = batch.seen_a[:, :, :, None], batch.seen_b[:, :, None]
    weight = mutual[..., None] & seen_a & seen_b  # (B, F, I, J, N)
    rays_a = batch.ray_a[:, :, :, None].expand(*weight.shape, 3)
    rays_b = batch.ray_b[:, :, None].expand(*weight.shape, 3)
    return rays_a.flatten(1, 4), rays_b.flatten(1, 4), weight.flatten(1).to(rays_a.dtype)


def _solution(batch: Batch, k: int, vector: Tensor, mutual: Tensor) -> PaperSolution:
    """Return translation, cheirality and reprojection error of problem k, in double precision."""
    rays_a, rays_b, weight = (
        part[0].double() for part in _matched_rays(batch.select([k]), mutual[None])
    )
    rays_a, rays_b = rays_a[weight > 0], rays_b[weight > 0]  # (P, 3)
    rotation = matrix_from_vector(vector.double())
    translation = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    error = float("inf")
    if len(rays_a) >= LEAST_JOINTS:
        weight = torch.ones(len(rays_a)).double()
        translation, _ = translation_direction(rotation, rays_a, rays_b, weight)
        errors = reprojection_error(rotation, translation, rays_a, rays_b)
        error_px = errors * batch.focal[k].item()
        error = error_px.clamp_max(_FAR_PX).mean().item()
    matches = torch.nonzero(mutual).numpy().astype(np.int64)
    return PaperSolution(
        rotation=rotation.numpy(),
        translation=translation.numpy(),
        matches=matches,
        error=error,
        tries=1,
    )


def reprojection_error(
    rotation: Tensor, translation: Tensor, rays_a: Tensor, rays_b: Tensor
) -> Tensor:
    """Return the reprojection error `[N]` in normalised image units, the mean of both views.

    The points are triangulated at the midpoints of the rays; infinite behind a camera. rotation:
    `[3, 3]` and translation: `[3]` of b_from_a; rays: `[N, 3]` of unit length.
    """
    depth_a, depth_b = depths(rotation, translation, rays_a, rays_b)
    from_a = depth_a[:, None] * rays_a
    from_b = (depth_b[:, None] * rays_b - translation) @ rotation
    point_in_a = (from_a + from_b) / 2
    point_in_b = point_in_a @ rotation.T + translation
    in_front = (point_in_a[:, 2] > 1e-9) & (point_in_b[:, 2] > 1e-9)
    errors = (_image_distance(point_in_a, rays_a) + _image_distance(point_in_b, rays_b)) / 2
    return torch.where(in_front, errors, torch.full_like(errors, torch.inf))


def _image_distance(point: Tensor, ray: Tensor) -> Tensor:
    """Return the distance `[N]` of points `[N, 3]` from rays `[N, 3]` in the normalised image."""
    projected = point[:, :2] / point[:, 2:].clamp_min(1e-9)
    seen = ray[:, :2] / ray[:, 2:]
    return (projected - seen).norm(dim=-1)


@dataclass(frozen=True)
class PaperPairs:
    """A `solve.PairSolver`: gradient descent through a network from random rotations.

    vocabulary: `[keypoint]` index of each keypoint in the model's joints, -1 = none.
    focal: `[view]` pixels.
    """

    model: Model
    vocabulary: Ints
    focal: Floats
    pairwise: PairwiseConfig
    config: PaperConfig

    def __call__(self, problem: PairProblem) -> PairwiseCalibration | None:
        """Return the relative pose that the descent ends in, or None where nothing is matched."""
        if problem.shared_frames == 0:
            return None
        frames = evenly_spaced(np.arange(len(problem.pair.frames)), self.config.frames)
        generator = torch.Generator().manual_seed(int(problem.rng.integers(2**62)))
        with torch_threads(1):
            found = solve_pair(self._two_views(problem, frames), self.model, self.config, generator)
        frame, instances = found.matches[:, 0], found.matches[:, 1:]
        return judge_pair(
            problem,
            rotation=found.rotation,
            translation=found.translation,
            matches=np.column_stack([frames[frame], instances]),
            source="paper",
            config=self.pairwise,
        )

    def _two_views(self, problem: PairProblem, frames: Ints) -> TwoViews:
        """Return the rays of both views in the joints of the model, in some of the frames."""
        pair, joints = problem.pair, self.model.config.joints
        rays_a = rays_by_joint(pair.a.rays_or_nan[frames], self.vocabulary, joints)
        rays_b = rays_by_joint(pair.b.rays_or_nan[frames], self.vocabulary, joints)
        return TwoViews(rays_a, rays_b, mean_focal(problem, self.focal))
