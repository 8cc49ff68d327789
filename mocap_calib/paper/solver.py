"""The paper's solver: rotation and matches of two views by gradient descent through SteerPose.

Lee et al., BMVC 2025, section 3.2 and appendix C.3: Adam from a random rotation on
L_match + lambda L_geom, up to five tries until the 3D poses reproject within 10 pixels. A measured
reference; `pairs.solve` is the program's own. Pairs of views and tries run in one batch.
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from mocap_calib.config import LEAST_JOINTS, PairwiseConfig
from mocap_calib.geometry.epipolar import depths
from mocap_calib.lift.lift import rays_by_joint
from mocap_calib.pairs.solve import judge_pair, mean_focal
from mocap_calib.pairs.view_pair import ViewPair
from mocap_calib.paper.losses import (
    Batch,
    TwoViews,
    geometric_loss,
    keypoint_distance,
    matching_loss,
    similarity,
    sinkhorn,
    stack_problems,
    with_dummies,
)
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import PairwiseCalibration
from mocap_calib.training import torch_threads
from mocap_calib.training.model import Model, matrix_from_vector, normalise, prepare_steering
from mocap_calib.types import Floats, Ints

_FAR_PX = 100.0  # a joint reprojected farther away, or behind a camera, counts as this


# Rotation vectors [B, 3] to the steered poses [B, F, I, N, 2] and [B, F, J, N, 2].
SteerBoth = Callable[[Tensor], tuple[Tensor, Tensor]]
GeometricLoss = Callable[[Tensor, Tensor, Tensor, Tensor], Tensor]


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
    # L_geom `[B]` of rotations, rays and weights; the paper does not eliminate the points
    geometric_loss: GeometricLoss = geometric_loss
    geometric_from: float = 0.4  # share of the iterations before L_geom is active
    mutual: int = 2  # matches, mutual in both directions, before L_geom is active
    tries: int = 5
    success_px: float = 10.0


@dataclass(frozen=True)
class PaperSolution:
    """What the solver found of one pair of views.

    rotation: `[3, 3]` of b_from_a.
    translation: `[3]` of b_from_a, a direction.
    matches: `[match, 3]` rows (frame, i, j).
    error: mean reprojection error in pixels, infinite without a match.
    """

    rotation: Floats
    translation: Floats
    matches: Ints
    error: float


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
    square = with_dummies(score, batch.possible)
    weight = sinkhorn(square, sharpness=config.sharpness, sweeps=config.sweeps)  # (2, B, F, S, S)
    losses = matching_loss(weight, score, batch.possible)  # (2, B, F)
    loss = losses.sum((0, 2)) / (2 * batch.most_matches.clamp_min(1))
    best_of_row = weight == weight.amax(-1, keepdim=True)
    best_of_column = weight == weight.amax(-2, keepdim=True)
    rows, columns = score.shape[-2:]
    mutual = (best_of_row & best_of_column).all(0)[..., :rows, :columns]
    return loss, mutual & batch.possible


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
    loss = config.geometric_loss(matrix_from_vector(vector), rays_a, rays_b, weight)
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
    """Return translation and reprojection error of problem k, in double precision."""
    all_a, all_b, weight = (part[0] for part in _matched_rays(batch.select([k]), mutual[None]))
    rays_a, rays_b = (rays[weight > 0].double().numpy() for rays in (all_a, all_b))  # [P, 3]
    rotation = matrix_from_vector(vector.double()).numpy()
    translation, error = np.array([0.0, 0.0, 1.0]), np.inf
    if len(rays_a) >= LEAST_JOINTS:
        translation = translation_direction(rotation, rays_a, rays_b)
        error_px = batch.focal[k].item() * _reprojection_error(
            rotation, translation, rays_a, rays_b
        )
        error = float(np.minimum(error_px, _FAR_PX).mean())
    matches = torch.nonzero(mutual).numpy().astype(np.int64)
    return PaperSolution(rotation, translation, matches, error)


def translation_direction(rotation: Floats, rays_a: Floats, rays_b: Floats) -> Floats:
    """Return the unit translation `[3]` of b_from_a that best fits a rotation and matches.

    The singular vector of the rows n = (R u_a) x u_b; its sign puts more points in front of both
    cameras than behind both. rotation: `[3, 3]`; rays: `[N, 3]` of unit length.
    """
    direction = np.linalg.svd(np.cross(rays_a @ rotation.T, rays_b))[2][-1]
    depth_a, depth_b = depths(rotation, direction, rays_a, rays_b)
    in_front, behind = (depth_a > 0) & (depth_b > 0), (depth_a < 0) & (depth_b < 0)
    return -direction if behind.sum() > in_front.sum() else direction


def _reprojection_error(
    rotation: Floats, translation: Floats, rays_a: Floats, rays_b: Floats
) -> Floats:
    """Return the reprojection error `[N]` in normalised image units, the mean of both views.

    The points are triangulated at the midpoints of the rays; infinite behind a camera. rotation:
    `[3, 3]` and translation: `[3]` of b_from_a; rays: `[N, 3]` of unit length.
    """
    depth_a, depth_b = depths(rotation, translation, rays_a, rays_b)
    from_b = (depth_b[:, None] * rays_b - translation) @ rotation
    point_in_a = (depth_a[:, None] * rays_a + from_b) / 2
    points = (point_in_a, point_in_a @ rotation.T + translation)
    in_front = np.all([point[:, 2] > 1e-9 for point in points], axis=0)
    errors = [
        np.linalg.norm(
            point[:, :2] / np.maximum(point[:, 2:], 1e-9) - rays[:, :2] / rays[:, 2:], axis=-1
        )
        for point, rays in zip(points, (rays_a, rays_b), strict=True)
    ]
    return np.where(in_front, np.mean(errors, axis=0), np.inf)


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

    def __call__(self, pair: ViewPair) -> PairwiseCalibration | None:
        """Return the relative pose that the descent ends in, or None where nothing is matched."""
        if pair.shared_frames == 0:
            return None
        frames = evenly_spaced(np.arange(len(pair.frames)), self.config.frames)
        generator = torch.Generator().manual_seed(int(pair.rng.integers(2**62)))
        with torch_threads(1):
            found = solve_pair(self._two_views(pair, frames), self.model, self.config, generator)
        frame, instances = found.matches[:, 0], found.matches[:, 1:]
        return judge_pair(
            pair,
            rotation=found.rotation,
            translation=found.translation,
            matches=np.column_stack([frames[frame], instances]),
            source="paper",
            config=self.pairwise,
        )

    def _two_views(self, pair: ViewPair, frames: Ints) -> TwoViews:
        """Return the rays of both views in the joints of the model, in some of the frames."""
        joints = self.model.config.joints
        rays_a = rays_by_joint(pair.a.rays_or_nan[frames], self.vocabulary, joints)
        rays_b = rays_by_joint(pair.b.rays_or_nan[frames], self.vocabulary, joints)
        return TwoViews(rays_a, rays_b, mean_focal(pair, self.focal))
