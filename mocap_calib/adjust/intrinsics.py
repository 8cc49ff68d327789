"""Estimate focal lengths and lenses together with the rig, from what a recording shows.

A rig of three views or more determines the focal length that its cameras share, and mostly the
first coefficient of their lens; no search is needed. Errors of detections are correlated, so that
thousands of them weigh no more than some hundred (`covariance`): what is known beforehand counts
for as much more.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mocap_calib.adjust.covariance import Covariance, find_covariance
from mocap_calib.adjust.problem import Problem, choose_problem, free_parameters, solve
from mocap_calib.adjust.refine import placed_as
from mocap_calib.adjust.residuals import State, changed_cameras
from mocap_calib.adjust.solve import Parameters, optimise_points
from mocap_calib.config import SAME_IMAGE_SIZE, Config, IntrinsicsConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.recording.sampling import with_cameras
from mocap_calib.results import LiftedPoses, Matches
from mocap_calib.rig import Observed, leave_out_underconstrained
from mocap_calib.rig.associate import associate
from mocap_calib.rig.averaging import average
from mocap_calib.rig.view_graph import camera_groups
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

_MOST_OVERCONFIDENCE = 1e4  # where what was seen says barely anything


def estimate_cameras(
    observed: Observed, config: Config, *, progress: Progress
) -> tuple[EstimatedCamera, ...]:
    """Return all cameras with the intrinsics estimated from the rig of their group.

    Cameras of which nothing can be estimated stay as they were given.
    """
    cameras = observed.recording.cameras
    estimated: dict[str, EstimatedCamera] = {}
    for views in camera_groups(cameras, observed.pairs, config.averaging):
        estimate = partial(_estimate_group, config=config, progress=progress)
        try:
            found = leave_out_underconstrained(observed.select(views), estimate)
        except DegenerateError:
            continue
        estimated |= {camera.name: camera for camera in found}
    unknown = config.intrinsics.focal_uncertainty
    return tuple(
        estimated.get(camera.name) or _estimated_camera(camera, unknown, 0.0) for camera in cameras
    )


def _estimate_group(
    observed: Observed, *, config: Config, progress: Progress
) -> tuple[EstimatedCamera, ...]:
    """Return the cameras of one group with intrinsics from a rig of theirs."""
    sample, lifted = observed.sample, observed.lifted
    rig = average(observed.recording.cameras, observed.pairs, config.averaging).rig
    matches = associate(sample, lifted, rig, config, progress=progress)
    return estimate_intrinsics(sample, rig, matches, config, lifted=lifted, progress=progress)


@dataclass(frozen=True)
class _Estimate:
    """A rig with its intrinsics, and what was seen with them.

    sample, matches: with the rays of the rig's cameras, and labelled by the rig.
    change: `[view, intrinsic]` of log focal length and, where it is estimated, k1, from what was
        given. sigma: `[view, intrinsic]` standard deviation of the changes.
    overconfidence: `[view, intrinsic]` by how much their variance is larger than that of
        independent errors.
    """

    rig: CameraRig
    sample: Sample
    matches: Matches
    change: Floats
    sigma: Floats
    overconfidence: Floats

    @property
    def cameras(self) -> tuple[EstimatedCamera, ...]:
        """The cameras with the standard deviations of what was estimated of them."""
        sigma = np.zeros((len(self.sigma), 2))
        sigma[:, : self.sigma.shape[1]] = self.sigma
        return tuple(map(_estimated_camera, self.rig.cameras, sigma[:, 0], sigma[:, 1]))


def _estimated_camera(camera: Camera, log_focal: float, k1: float) -> EstimatedCamera:
    """Return a camera with the standard deviations of its log focal length and of k1."""
    return EstimatedCamera.of(
        camera, focal_sigma=float(log_focal * camera.focal), k1_sigma=float(k1)
    )


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

    More of the intrinsics are free where that is significant: a focal length for each camera, k1.
    rig: with the cameras as they are given, and roughly where they stand.

    Raises what `adjust` raises: DegenerateError and UnderconstrainedCameraError.
    """
    settle = partial(_settle, given=sample, lifted=lifted, progress=progress)
    settings = config.intrinsics
    start = _start(sample, rig, matches, settings)
    found = settle(start, config=config)
    # two views barely say anything: any focal length goes with some rig
    if np.median(found.sigma[:, 0]) >= settings.least_gain * settings.focal_uncertainty:
        return start.cameras
    if _lenses_differ(found, config):
        config = replace(config, intrinsics=replace(settings, focal_per_camera=True))
        found = settle(found, config=config)
    if settings.refine == "focal+k1":
        with_k1 = replace(
            found,
            change=np.pad(found.change, ((0, 0), (0, 1))),
            overconfidence=np.repeat(found.overconfidence, 2, axis=1),
        )
        with_k1 = settle(with_k1, config=config)
        if (np.abs(with_k1.change) / with_k1.sigma)[:, 1].max() > settings.significance:
            found = with_k1
    return found.cameras


def _start(sample: Sample, rig: CameraRig, matches: Matches, config: IntrinsicsConfig) -> _Estimate:
    """Return the focal lengths that were given, as the start of their estimate."""
    none = np.zeros((len(sample.cameras), 1))
    return _Estimate(
        rig=rig,
        sample=sample,
        matches=matches,
        change=none,
        sigma=none + config.focal_uncertainty,
        overconfidence=none + config.overconfidence,
    )


@dataclass(frozen=True)
class FreeFocal:
    """A rig adjusted with free focal lengths.

    change, sigma: `[view]` of the logarithms of the focal lengths.
    rig: its cameras are those that were given.
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
    found, state = _adjust(start, sample.cameras, free, already_close=True)
    return FreeFocal(found.change[:, 0], found.sigma[:, 0], placed_as(rig, state))


@dataclass(frozen=True)
class FreeAspect:
    """A rig adjusted with one free aspect, the ratio f_y / f_x, of all cameras.

    change, sigma: of its logarithm. rig: its cameras are those that were given.
    """

    change: float
    sigma: float
    rig: CameraRig


def free_aspect(sample: Sample, rig: CameraRig, matches: Matches, config: Config) -> FreeAspect:
    """Return what the aspect of all images would change by if it were free, and how the rig would.

    A focal length that all share is free besides. For a rig that has been adjusted with the
    intrinsics that were given. Raises as `refine.adjust` does.
    """
    settings, views = IntrinsicsConfig(), len(rig)
    problem = choose_problem(sample, rig, matches, config, points=config.uncertainty.points)
    wide, fixed = settings.focal_uncertainty / np.sqrt(settings.overconfidence), 1e-6
    prior = np.tile([wide, fixed, wide], (views, 1))
    free = free_parameters(np.zeros(views, dtype=np.int64), prior)
    none = np.zeros_like(prior)
    state, covariance = _minimum(problem, none, sample.cameras, free, config, already_close=True)
    sigma = _sigma(covariance, free, np.full(prior.shape, settings.overconfidence))
    return FreeAspect(float(state.intrinsics[0, 2]), float(sigma[0, 2]), placed_as(rig, state))


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
    return float(np.mean((free.change / free.sigma) ** 2)) > config.intrinsics.significance**2


def _settle(
    found: _Estimate, *, given: Sample, config: Config, lifted: LiftedPoses, progress: Progress
) -> _Estimate:
    """Adjust, take the rays anew and match again, until the focal lengths stay.

    given: the sample with the intrinsics that were given.
    """
    rounds = config.adjust.rounds
    still = np.deg2rad(config.adjust.still_deg)  # a ray turns by no more than the focal length
    for done in range(1, rounds + 1):
        before = found
        found, state = _adjust(found, given.cameras, config, already_close=done > 1)
        cameras = changed_cameras(given.cameras, state.intrinsics)
        rig = placed_as(replace(found.rig, cameras=cameras), state)
        sample = with_cameras(given, cameras)
        matches = associate(sample, lifted, rig, config, progress=silent)
        found = replace(found, rig=rig, sample=sample, matches=matches)
        progress("intrinsics", done, rounds)
        change = np.abs(found.change[:, 0] - before.change[:, 0]).max()
        if change < still:
            break
    return found


def _adjust(
    found: _Estimate, given: tuple[Camera, ...], config: Config, *, already_close: bool
) -> tuple[_Estimate, State]:
    """Adjust poses and intrinsics together to the detections that are matched.

    Returns the estimate with other changes of the intrinsics, and the state.
    already_close: the estimate follows another such adjustment.
    """
    settings, intrinsics = config.intrinsics, found.change.shape[1]
    budget = config.uncertainty.points if already_close else None
    problem = choose_problem(found.sample, found.rig, found.matches, config, points=budget)
    prior = np.array([settings.focal_uncertainty, settings.k1_uncertainty])[:intrinsics]
    # detections weigh as if they erred independently: the prior weighs more by the same factor
    prior = prior / np.sqrt(found.overconfidence)
    free = free_parameters(shared_intrinsics(given, settings), prior)
    state, covariance = _minimum(
        problem, found.change, given, free, config, already_close=already_close
    )
    estimate = replace(
        found,
        change=state.intrinsics,
        sigma=_sigma(covariance, free, found.overconfidence),
        overconfidence=_overconfidence(covariance, free),
    )
    return estimate, state


def _minimum(
    problem: Problem,
    change: Floats,
    cameras: tuple[Camera, ...],
    free: Parameters,
    config: Config,
    *,
    already_close: bool,
) -> tuple[State, Covariance]:
    """Return the state of least cost, and the covariance of what is free there.

    change: `[view, intrinsic]` of the intrinsics of the cameras, from which it starts.
    """
    seen, last = problem.pixels(cameras), problem.loss_scale
    start = problem.start(change)
    state = solve(start, seen, free, config.adjust, last=last, already_close=already_close)
    state = optimise_points(state, seen, loss_scale=last)
    return state, find_covariance(problem, state, seen, free, config)


def _overconfidence(covariance: Covariance, free: Parameters) -> Floats:
    """Return by how much the variance of intrinsics is larger than that of independent errors.

    `[view, intrinsic]`, of what the detections alone say: with s the scatter of an unknown's
    gradient and h its curvature, both with all other unknowns eliminated, the variances are
    s / h^2 and 1 / h.
    """
    own = free.intrinsics
    variance = np.diag(covariance.independent)[own]
    scatter = np.diag(covariance.cautious)[own] / variance**2
    curvature = 1 / variance - _prior(free)
    return np.clip(scatter / np.maximum(curvature, 1e-12), 1.0, _MOST_OVERCONFIDENCE)


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
