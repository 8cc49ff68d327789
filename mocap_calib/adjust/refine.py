"""Adjust a rig and match by it in turns, from one start or several; measure how well it fits."""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.adjust.problem import choose_problem, free_poses, solve
from mocap_calib.adjust.residuals import State
from mocap_calib.compute.parallel import single_threaded_libraries
from mocap_calib.config import VERDICT_LIMITS_DEG, Config, UncertaintyConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.lens import points_in_cameras, project_views
from mocap_calib.geometry.rotation import angle_between, with_size_of
from mocap_calib.results import Adjusted, LiftedPoses, Matches
from mocap_calib.rig import gather_tracks, labelled_frames, measure_residuals
from mocap_calib.rig.associate import associate
from mocap_calib.rig.averaging import factorise, label_single_subject
from mocap_calib.rig.triangulate import triangulate_rays
from mocap_calib.types import Bools, CameraRig, Floats, Progress, Sample, silent


@single_threaded_libraries()
def adjust_once(
    sample: Sample,
    rig: CameraRig,
    matches: Matches,
    config: Config,
    *,
    already_close: bool = False,
) -> CameraRig:
    """Return the rig that minimises the robust reprojection error of the matched detections.

    Intrinsics stay as they are, and so do the first camera and the size of the rig. The loss is in
    standard deviations of the errors that the rig has to begin with, and is tightened in steps.
    already_close: the rig has been adjusted before, so that only the last step is needed.

    Raises UnderconstrainedCameraError for the camera that has the fewest points, where they are
    too few to constrain it, and DegenerateError where there is no match at all.
    """
    problem = choose_problem(sample, rig, matches, config)
    found = solve(
        problem.start(),
        problem.rays,
        free_poses(len(rig)),
        config.adjust,
        last=problem.loss_scale,
        already_close=already_close,
    )
    return placed_as(rig, found)


def placed_as(rig: CameraRig, state: State) -> CameraRig:
    """Return the rig with the poses of a state, at the size that it has."""
    adjusted = replace(rig, rotation=state.rotation, translation=state.translation)
    return with_size_of(rig, adjusted)


@single_threaded_libraries()
def adjust_from_best_start(
    sample: Sample,
    rig: CameraRig,
    matches: Matches,
    config: Config,
    *,
    lifted: LiftedPoses,
    progress: Progress,
) -> Adjusted:
    """Adjust the averaged rig and, where nothing was lifted, the rigs found by factorization.

    Returns the adjusted rig that fits best, and with it one that fits as well but is another rig:
    the same reversed in depth. Raises DegenerateError where no start can be adjusted.
    """
    found: list[Adjusted] = []
    refusals: list[DegenerateError] = []
    for start, labels in [(rig, matches), *_starts_without_model(sample, lifted)]:
        try:
            adjusted = adjust_until_stable(
                sample, start, labels, config, lifted=lifted, progress=progress
            )
        except DegenerateError as error:
            refusals.append(error)
        else:
            found.append(adjusted)
    if not found:
        raise refusals[0]
    return _best_fit(sample, found, config)


@single_threaded_libraries()
def adjust_until_stable(
    sample: Sample,
    rig: CameraRig,
    matches: Matches,
    config: Config,
    *,
    lifted: LiftedPoses,
    progress: Progress,
) -> Adjusted:
    """Adjust, match by the adjusted rig, and adjust again until no camera turns any more.

    It ends after `config.adjust.rounds` rounds at the latest; the first one, which is rough, never
    ends it. Raises DegenerateError where what was matched does not constrain the rig.
    """
    rounds = config.adjust.rounds
    for done in range(1, rounds + 1):
        before = rig
        rig = adjust_once(sample, before, matches, config, already_close=done > 1)
        progress("adjust", done, rounds)
        turn = _largest_turn_deg(before, rig)
        if done > 1 and turn < config.adjust.still_deg:
            break
        matches = associate(sample, lifted, rig, config, progress=silent)
    return Adjusted(
        rig=rig,
        matches=matches,
        depth_reversed_rig=None,
        rounds=done,
        turn_deg=turn,
    )


def _starts_without_model(sample: Sample, lifted: LiftedPoses) -> list[tuple[CameraRig, Matches]]:
    """Return rigs found by factorization with their labels, where no body could be lifted."""
    if np.isfinite(lifted.centre).any():
        return []
    labels = label_single_subject(sample)
    if labels is None:
        return []
    return [(rig, labels) for rig in factorise(sample, labels)]


def _best_fit(sample: Sample, adjusted: list[Adjusted], config: Config) -> Adjusted:
    """Return the rig that fits best, with another that fits as well, if there is one.

    The first of those that differ by no more than where an adjustment ends: the smallest change of
    rounding would choose another.
    """
    if len(adjusted) == 1:
        return adjusted[0]
    fits = [measure_fit(sample, each.rig, each.matches, config) for each in adjusted]
    # a rig under which nothing is matched has no misfit: it is taken where no other is
    misfit = np.nan_to_num([fit.misfit for fit in fits], nan=np.inf)
    ranked = np.argsort(misfit, kind="stable").tolist()
    best = int(np.argmax(misfit <= config.uncertainty.tied_misfit * misfit.min()))
    for k in ranked:  # as well: what was seen does not tell which of the two is right
        turn_deg = _largest_turn_deg(adjusted[k].rig, adjusted[best].rig)
        as_well = fits[k].misfit <= config.uncertainty.same_misfit * fits[best].misfit
        if as_well and turn_deg > VERDICT_LIMITS_DEG[-1]:
            return replace(adjusted[best], depth_reversed_rig=adjusted[k].rig)
    return adjusted[best]


def _largest_turn_deg(first: CameraRig, second: CameraRig) -> float:
    """Return the largest angle between two rigs' rotations, taken relative to the first camera."""
    from_first = [rig.rotation @ rig.rotation[0].T for rig in (first, second)]
    return float(np.rad2deg(angle_between(*from_first).max()))


# --- how well a rig fits what was seen


@dataclass(frozen=True)
class Fit:
    """How well a rig fits what was seen.

    misfit: RMS distance in pixels of all detections from the reprojected points, none counted for
        more than a few usual distances.
    angle: `[view]` median distance of the view's detections, in radians; good_angle: the distance
        that a quarter of them is below.
    noise: `[view]` robust standard deviation of one coordinate, in pixels.
    perspective: `[view]` RMS in pixels of what no affine camera explains. Where it is far below
        the noise, the camera might as well be infinitely far away: its distance follows from its
        focal length alone.
    """

    misfit: float
    angle: Floats
    good_angle: Floats
    noise: Floats
    perspective: Floats


def measure_fit(sample: Sample, rig: CameraRig, matches: Matches, config: Config) -> Fit:
    """Return how well the rig fits the matched detections in all frames of the sample."""
    noise, _ = measure_residuals(sample, rig, matches, config.triangulate)
    seen = gather_tracks(sample, matches, labelled_frames(matches))
    # what does not fit is to be counted, not left out
    all_rays = replace(config.triangulate, outlier=np.inf)
    points, _ = triangulate_rays(rig, seen.rays, weight=seen.weight, noise=noise, config=all_rays)
    error = np.linalg.norm(project_views(rig, points) - seen.pixels, axis=1)
    counted = (seen.weight > 0) & np.isfinite(points[0])
    # rays of two views meet nearly, whatever they show
    several = counted & (counted.sum(0) >= min(3, len(rig)))
    focal = np.array([camera.focal for camera in rig.cameras])
    return Fit(
        misfit=_misfit(error[counted], config.uncertainty.outlier_factor),
        angle=_quantiles(error, several, 0.5) / focal,
        good_angle=_quantiles(error, several, 0.25) / focal,
        noise=noise * focal,
        perspective=_perspective(rig, points, counted) * focal,
    )


def find_outlier_cameras(fit: Fit, config: UncertaintyConfig) -> Bools:
    """Return the cameras `[view]` whose errors are several times those of the others.

    They are out of step, were moved, or have other intrinsics than given. Of two cameras both
    have the errors, so none is named. All errors of such a camera are large: where half of what a
    camera detects is of nobody, the other half is as good as that of the others.
    """
    views = len(fit.angle)
    if views <= 2:
        return np.zeros(views, dtype=bool)
    good = _times_others(fit.good_angle) > config.outlier_factor / 2
    return np.asarray((_times_others(fit.angle) > config.outlier_factor) & good)


def _times_others(values: Floats) -> Floats:
    """Return each value `[view]` in medians of the others."""
    others = [np.median(np.delete(values, view)) for view in range(len(values))]
    return values / np.maximum(others, 1e-300)


def _misfit(error: Floats, limit: float) -> float:
    """Return the RMS of errors, none counted for more than `limit` times their median.

    error: `[N]`, NaN where a point is behind the camera, which counts as the largest.
    """
    most = limit * np.nanmedian(error)
    error = np.minimum(np.nan_to_num(error, nan=np.inf), most)
    return float(np.sqrt((error**2).mean()))


def _quantiles(error: Floats, counted: Bools, share: float) -> Floats:
    """Return a quantile `[view]` of the counted errors `[view, N]`, NaN where there is none.

    An error of NaN, behind the camera, counts as the largest.
    """
    found = np.full(len(error), np.nan)
    for view in np.flatnonzero(counted.any(1)):
        in_view = error[view, counted[view]]
        found[view] = np.quantile(np.nan_to_num(in_view, nan=np.inf), share, method="lower")
    return found


def _perspective(rig: CameraRig, points: Floats, counted: Bools) -> Floats:
    """Return the RMS `[view]` in radians of what no affine camera explains of the images.

    points: `[3, N]` in world coordinates; counted: `[view, N]`.
    """
    found, in_cameras = np.zeros(len(rig)), points_in_cameras(rig, points)
    for view in np.flatnonzero(counted.any(1)):
        x, y, z = in_cameras[view][:, counted[view]]
        image = np.stack([x, y], axis=1) / z[:, None]
        affine = np.stack([x, y, z, np.ones_like(z)], axis=1)
        residual = image - affine @ np.linalg.lstsq(affine, image, rcond=None)[0]
        found[view] = np.sqrt((residual**2).sum(1).mean())
    return found
