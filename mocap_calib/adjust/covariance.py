"""The covariance of what was adjusted, and of the poses of a rig.

Errors of detections are not independent: those of one period are correlated, and those of one
joint. The inverse of the Hessian, which ignores that, is 1.5 to 10 times too small. The sandwich
B M B holds: B is the inverse of the reduced camera system, and M the scatter of the gradient by
clusters of correlated errors (Cameron, Gelbach and Miller 2011: "Robust Inference With Multiway
Clustering").

The system of an adjustment keeps the robust weights fixed. The cost itself is less curved: a rig
errs 1.2 times as far as that system says (Huber 1981: "Robust Statistics", section 7.6).

Position, orientation and size of a rig in the world mean nothing: what counts is how far its
cameras are from where they should be after the best similarity between the two. So no camera is
the fixed one, and all have a share of the uncertainty.

The covariance is of first order. Rigs that are barely determined are less linear: rigs adjusted to
parts of the recording differ more than first order predicts, and the covariance grows with that
(the delete-a-group jackknife; Shao and Wu 1989: "A General Theory for Jackknife Variance
Estimation").
"""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.adjust.problem import Problem, choose_problem, free_poses, solve
from mocap_calib.adjust.residuals import Block, Residuals, State
from mocap_calib.adjust.solve import Parameters, eliminate_points, optimise_points
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import AdjustConfig, Config
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.rotation import project_out_similarity, rig_change, rig_size
from mocap_calib.results import Matches, RigCovariance
from mocap_calib.types import POSE, CameraRig, Floats, Ints, Sample

_LEAST_CURVATURE = 0.25  # share of that with fixed weights; measured 0.6 to 0.76


@dataclass(frozen=True)
class Covariance:
    """The covariance of the free parameters of an adjustment, `[free, free]`.

    independent: where all detections err independently, the inverse of the reduced system.
    by_time, by_joint: by errors that the detections of a period, or of a joint, have in common.
    once: share (0.5..1) of the sum of both that is not counted twice: what detections of one period
        and one joint have in common is in both. Where there is nothing else, the sum is twice the
        covariance.
    """

    independent: Floats
    by_time: Floats
    by_joint: Floats
    once: float

    @property
    def cautious(self) -> Floats:
        """The covariance with a margin, for what no camera shall be accused of by mistake.

        Errors that one period and one joint have in common count twice.
        """
        return self.by_time + self.by_joint


def find_covariance(
    problem: Problem, state: State, seen: Residuals, parameters: Parameters, config: Config
) -> Covariance:
    """Return the covariance of the free parameters at a minimum, at the size that the rig has.

    problem: of which the state is the minimum; its points are in clusters, of one period or joint.

    Cauchy's loss w s^2 log(1 + r'r / s^2) of a residual r, of two coordinates, has the curvature
    u (I - 2 u r r' / (w s^2)) where its weight is u = w / (1 + r'r / s^2). Residuals lie in the
    directions in which their points cannot follow, which are less than two of each.
    """
    system, scores, curvature = gather_information(state, seen, parameters, problem.loss_scale)
    inverse = _inverse_at_size(curvature * system, state, parameters)
    period = problem.tracks.time_blocks(config.uncertainty.time_blocks)
    joint = problem.tracks.keypoint
    time, joints = (scatter_of(scores, cluster) for cluster in (period, joint))
    both = scatter_of(scores, period * (joint.max(initial=0) + 1) + joint)
    # in standard deviations of independent errors, so that all directions count alike
    twice = float(np.trace(inverse @ both) / max(np.trace(inverse @ (time + joints)), 1e-300))
    return Covariance(
        independent=inverse,
        by_time=inverse @ time @ inverse,
        by_joint=inverse @ joints @ inverse,
        once=min(1.0, max(1 - twice, twice)),  # the whole is not less than what is in both
    )


def gather_information(
    state: State, seen: Residuals, parameters: Parameters, scale: float
) -> tuple[Floats, Floats, float]:
    """Return the reduced camera system `[free, free]` of all points and the prior.

    And `[free, N]` what the detections of each point add to its gradient, and the curvature of the
    cost, as a share of that with fixed weights. scale: of the loss.
    """
    work = map_in_threads(
        lambda block: _information_of(block, state, parameters, scale), seen.blocks
    )
    systems, scores, sums = zip(*work, strict=True)
    stiffness, _ = parameters.prior(state.intrinsics)
    prior = parameters.basis.T @ (stiffness.reshape(-1, 1) * parameters.basis)
    stiff, excess = np.sum(sums, axis=0)
    seen_by = (seen.weight > 0).sum(0)
    directions = 1 - 3 * (seen_by > 0).sum() / (2 * max(seen_by.sum(), 1))  # of two, per residual
    curvature = 1 - excess / max(directions * stiff, 1e-300)
    return (
        np.sum(systems, axis=0) + prior,
        np.concatenate(scores, axis=1),
        max(float(curvature), _LEAST_CURVATURE),
    )


def _information_of(
    block: Block, state: State, parameters: Parameters, scale: float
) -> tuple[Floats, Floats, tuple[float, float]]:
    """Return the information of a block of points, and the sums of u and of u^2 r'r / (w s^2)."""
    basis = parameters.by_view[block.views].reshape(-1, parameters.basis.shape[1])
    found = eliminate_points(block, state, scale, steps=0)
    residual = found.linear.residual
    scores = np.einsum("vckn,vkn->vcn", found.camera, residual).reshape(len(basis), -1)
    scores -= np.einsum("cjn,jn->cn", found.product, found.side)
    weight = block.seen.weight
    # residuals are weighted by u: this is u r'r / (w s^2), and u / w is 1 less it
    square = (residual**2).sum(1) / np.where(weight > 0, weight, 1.0) / scale**2
    robust = weight * (1 - square)
    sums = float(robust.sum()), float((robust * square).sum())
    return basis.T @ found.matrix @ basis, basis.T @ scores, sums


def scatter_of(scores: Floats, cluster: Ints) -> Floats:
    """Return the scatter `[free, free]` of the sums of scores over clusters.

    scores: `[free, N]`; cluster: `[N]`.
    """
    _, number = np.unique(cluster, return_inverse=True)
    count = int(number.max(initial=-1)) + 1
    sums = np.stack([np.bincount(number, row, minlength=count) for row in scores])
    return np.asarray(sums @ sums.T * (count / max(count - 1, 1)), dtype=np.float64)


def _inverse_at_size(matrix: Floats, state: State, parameters: Parameters) -> Floats:
    """Return the inverse of a reduced camera system `[free, free]`, the size of the rig held."""
    stiffness = np.diag(matrix)
    scale = 1 / np.sqrt(np.maximum(stiffness, 1e-15 * stiffness.max()))  # rounding may go below
    size = scale * size_direction(state, parameters)
    size /= np.linalg.norm(size)
    held = np.eye(len(size)) - np.outer(size, size)  # of all that leaves the size as it is
    values, vectors = np.linalg.eigh(held @ (scale[:, None] * matrix * scale) @ held)
    # what nothing determines is as uncertain as numbers allow, not certain
    vectors = held @ vectors
    inverse = (vectors / np.maximum(values, 1e-13 * values.max())) @ vectors.T
    return scale[:, None] * inverse * scale


def size_direction(state: State, parameters: Parameters) -> Floats:
    """Return how the free parameters `[free]` change as the rig grows.

    All cameras move away from the first: C -> C0 + s (C - C0).
    """
    first = -state.rotation[0].T @ state.translation[0]
    moves = np.zeros(parameters.by_view.shape[:2])
    moves[:, 3:POSE] = state.translation + state.rotation @ first  # 0 of the first
    return np.asarray(parameters.basis.T @ moves.ravel())


# --- the poses of a rig


def fit_again(sample: Sample, rig: CameraRig, matches: Matches, config: Config) -> Problem:
    """Return the problem of a rig adjusted again, to as many points as its covariance needs.

    Raises as `choose_problem` does.
    """
    # correlated detections determine no more by being many
    problem = choose_problem(sample, rig, matches, config, points=config.uncertainty.points)
    state = _solve_again(problem, config.adjust)
    return problem.at(optimise_points(state, problem.rays, loss_scale=problem.loss_scale))


def _solve_again(problem: Problem, config: AdjustConfig) -> State:
    """Return the state at the minimum that it is close to; its points have yet to be optimised."""
    poses = free_poses(len(problem.rig))
    last = problem.loss_scale
    return solve(problem.start(), problem.rays, poses, config, last=last, already_close=True)


def rig_covariance(
    sample: Sample, rig: CameraRig, matches: Matches, config: Config
) -> RigCovariance:
    """Return the covariance of an adjusted rig.

    Intrinsics count as known. Everything is as uncertain as can be where the matched detections do
    not constrain the rig.
    """
    try:
        fitted = fit_again(sample, rig, matches, config)
    except DegenerateError:
        return RigCovariance.unknown(len(rig.cameras), rig_size(rig))
    return covariance_of(fitted, config)


def covariance_of(fitted: Problem, config: Config) -> RigCovariance:
    """Return the covariance of a rig; see `rig_covariance`."""
    rig, found = fitted.rig, first_order(fitted, config)
    time, joints = (_of_poses(part, rig) for part in (found.by_time, found.by_joint))
    of_time, of_joints = _turn_variance(time), _turn_variance(joints)
    # Rigs without a part differ by `bend` times the first-order prediction; the covariance grows by
    # bend^4: what parts of the errors do beyond first order, all of them together do once more.
    usual = config.uncertainty.usual_bend
    bend = np.sqrt(variance_of_parts(fitted, config) / max(of_time, 1e-30))
    frames, matched = distinct_frames(fitted), np.unique(fitted.tracks.frame)
    if frames == 1:  # it has no parts
        bend = usual
    elif len(matched) >= config.uncertainty.time_blocks:  # chance alone makes it as large
        bend /= usual
    degrees = _degrees_of_freedom(fitted, of_time, of_joints, config)
    # a single frame does not show what all its joints have in common: it counts twice
    scale = max(1.0, bend) ** 4 * (1 + 1 / frames) * hotelling_factor(degrees)
    matrix = found.once * scale * (time.matrix + joints.matrix)
    with np.errstate(invalid="ignore"):  # where nothing is determined, rounding goes below 0
        covariance = replace(time, matrix=matrix)
        known = np.isfinite(bend) and covariance.rotation_sigma.max() < np.pi
        if not (known and np.isfinite(covariance.centre_sigma).all()):
            covariance = RigCovariance.unknown(len(rig), rig_size(rig))
    return covariance


def distinct_frames(problem: Problem) -> int:
    """Return in how many frames the points of a problem are in other places.

    A frame counts where half of the keypoints are farther from where they were seen in the last one
    that does than noise makes 5 % of them: frames of a subject at rest share their errors.
    """
    tracks, keypoints = problem.tracks, problem.tracks.keypoint.max() + 1
    focal = np.array([camera.focal for camera in problem.rig.cameras])
    pixels = np.where(tracks.used[:, None], tracks.pixels, np.nan)
    frames, frame = np.unique(tracks.frame, return_inverse=True)
    point = tracks.individual * keypoints + tracks.keypoint
    place = np.full((len(frames), point.max() + 1, len(focal), 2), np.nan)
    place[frame, point] = np.moveaxis(pixels / (problem.noise * focal)[:, None, None], -1, 0)
    last, count = place[0], 1
    for now in place[1:]:
        apart = ((now - last) ** 2).sum(-1) / 2  # of two detections
        known = apart[np.isfinite(apart)]
        if not len(known) or np.median(known) > -2 * np.log(0.05):
            last, count = now, count + 1
    return count


def cautious_covariances(fitted: Problem, config: Config) -> tuple[RigCovariance, RigCovariance]:
    """Return the covariance of first order with a margin, and that of independent errors.

    The second is too small, but has the shape that the images give it.
    """
    found = first_order(fitted, config)
    return _of_poses(found.cautious, fitted.rig), _of_poses(found.independent, fitted.rig)


def first_order(fitted: Problem, config: Config) -> Covariance:
    """Return the covariance of first order of the poses of all cameras but the first."""
    poses = free_poses(len(fitted.rig))
    return find_covariance(fitted, fitted.start(), fitted.rays, poses, config)


def _degrees_of_freedom(fitted: Problem, of_time: float, of_joints: float, config: Config) -> float:
    """Return the degrees of freedom of a covariance estimated from few clusters.

    Of G clusters G - 1 (Satterthwaite 1946, of the sum of two such variances).
    """
    tracks = fitted.tracks
    periods, joints = (
        max(len(np.unique(cluster)) - 1, 1)
        for cluster in (tracks.time_blocks(config.uncertainty.time_blocks), tracks.keypoint)
    )
    spread = of_time**2 / periods + of_joints**2 / joints
    degrees = (of_time + of_joints) ** 2 / max(spread, 1e-300)
    return max(degrees, POSE)  # those of a pose


def hotelling_factor(degrees: float) -> float:
    """Return by how much a covariance must grow for its 95 % regions to hold 95 %.

    Regions of three numbers. degrees: of freedom of the covariance. Its own error makes the squared
    distances those of Hotelling's T^2, whose density is summed here: to import scipy for it takes
    longer than all else that an adjustment imports.
    """
    distance = np.geomspace(1e-3, 1e4, 20_000)
    mass = np.exp(3 * np.log(distance) - (degrees + 1) / 2 * np.log1p(distance**2 / degrees))
    share = mass.cumsum() - mass / 2
    of_normal = 7.8147  # 95 % of the squared lengths of three normal numbers
    return float(np.interp(0.95, share / mass.sum(), distance) ** 2 / of_normal)


def _turn_variance(covariance: RigCovariance) -> float:
    """Return the sum of the variances of all turns, in square radians."""
    return float(np.einsum("vivi->", covariance.matrix[:, :3, :, :3]))


def _of_poses(matrix: Floats, rig: CameraRig) -> RigCovariance:
    """Return the covariance of a rig from that of the poses of all cameras but the first.

    The poses are turns w and translations d in the frames of the cameras: R <- exp(w) R and
    t <- exp(w) t + d move the centre by -R' d.
    """
    views, size = len(rig.cameras), rig_size(rig)
    basis = free_poses(views).basis
    poses = (basis @ matrix @ basis.T).reshape(views, POSE, views, POSE)
    to_world = np.zeros((views, POSE, POSE))
    to_world[:, :3, :3] = np.swapaxes(rig.rotation, 1, 2)
    to_world[:, 3:, 3:] = -np.swapaxes(rig.rotation, 1, 2) / size
    turned = np.einsum("vij,vjwk,wlk->viwl", to_world, poses, to_world)
    half = project_out_similarity(turned.reshape(views, POSE, -1), rig)
    whole = project_out_similarity(
        half.reshape(POSE * views, POSE * views).T.reshape(views, POSE, -1), rig
    )
    return RigCovariance(matrix=whole.reshape(views, POSE, views, POSE), size=size)


# --- rigs of parts of the recording


def variance_of_parts(fitted: Problem, config: Config) -> float:
    """Return the variance of all turns (square radians) by rigs without a fifth of each link.

    By the jackknife; 0 of a single frame.
    """
    tracks = fitted.tracks
    frames = len(np.unique(tracks.frame))
    if frames == 1:
        return 0.0
    part = tracks.link_blocks(min(config.uncertainty.parts, frames))

    def without(number: int) -> Floats:
        """Return the turns of the cameras without a part."""
        some = fitted.select(np.flatnonzero(part != number))
        return rig_change(fitted.rig, some.at(_solve_again(some, config.adjust)).rig)[:, :3]

    return jackknife(np.stack([*map_in_threads(without, range(int(part.max()) + 1))]))


def jackknife(turns: Floats) -> float:
    """Return the variance of all turns together, in square radians, by rigs without a part each.

    turns: `[part, view, 3]`.
    """
    count = len(turns)
    return (count - 1) / count * float(((turns - turns.mean(0)) ** 2).sum())
