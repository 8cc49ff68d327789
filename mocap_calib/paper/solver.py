"""The paper's solver: rotation and matches of two views by gradient descent through SteerPose.

Lee et al., BMVC 2025, section 3.2 and appendix C.3: Adam from a random rotation on
L_match + lambda L_geom (similarity, differentiable matching, geometric consistency), up to five
tries until the 3D poses reproject within 10 pixels. A measured reference; `pairs.solve` is the
program's own. Pairs of views and tries run in one batch.
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from mocap_calib.config import LEAST_FORWARD, LEAST_JOINTS
from mocap_calib.geometry.epipolar import depths
from mocap_calib.lift import rays_by_joint
from mocap_calib.pairs.view_pair import ViewPair
from mocap_calib.paper.five_point import Found
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.training import torch_threads
from mocap_calib.training.model import Model, matrix_from_vector, normalise, prepare_steering
from mocap_calib.types import Floats, Ints

_EPSILON = 1e-12


@dataclass(frozen=True)
class TwoViews:
    """The detections of views a and b in the joints of the model.

    rays_a, rays_b: `[frame, I | J, joint, 3]` unit rays, NaN = missing. focal: mean focal length of
    both cameras in pixels.
    """

    rays_a: Floats
    rays_b: Floats
    focal: float


@dataclass(frozen=True)
class Batch:
    """Problems side by side: B problems, F frames, I and J instances, N joints.

    pose: `[B, F, I, N, 2]` normalised image points and ray: `[B, F, I, N, 3]` unit rays, 0 where
    not seen. seen: `[B, F, I, N]` bool. focal: `[B]` pixels.
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
    parts = {}
    for side in ("a", "b"):
        ray = np.stack([getattr(problem, f"rays_{side}") for problem in problems])
        seen = np.nan_to_num(ray[..., 2:]) > LEAST_FORWARD
        pose = ray[..., :2] / np.where(seen, ray[..., 2:], 1.0)
        parts[f"seen_{side}"] = torch.from_numpy(seen[..., 0])
        parts[f"pose_{side}"] = torch.from_numpy(np.where(seen, pose, 0.0)).float()
        parts[f"ray_{side}"] = torch.from_numpy(np.where(seen, ray, 0.0)).float()
    return Batch(focal=torch.tensor([problem.focal for problem in problems]), **parts)


def similarity(displacement: Tensor, *, alpha: float) -> Tensor:
    """Return s = 2 / (1 + exp(alpha L_kp)) `[...]` of L_kp `[...]`, section 3.2: 1 of one pose."""
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


# --- the descent

# Rotation vectors [B, 3] to the steered poses [B, F, I, N, 2] and [B, F, J, N, 2].
SteerBoth = Callable[[Tensor], tuple[Tensor, Tensor]]


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
    geometric_loss: Callable[[Tensor, Tensor, Tensor, Tensor], Tensor] = geometric_loss
    geometric_from: float = 0.4  # share of the iterations before L_geom is active
    mutual: int = 2  # matches, mutual in both directions, before L_geom is active
    tries: int = 5
    success_px: float = 10.0


@dataclass(frozen=True)
class PaperSolution:
    """What the solver found of one pair of views.

    rotation: `[3, 3]` and translation: `[3]`, a direction, of b_from_a. matches: `[match, 3]` rows
    (frame, i, j). error: mean reprojection error in pixels, infinite without a match.
    """

    rotation: Floats
    translation: Floats
    matches: Ints
    error: float


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
    for number in range(config.tries):
        unsolved = [
            k for k in range(len(problems)) if k not in best or best[k].error >= config.success_px
        ]
        if not unsolved:
            break
        if number > 0 or start is None:
            start = random_rotations(len(unsolved), generator)
        found = _descend(batch.select(unsolved), model, start, config)
        for k, solution in zip(unsolved, found, strict=True):
            best[k] = min(best.get(k, solution), solution, key=lambda each: each.error)
    return [best[k] for k in sorted(best)]


def random_rotations(count: int, generator: torch.Generator) -> Tensor:
    """Return rotation vectors `[count, 3]`, uniform over all: of random quaternions (Shoemake)."""
    quaternions = torch.randn(count, 4, generator=generator).numpy()
    return torch.from_numpy(Rotation.from_quat(quaternions).as_rotvec()).float()


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
        return [_solution(batch, k, vector[k], mutual[k], config) for k in range(len(vector))]


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
    in_b, in_a = steer_both(vector)
    distance_in_b = keypoint_distance(in_b, batch.pose_b, batch.seen_b)  # (B, F, I, J)
    distance_in_a = keypoint_distance(in_a, batch.pose_a, batch.seen_a)  # (B, F, J, I)
    distances = torch.stack([distance_in_b, distance_in_a.transpose(-1, -2)])
    score = similarity(distances, alpha=config.alpha)  # (2, B, F, I, J)
    square = with_dummies(score, batch.possible)
    weight = sinkhorn(square, sharpness=config.sharpness, sweeps=config.sweeps)  # (2, B, F, S, S)
    losses = matching_loss(weight, score, batch.possible)  # (2, B, F)
    loss = losses.sum((0, 2)) / (2 * batch.most_matches.clamp_min(1))
    best_of_row = weight == weight.amax(-1, keepdim=True)
    best_of_column = weight == weight.amax(-2, keepdim=True)
    rows, columns = score.shape[-2:]
    mutual = (best_of_row & best_of_column).all(0)[..., :rows, :columns]
    return loss, mutual & batch.possible


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


def _solution(
    batch: Batch, k: int, vector: Tensor, mutual: Tensor, config: PaperConfig
) -> PaperSolution:
    """Return translation and reprojection error of problem k, in double precision.

    A joint reprojected farther than ten times `config.success_px` counts as this.
    """
    all_a, all_b, weight = (part[0] for part in _matched_rays(batch.select([k]), mutual[None]))
    rays_a, rays_b = (rays[weight > 0].double().numpy() for rays in (all_a, all_b))  # [P, 3]
    rotation = matrix_from_vector(vector.double()).numpy()
    translation, error = np.array([0.0, 0.0, 1.0]), np.inf
    if len(rays_a) >= LEAST_JOINTS:
        translation = translation_direction(rotation, rays_a, rays_b)
        errors = _reprojection_errors(rotation, translation, rays_a, rays_b)
        errors_px = batch.focal[k].item() * errors
        error = float(np.minimum(errors_px, 10 * config.success_px).mean())
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


def _reprojection_errors(
    rotation: Floats, translation: Floats, rays_a: Floats, rays_b: Floats
) -> Floats:
    """Return the errors `[N]` in normalised image units, the mean of both views.

    Points are triangulated at the midpoints of the rays; infinite behind a camera. The arguments
    are those of `translation_direction`, and what it returns.
    """
    depth_a, depth_b = depths(rotation, translation, rays_a, rays_b)
    from_b = (depth_b[:, None] * rays_b - translation) @ rotation
    point_in_a = (depth_a[:, None] * rays_a + from_b) / 2
    points = point_in_a, point_in_a @ rotation.T + translation
    depth = [np.maximum(point[:, 2:], 1e-9) for point in points]
    errors = [
        np.linalg.norm(point[:, :2] / z - rays[:, :2] / rays[:, 2:], axis=-1)
        for point, z, rays in zip(points, depth, (rays_a, rays_b), strict=True)
    ]
    return np.where(np.minimum(*depth)[:, 0] > 1e-9, np.mean(errors, axis=0), np.inf)


def find_by_descent(
    pair: ViewPair,
    focal: float,
    *,
    model: Model,
    vocabulary: Ints,
    config: PaperConfig = PaperConfig(),
) -> Found:
    """Return the relative pose that the descent through a network from random rotations ends in.

    focal: of both views in pixels, the mean.
    vocabulary: `[keypoint]` index of each keypoint in the model's joints, -1 = none.
    """
    joints = model.config.joints
    frames = evenly_spaced(np.arange(len(pair.frames)), config.frames)
    rays_a, rays_b = (
        rays_by_joint(view.rays_or_nan[frames], vocabulary, joints) for view in (pair.a, pair.b)
    )
    generator = torch.Generator().manual_seed(int(pair.rng.integers(2**62)))
    with torch_threads(1):
        (found,) = solve_pairs([TwoViews(rays_a, rays_b, focal)], model, config, generator)
    matches = found.matches.copy()
    matches[:, 0] = frames[matches[:, 0]]
    return Found(found.rotation, found.translation, matches)
