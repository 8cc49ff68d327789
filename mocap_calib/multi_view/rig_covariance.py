"""How sure the places of the cameras are: the covariance of a rig that was adjusted.

Errors of detections go together, by the moment and by the joint (`covariance`). Where a rig stands
in the world, how it is turned and how large it is means nothing: what counts is how far its
cameras are from where they should be after the best similarity between the two. So no camera is
the fixed one, and all have a share of what is not known.

The covariance is of first order: it holds where a rig bends in proportion to what pulls at it.
Rigs that are hardly determined bend more. Adjusting again without a fifth of the moments, and to
halves of the joints, shows that (the delete-a-group jackknife; Shao and Wu 1989: "A General Theory
for Jackknife Variance Estimation").
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import Config
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.rotation import matrix_from_vector, skew, vector_from_matrix
from mocap_calib.multi_view.bundle_adjustment import (
    AdjustablePoints,
    choose_points,
    minimise_in_steps,
    observe_rays,
)
from mocap_calib.multi_view.covariance import find_covariance, find_curved_covariance
from mocap_calib.multi_view.freedom import Freedom, free_poses
from mocap_calib.multi_view.ray_residuals import RayObservations
from mocap_calib.multi_view.regions import widening
from mocap_calib.multi_view.residuals import State
from mocap_calib.multi_view.schur import settle_points
from mocap_calib.types import Bools, CameraRig, Floats, Ints, Matches, RigCovariance, Sample


@dataclass(frozen=True)
class FirstOrder:
    """How far errors move a rig in proportion.

    whole: the covariance by all errors, as wide as one must be that is estimated itself.
    of_time, of_joints: square radians by which all cameras together turn by errors that the
    detections of a moment, and those of a joint, have in common; those of single detections are
    part of both.
    """

    whole: RigCovariance
    of_time: float
    of_joints: float


@dataclass(frozen=True)
class FittedRig:
    """A rig adjusted to points of a sample."""

    rig: CameraRig
    points: AdjustablePoints
    seen: RayObservations
    state: State


def rig_covariance(
    sample: Sample, rig: CameraRig, matches: Matches, config: Config, *, seed: int
) -> RigCovariance:
    """Return the covariance of a rig that has been adjusted to what was matched.

    Intrinsics count as known. Everything is as uncertain as can be where the matched detections do
    not constrain the rig.
    """
    try:
        fitted = fit_again(sample, rig, matches, config)
    except DegenerateError:
        return RigCovariance.unknown(len(rig.cameras), rig_size(rig))
    return covariance_of(fitted, config, seed=seed)


def covariance_of(fitted: FittedRig, config: Config, *, seed: int) -> RigCovariance:
    """Return the covariance of a rig; see `rig_covariance`."""
    rig = fitted.rig
    first = first_order(fitted, config)
    bend = _bend(fitted, first, config, seed=seed) / config.uncertainty.usual_bend
    if not np.isfinite(bend):  # too little is left to leave a part of it out
        return RigCovariance.unknown(len(rig.cameras), rig_size(rig))
    # what parts of the errors do more than in proportion, all of them together do once more
    inflation = max(1.0, bend) ** 2
    # a single moment does not show what all joints of a moment share: it counts twice
    moments = 1 + 1 / len(np.unique(fitted.points.frame))
    found = replace(first.whole, matrix=first.whole.matrix * inflation**2 * moments)
    # no angle is larger; where nothing is determined a variance may be below 0 by rounding errors
    with np.errstate(invalid="ignore"):
        known = found.rotation_sigma.max() < np.pi
    return found if known else RigCovariance.unknown(len(rig.cameras), rig_size(rig))


def rig_change(before: CameraRig, after: CameraRig) -> Floats:
    """Return how cameras turn and shift from one rig to another, after the best similarity.

    `[view, 6]`: turns about the axes of the world of the first rig (3, radians), and shifts of the
    centres (3, in sizes of the rig). Both rigs have the same cameras; their first cameras are
    about the same, so that the worlds are.
    """
    turn = vector_from_matrix(np.swapaxes(before.rotation, 1, 2) @ after.rotation)
    scale = rig_size(before) / rig_size(after)
    offsets = [rig.centres - rig.centres.mean(0) for rig in (before, after)]
    shift = (scale * offsets[1] - offsets[0]) / rig_size(before)
    return project_out_similarity(np.concatenate([turn, shift], axis=1), before)


def changed_rig(rig: CameraRig, change: Floats) -> CameraRig:
    """Return a rig whose cameras were turned and shifted by changes `[view, 6]` of `rig_change`."""
    rotation = rig.rotation @ matrix_from_vector(change[:, :3])
    centres = rig.centres + rig_size(rig) * change[:, 3:]
    return rig.stand(rotation, centres)


def project_out_similarity(change: Floats, rig: CameraRig) -> Floats:
    """Return what is left of changes of cameras when the best similarity is taken out.

    change: `[view, 6, ...]` turns about the axes of the world (radians) and shifts of the centres,
        in sizes of the rig.
    """
    flat = change.reshape(6 * len(rig.cameras), -1)
    basis, _ = np.linalg.qr(gauge_of(rig).reshape(len(flat), 7))
    return np.asarray((flat - basis @ (basis.T @ flat)).reshape(change.shape))


def gauge_of(rig: CameraRig) -> Floats:
    """Return the changes `[view, 6, 7]` that similarities of the world make of all cameras.

    Turns about the axes of the world, shifts in sizes of the rig, as of `RigCovariance`.
    """
    offset = (rig.centres - rig.centres.mean(0)) / rig_size(rig)
    gauge = np.zeros((len(rig.cameras), 6, 7))
    gauge[:, :3, :3] = -np.eye(3)  # the world turns by phi: all cameras turn by -phi ...
    gauge[:, 3:, :3] = -skew(offset)  # ... and their centres go about its middle
    gauge[:, 3:, 3:6] = np.eye(3)
    gauge[:, 3:, 6] = offset
    return gauge


def rig_size(rig: CameraRig) -> float:
    """Return the RMS distance of the centres of a rig from their middle, in its unit."""
    offset = rig.centres - rig.centres.mean(0)
    return float(np.sqrt((offset**2).sum(1).mean()))


def fit_again(sample: Sample, rig: CameraRig, matches: Matches, config: Config) -> FittedRig:
    """Return a rig adjusted again, to as many points as its covariance needs.

    Raises as `bundle_adjustment.adjust` does.
    """
    # what detections say together is not said better by more of them
    fewer = replace(config, adjust=replace(config.adjust, points=config.uncertainty.points))
    points = choose_points(sample, rig, matches, fewer)
    seen = observe_rays(rig, points)
    start = State(rig.rotation, rig.translation, points.points, np.zeros((len(rig.cameras), 0)))
    state = _minimise(start, seen, points.loss_scale, config)
    state = settle_points(state, seen, loss_scale=points.loss_scale)
    adjusted = replace(rig, rotation=state.rotation, translation=state.translation)
    kept = np.flatnonzero(~_at_a_camera(adjusted, state.points, points.used, config))
    return FittedRig(
        rig=adjusted,
        points=points.select(kept),
        seen=seen.select(kept),
        state=replace(state, points=state.points[:, kept]),
    )


def _at_a_camera(rig: CameraRig, points: Floats, used: Bools, config: Config) -> Bools:
    """Return which points (`[3, N]`) are next to a camera that sees them (used: `[view, N]`).

    Nobody is there: rays of different things have met. The image of such a point changes so fast
    that its rounding errors outweigh all other points.
    """
    distance = np.linalg.norm(points - rig.centres[:, :, None], axis=1)  # [view, N]
    distance = np.where(used, distance, np.nan)
    usual = np.nanmedian(distance, axis=1, keepdims=True)
    return np.asarray((distance < config.uncertainty.least_distance * usual).any(0))


def _minimise(state: State, seen: RayObservations, loss_scale: float, config: Config) -> State:
    """Return the state at the minimum that it is close to, whose points have yet to settle."""
    freedom = free_poses(len(state.rotation))
    return minimise_in_steps(
        state, seen, freedom, config.adjust, loss_scale=loss_scale, already_close=True
    )


def first_order(fitted: FittedRig, config: Config) -> FirstOrder:
    """Return how far errors move a rig in proportion."""
    views, points = len(fitted.rig.cameras), fitted.points
    freedom = free_poses(views)
    clusters = points.time_blocks(config.uncertainty.time_blocks), points.keypoint
    found = find_curved_covariance(
        fitted.state,
        fitted.seen,
        freedom,
        clusters=clusters,
        loss_scale=points.loss_scale,
        least_curvature=config.uncertainty.least_curvature,
    )
    time, joints = (_of_poses(part, freedom, fitted.rig) for part in found.parts)
    of_time, of_joints = _turn_variance(time), _turn_variance(joints)
    # each of G groups tells of G - 1 (Satterthwaite 1946, of the sum of two such variances)
    fewer = [max(len(np.unique(cluster)) - 1, 1) for cluster in clusters]
    spread = of_time**2 / fewer[0] + of_joints**2 / fewer[1]
    degrees = (of_time + of_joints) ** 2 / max(spread, 1e-300)
    least = config.uncertainty.least_degrees
    matrix = found.once * widening(max(degrees, least)) * (time.matrix + joints.matrix)
    return FirstOrder(replace(time, matrix=matrix), of_time, of_joints)


def cautious_covariances(fitted: FittedRig, config: Config) -> tuple[RigCovariance, RigCovariance]:
    """Return a covariance of first order with a margin, and the one of independent errors.

    The second is what it would be if all detections erred independently: too small, but it has
    the shape that the images give it.
    """
    points, freedom = fitted.points, free_poses(len(fitted.rig.cameras))
    found = find_covariance(
        fitted.state,
        fitted.seen,
        freedom,
        clusters=(points.time_blocks(config.uncertainty.time_blocks), points.keypoint),
        loss_scale=points.loss_scale,
    )
    real, independent = found.sandwich, found.bread
    return _of_poses(real, freedom, fitted.rig), _of_poses(independent, freedom, fitted.rig)


def _turn_variance(covariance: RigCovariance) -> float:
    """Return the sum of the variances of all turns, in square radians."""
    return float(np.einsum("vivi->", covariance.matrix[:, :3, :, :3]))


def _of_poses(matrix: Floats, freedom: Freedom, rig: CameraRig) -> RigCovariance:
    """Return the covariance of a rig from that of its free unknowns, `[free, free]`."""
    views = len(rig.cameras)
    poses = freedom.basis @ matrix @ freedom.basis.T
    return _in_the_world(poses.reshape(views, 6, views, 6), rig)


def _in_the_world(matrix: Floats, rig: CameraRig) -> RigCovariance:
    """Return a covariance of poses as that of turns and shifts in the world.

    matrix: `[view, 6, view, 6]` of turns w and translations d in the frames of the cameras, the
        first of which stays: R <- exp(w) R and t <- exp(w) t + d move the centre by -R' d.
    """
    views, size = len(rig.cameras), rig_size(rig)
    to_world = np.zeros((views, 6, 6))
    to_world[:, :3, :3] = np.swapaxes(rig.rotation, 1, 2)
    to_world[:, 3:, 3:] = -np.swapaxes(rig.rotation, 1, 2) / size
    turned = np.einsum("vij,vjwk,wlk->viwl", to_world, matrix, to_world)
    half = project_out_similarity(turned.reshape(views, 6, -1), rig)
    whole = project_out_similarity(half.reshape(6 * views, 6 * views).T.reshape(views, 6, -1), rig)
    return RigCovariance(matrix=whole.reshape(views, 6, views, 6), size=size)


# What first order does not tell


def _bend(fitted: FittedRig, first: FirstOrder, config: Config, *, seed: int) -> float:
    """Return by how much more rigs of parts of what was seen differ than first order tells.

    Of standard deviations: without each fifth of the recording, and of halves of the joints.
    """
    found, expected = _halves(fitted, config, seed=seed), first.of_joints
    count = config.uncertainty.parts
    moments = len(np.unique(fitted.points.frame))
    # of hardly more moments than parts, each part would weigh too much
    if moments >= config.uncertainty.moments_of_a_part * count:
        found += _jackknife(fitted, fitted.points.time_blocks(count), config)
        expected += first.of_time
    return float(np.sqrt(found / max(expected, 1e-30)))


def _jackknife(fitted: FittedRig, part: Ints, config: Config) -> float:
    """Return the variance of all turns together by what rigs without a part differ by.

    In square radians: what the trace of the covariance of the turns should be. part: `[N]` the
    number of the part that each point is of.
    """
    count = int(part.max()) + 1
    kept = (np.flatnonzero(part != left_out) for left_out in range(count))
    turns = np.stack(list(map_in_threads(partial(_turns, fitted=fitted, config=config), kept)))
    return (count - 1) / count * float(((turns - turns.mean(0)) ** 2).sum())


def _halves(fitted: FittedRig, config: Config, *, seed: int) -> float:
    """Return the variance of all turns together by what rigs of halves of the joints differ by."""
    joints, joint = np.unique(fitted.points.keypoint, return_inverse=True)
    if len(joints) < 2:
        return np.inf
    rng = np.random.default_rng(seed)
    half = [(rng.permutation(len(joints)) % 2)[joint] for _ in range(config.uncertainty.splits)]
    kept = (np.flatnonzero(each == one) for each in half for one in (0, 1))
    turns = np.stack(list(map_in_threads(partial(_turns, fitted=fitted, config=config), kept)))
    # a half errs by twice the variance of the whole, and two of them differ by four times that
    return float(((turns[::2] - turns[1::2]) ** 2).sum()) / (4 * len(half))


def _turns(kept: Ints, *, fitted: FittedRig, config: Config) -> Floats:
    """Return the turns `[view, 3]` of the cameras when only some points (indices) are kept."""
    state = fitted.state
    some = replace(state, points=state.points[:, kept])
    tolerance = config.uncertainty.bend_tolerance
    rougher = replace(config, adjust=replace(config.adjust, tolerance=tolerance))
    found = _minimise(some, fitted.seen.select(kept), fitted.points.loss_scale, rougher)
    bent = replace(fitted.rig, rotation=found.rotation, translation=found.translation)
    return rig_change(fitted.rig, bent)[:, :3]
