"""Estimate focal lengths and lenses together with the rig, from what a recording shows.

A rig of three views or more determines the focal length that its cameras share, and mostly the
first coefficient of their lens; no search is needed. Errors of detections go together, so that
thousands of them weigh no more than some hundred (`covariance`): what is known beforehand counts
for as much more.
"""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.adjust.covariance import Covariance, find_covariance
from mocap_calib.adjust.parameters import Parameters, free_intrinsics
from mocap_calib.adjust.problem import choose_problem, solve
from mocap_calib.adjust.refine import placed_as
from mocap_calib.adjust.residuals import State, changed_cameras
from mocap_calib.adjust.solve import optimise_points
from mocap_calib.config import SAME_IMAGE_SIZE, Config, IntrinsicsConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.recording.sampling import with_cameras
from mocap_calib.results import LiftedPoses, Matches
from mocap_calib.rig.associate import associate, have_same_groups
from mocap_calib.types import (
    Camera,
    CameraRig,
    EstimatedCamera,
    Floats,
    Ints,
    Progress,
    Sample,
    silent,
)


@dataclass(frozen=True)
class _Estimate:
    """A rig with its intrinsics, and what was seen with them.

    sample, matches: with the rays of the rig's cameras, and labelled by the rig.
    change: `[view, intrinsic]` of log focal length and, where it is estimated, k1, from what was
        given.
    sigma: `[view, intrinsic]` standard deviation of the changes.
    overconfidence: `[view, intrinsic]` by how much their variance is larger than that of
        independent errors.
    """

    rig: CameraRig
    sample: Sample
    matches: Matches
    change: Floats
    sigma: Floats
    overconfidence: Floats


@dataclass(frozen=True)
class _Adjusted:
    """What one adjustment of poses and intrinsics together ends at; see `_Estimate`."""

    state: State
    sigma: Floats
    overconfidence: Floats


def estimate_intrinsics(
    sample: Sample,
    rig: CameraRig,
    matches: Matches,
    config: Config,
    *,
    lifted: LiftedPoses,
    progress: Progress,
) -> tuple[EstimatedCamera, ...]:
    """Return the cameras of the sample with the intrinsics under which the views agree best.

    rig: with the cameras as they are given, and roughly where they stand.

    Raises what `adjust` raises: DegenerateError and UnderconstrainedCameraError.
    """
    start = _start(sample, rig, matches, config.intrinsics)
    found = _settle(start, sample, config, lifted=lifted, progress=progress)
    if not _focal_is_determined(found, config.intrinsics):
        return _estimated_cameras(start)
    if _lenses_differ(found, config):
        config = replace(config, intrinsics=replace(config.intrinsics, focal_per_camera=True))
        found = _settle(found, sample, config, lifted=lifted, progress=progress)
    if config.intrinsics.refine == "focal+k1":
        with_k1 = _settle(_with_k1(found), sample, config, lifted=lifted, progress=progress)
        if _k1_is_significant(with_k1, config.intrinsics):
            found = with_k1
    return _estimated_cameras(found)


@dataclass(frozen=True)
class FreeFocal:
    """What becomes of a rig when its focal lengths are free.

    change, sigma: `[view]` of the logarithms of the focal lengths.
    rig: adjusted with them; its cameras are those that were given.
    """

    change: Floats
    sigma: Floats
    rig: CameraRig


def free_focal_lengths(
    sample: Sample, rig: CameraRig, matches: Matches, config: Config
) -> FreeFocal:
    """Return what each focal length would change by if it were free, and how the rig would.

    For a rig that has been adjusted with the focal lengths that were given. Right ones change by no
    more than a few standard deviations, which are 1 to 2 % in rigs of four views and far more in
    those of two.

    Raises as `refine.adjust` does.
    """
    alone = replace(IntrinsicsConfig(), refine="focal", focal_per_camera=True)
    start = _start(sample, rig, matches, alone)
    free = replace(config, intrinsics=alone)
    adjusted = _adjust(start, sample.cameras, free, already_close=True)
    return FreeFocal(
        change=adjusted.state.intrinsics[:, 0],
        sigma=adjusted.sigma[:, 0],
        rig=placed_as(rig, adjusted.state),
    )


def _start(sample: Sample, rig: CameraRig, matches: Matches, config: IntrinsicsConfig) -> _Estimate:
    """Return the focal lengths that were given, as the start of their estimate."""
    views = len(sample.cameras)
    return _Estimate(
        rig=rig,
        sample=sample,
        matches=matches,
        change=np.zeros((views, 1)),
        sigma=np.full((views, 1), config.focal_uncertainty),
        overconfidence=np.full((views, 1), config.overconfidence),
    )


def shared_intrinsics(cameras: tuple[Camera, ...], config: IntrinsicsConfig) -> Ints:
    """Return the number `[view]` of the group of cameras whose intrinsics change alike.

    These are cameras of equal image size, whichever side is up, unless `focal_per_camera` is set.
    """
    if config.focal_per_camera:
        return np.arange(len(cameras))
    sizes = np.array([sorted(camera.size) for camera in cameras], dtype=np.float64)
    alike = np.abs(sizes[:, None] - sizes).max(-1) <= SAME_IMAGE_SIZE * sizes[:, None].max(-1)
    return np.asarray(alike.argmax(1), dtype=np.int64)  # the first one of that size


def _lenses_differ(found: _Estimate, config: Config) -> bool:
    """Return whether cameras of equal image size certainly have unlike focal lengths."""
    if config.intrinsics.focal_per_camera:
        return False
    try:
        free = free_focal_lengths(found.sample, found.rig, found.matches, config)
    except DegenerateError:
        return False
    return float(np.mean((free.change / free.sigma) ** 2)) > config.intrinsics.unlike_lenses**2


def _with_k1(found: _Estimate) -> _Estimate:
    """Return an estimate of the focal lengths as the start of one of the lenses too."""
    more = np.zeros((len(found.change), 1))
    return replace(
        found,
        change=np.concatenate([found.change, more], axis=1),
        overconfidence=np.repeat(found.overconfidence, 2, axis=1),
    )


def _settle(
    found: _Estimate, given: Sample, config: Config, *, lifted: LiftedPoses, progress: Progress
) -> _Estimate:
    """Adjust, take the rays anew and match again, until the focal lengths and the groups stay.

    given: the sample with the intrinsics that were given.
    """
    rounds = config.intrinsics.rounds
    for done in range(1, rounds + 1):
        before = found
        found = _adjust_once(found, given, config, lifted=lifted, already_close=done > 1)
        progress("intrinsics", done, rounds)
        change = np.abs(found.change[:, 0] - before.change[:, 0]).max()
        if change < config.intrinsics.settled and have_same_groups(found.matches, before.matches):
            break
    return found


def _adjust_once(
    found: _Estimate,
    given: Sample,
    config: Config,
    *,
    lifted: LiftedPoses,
    already_close: bool,
) -> _Estimate:
    """Return the estimate after one adjustment of poses and intrinsics together.

    already_close: it follows another such adjustment.
    """
    adjusted = _adjust(found, given.cameras, config, already_close=already_close)
    cameras = changed_cameras(given.cameras, adjusted.state.intrinsics)
    rig = placed_as(replace(found.rig, cameras=cameras), adjusted.state)
    sample = with_cameras(given, cameras)
    return _Estimate(
        rig=rig,
        sample=sample,
        matches=associate(sample, lifted, rig, config, progress=silent),
        change=adjusted.state.intrinsics,
        sigma=adjusted.sigma,
        overconfidence=adjusted.overconfidence,
    )


def _adjust(
    found: _Estimate, given: tuple[Camera, ...], config: Config, *, already_close: bool
) -> _Adjusted:
    """Adjust poses and intrinsics together to the detections that are matched."""
    budget = config.uncertainty.points if already_close else None
    problem = choose_problem(found.sample, found.rig, found.matches, config, points=budget)
    seen, scale = problem.pixels(given), problem.loss_scale
    free = _free_parameters(found, given, config.intrinsics)
    start = problem.start(found.change)
    state = solve(start, seen, free, config.adjust, loss_scale=scale, already_close=already_close)
    state = optimise_points(state, seen, loss_scale=scale)
    covariance = find_covariance(
        state,
        seen,
        free,
        period=problem.tracks.time_blocks(config.uncertainty.time_blocks),
        joint=problem.tracks.keypoint,
        scale=scale,
    )
    return _Adjusted(
        state=state,
        sigma=_sigma(covariance, free, found.overconfidence),
        overconfidence=_overconfidence(covariance, free, config.intrinsics),
    )


def _free_parameters(
    found: _Estimate, given: tuple[Camera, ...], config: IntrinsicsConfig
) -> Parameters:
    """Return what may change, and how likely that is beside detections that count too much.

    The detections' weight is what it would be if they erred independently, so what is known
    beforehand weighs more by the same factor.
    """
    sigma = np.array([config.focal_uncertainty, config.k1_uncertainty])
    sigma = sigma[: found.change.shape[1]] / np.sqrt(found.overconfidence)
    return free_intrinsics(shared_intrinsics(given, config), sigma)


def _overconfidence(covariance: Covariance, free: Parameters, config: IntrinsicsConfig) -> Floats:
    """Return by how much the variance of intrinsics is larger than that of independent errors.

    `[view, intrinsic]`, of what the detections alone say: with s the scatter of an unknown's
    gradient and h its curvature, both with all other unknowns eliminated, the variances are
    s / h^2 and 1 / h.
    """
    own = free.intrinsics
    variance = np.diag(covariance.independent)[own]
    scatter = np.diag(covariance.cautious)[own] / variance**2
    curvature = 1 / variance - _prior(free)
    return np.clip(scatter / np.maximum(curvature, 1e-12), 1.0, config.most_overconfidence)


def _sigma(covariance: Covariance, free: Parameters, overconfidence: Floats) -> Floats:
    """Return the standard deviation `[view, intrinsic]` of intrinsics after the adjustment.

    Detections and what is known beforehand both have their part in it. The latter was made to
    weigh more by the factor of the overconfidence, so its gradient scatters by that factor more
    than it weighs.
    """
    own = free.intrinsics
    prior = np.zeros(len(covariance.independent))
    prior[own] = _prior(free) * overconfidence
    whole = covariance.cautious + (covariance.independent * prior) @ covariance.independent
    return np.sqrt(np.diag(whole)[own])


def _prior(free: Parameters) -> Floats:
    """Return the inverse variance `[view, intrinsic]` that intrinsics had in the adjustment."""
    own = free.intrinsics
    whole = np.zeros(free.basis.shape[1])
    np.add.at(whole, own, free.precision)  # each view has its part
    return whole[own]


def _focal_is_determined(found: _Estimate, config: IntrinsicsConfig) -> bool:
    """Return whether the recording says more of the focal lengths than was known beforehand.

    Two views hardly say anything: any focal length goes with some rig.
    """
    left = np.median(found.sigma[:, 0]) / config.focal_uncertainty
    return bool(left < config.least_gain)


def _k1_is_significant(found: _Estimate, config: IntrinsicsConfig) -> bool:
    """Return whether the lens of any camera has certainly another first coefficient than given."""
    ratio = np.abs(found.change[:, 1]) / found.sigma[:, 1]
    return bool(ratio.max() > config.k1_significance)


def _estimated_cameras(found: _Estimate) -> tuple[EstimatedCamera, ...]:
    """Return the cameras with the standard deviations of what was estimated of them."""
    sigma = np.zeros((len(found.sigma), 2))
    sigma[:, : found.sigma.shape[1]] = found.sigma
    return tuple(map(_estimated_camera, found.rig.cameras, sigma[:, 0], sigma[:, 1]))


def not_estimated(camera: Camera, config: IntrinsicsConfig) -> EstimatedCamera:
    """Return a camera that nothing was found of, as uncertain as it was beforehand."""
    return _estimated_camera(camera, config.focal_uncertainty, 0.0)


def _estimated_camera(camera: Camera, log_focal: float, k1: float) -> EstimatedCamera:
    """Return a camera with the standard deviations of its log focal length and of k1."""
    return EstimatedCamera.of(
        camera, focal_sigma=float(log_focal * camera.focal), k1_sigma=float(k1)
    )
