"""How sure the places of the cameras are: the covariance of a rig that was adjusted.

Errors of detections go together, by the moment and by the joint (`covariance`). Where a rig stands
in the world, how it is turned and how large it is means nothing: what counts is how far its
cameras are from where they should be after the best similarity between the two. So no camera is
the fixed one, and all have a share of what is not known.

The covariance is of first order: it holds where a rig bends in proportion to what pulls at it.
Rigs that are hardly determined bend more. Rigs of parts of what was seen show that (`rig_parts`).
"""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.adjust.covariance import find_covariance, find_curved_covariance
from mocap_calib.adjust.distinct_moments import count_moments
from mocap_calib.adjust.fitted_rig import FittedRig, fit_again
from mocap_calib.adjust.freedom import Freedom, free_poses
from mocap_calib.adjust.regions import widening
from mocap_calib.adjust.rig_parts import LeftOut, halves_variance, leave_out_moments
from mocap_calib.config import Config
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.gauge import project_out_similarity, rig_size
from mocap_calib.types import CameraRig, Floats, Matches, RigCovariance, Sample


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


def rig_covariance(
    sample: Sample, rig: CameraRig, matches: Matches, config: Config, *, seed: int
) -> RigCovariance:
    """Return the covariance of a rig that has been adjusted to what was matched.

    Intrinsics count as known. Everything is as uncertain as can be where the matched detections do
    not constrain the rig.
    """
    return covariance_and_held_out(sample, rig, matches, config, seed=seed)[0]


def covariance_and_held_out(
    sample: Sample, rig: CameraRig, matches: Matches, config: Config, *, seed: int
) -> tuple[RigCovariance, float]:
    """Return `rig_covariance`, and the errors in moments that a rig was made without.

    Their median is in errors that the same moments have in the rig of all; NaN where there are too
    few moments.
    """
    try:
        fitted = fit_again(sample, rig, matches, config)
    except DegenerateError:
        return RigCovariance.unknown(len(rig.cameras), rig_size(rig)), np.nan
    without = leave_out_moments(fitted, config)
    return _covariance_of(fitted, without, config, seed=seed), without.held_out


def covariance_of(fitted: FittedRig, config: Config, *, seed: int) -> RigCovariance:
    """Return the covariance of a rig; see `rig_covariance`."""
    return _covariance_of(fitted, leave_out_moments(fitted, config), config, seed=seed)


def _covariance_of(
    fitted: FittedRig, without: LeftOut, config: Config, *, seed: int
) -> RigCovariance:
    """Return the covariance of a rig. without: see `leave_out_moments`."""
    rig = fitted.rig
    first = first_order(fitted, config)
    bend = _bend(fitted, first, without, config, seed=seed) / config.uncertainty.usual_bend
    if not np.isfinite(bend):  # too little is left to leave a part of it out
        return RigCovariance.unknown(len(rig.cameras), rig_size(rig))
    # what parts of the errors do more than in proportion, all of them together do once more
    inflation = max(1.0, bend) ** 2
    # a single moment does not show what all joints of a moment share: it counts twice
    moments = 1 + 1 / count_moments(fitted.points, config.uncertainty)
    found = replace(first.whole, matrix=first.whole.matrix * inflation**2 * moments)
    # no angle is larger; where nothing is determined a variance may be below 0 by rounding errors
    with np.errstate(invalid="ignore"):
        known = found.rotation_sigma.max() < np.pi and np.isfinite(found.centre_sigma).all()
    return found if known else RigCovariance.unknown(len(rig.cameras), rig_size(rig))


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


def _bend(
    fitted: FittedRig, first: FirstOrder, without: LeftOut, config: Config, *, seed: int
) -> float:
    """Return by how much more rigs of parts of what was seen differ than first order tells.

    Of standard deviations: without each fifth of the recording, and of halves of the joints.
    """
    found, expected = halves_variance(fitted, config, seed=seed), first.of_joints
    if np.isfinite(without.variance):
        found += without.variance
        expected += first.of_time
    return float(np.sqrt(found / max(expected, 1e-30)))
