"""The verdict on a rig: how far its cameras may be off, and why.

Reprojection errors are small also where nothing is determined: where a subject is small in the
image and stands still, all frames share the errors of its joints, and the rig bends to fit them.
The covariance of the rig knows of that. It does not know of wrong intrinsics, to which the rig
bends too: by how much it would bend back if focal lengths were free tells what they do.

The expected error of a camera, in degrees, is the root of the sum of the squares of named causes:
its covariance, what is not known of given intrinsics, each check of the residuals, and each thing
that the recording leaves open. docs/how-good.md has the rule in words.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mocap_calib import mapped
from mocap_calib.adjust.covariance import rig_covariance
from mocap_calib.adjust.intrinsics import (
    FreeAspect,
    FreeFocal,
    free_aspect,
    free_focal_lengths,
    shared_intrinsics,
)
from mocap_calib.adjust.refine import (
    adjust_once,
    find_outlier_cameras,
    measure_fit,
)
from mocap_calib.compute import Clock
from mocap_calib.compute.parallel import single_threaded_libraries
from mocap_calib.config import EPOCH_MARK, VERDICT_LIMITS_DEG, Config, UncertaintyConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.lens import change_intrinsics, focal_sigmas
from mocap_calib.geometry.rotation import rig_change, rig_size
from mocap_calib.pairs.solve import in_recording
from mocap_calib.recording.sampling import with_cameras
from mocap_calib.results import (
    Adjusted,
    Averaged,
    CalibrationResult,
    Cause,
    Clocks,
    Fault,
    GroupResult,
    LiftedPoses,
    Matches,
    Poses3D,
    RigCovariance,
    TimeOffsets,
    Uncertainty,
    Verdict,
)
from mocap_calib.rig import Observed, labelled_frames
from mocap_calib.rig.averaging import best_scores
from mocap_calib.rig.triangulate import triangulate
from mocap_calib.types import (
    POSE,
    Bools,
    CameraRig,
    EstimatedCamera,
    Floats,
    Progress,
    Sample,
    silent,
)
from mocap_calib.verdict.causes import (
    left_open,
    mirrored_world,
    other_answers,
    resized_images,
    squeezed_images,
    uncertain_cameras,
    uncertain_principal_points,
    unchecked_by_a_third_camera,
)
from mocap_calib.verdict.checks import check_rig


def judge(result: CalibrationResult) -> CalibrationResult:
    """Return the result with the verdict on each group of cameras, given its faults and clocks.

    Cameras are named as inconsistent, or with a wrong focal length, only where the others determine
    that.
    """
    groups = []
    for group in result.groups:
        checks, config = group.assessment.checks, result.config
        verdict = assess(group, checks, config, faults=result.faults, clocks=result.clocks)
        groups.append(_certain_outliers(replace(group, assessment=verdict), config))
    return replace(result, groups=tuple(groups))


def assess(
    group: GroupResult,
    checks: tuple[Cause, ...],
    config: Config,
    *,
    faults: Sequence[Fault] = (),
    clocks: Clocks | None = None,
) -> Verdict:
    """Return the verdict on the rig of a group. checks: of the group, as of `check_rig`."""
    causes = [
        *uncertain_cameras(group, config),
        *uncertain_principal_points(group, faults, config.uncertainty),
        *(check for check in checks if check.error_deg > 0),
        *left_open(group, checks, faults, clocks),
        *mirrored_world(group),
        *other_answers(group),
        *unchecked_by_a_third_camera(group, config),
        *resized_images(group, config),
        *squeezed_images(group),
    ]
    causes.sort(key=lambda cause: -cause.error_deg)
    return Verdict(expected_error(group.rig.names, causes), tuple(causes), checks)


def expected_error(names: Sequence[str], causes: Sequence[Cause]) -> float:
    """Return the expected error in degrees of the least certain camera. names: of the rig."""
    squares = [
        sum(
            cause.error_deg**2
            for cause in causes
            if cause.camera in ("", name, name.partition(EPOCH_MARK)[0])
        )
        for name in names
    ]
    return float(np.sqrt(max(squares)))


def conclude(
    observed: Observed,
    averaged: Averaged,
    adjusted: Adjusted,
    matches: Matches,
    offsets: TimeOffsets,
    *,
    config: Config,
    clock: Clock,
    progress: Progress,
) -> GroupResult:
    """Assess an adjusted rig and triangulate the bodies; return all that was found.

    matches: labels in all frames. offsets: of the clocks, with which the recording and the sample
        were made. clock: its stages, and those of before, are returned.
    """
    recording, sample, rig = observed.recording, observed.sample, adjusted.rig
    with clock("uncertainty"):
        sampled = matches.select(frames=observed.sample_frames, instances=sample.positions.shape[2])
        uncertainty = assess_uncertainty(sample, rig, sampled, config)
    with clock("triangulate"):
        poses = triangulate(recording, rig, matches, config.triangulate, progress=progress)
    depths = agreement_of_depths(observed, rig, sampled, poses)
    uncertainty = replace(uncertainty, mirrored=mirror_nats(depths, config.uncertainty))
    group = GroupResult(
        recording=recording,
        pairs=in_recording(observed.pairs, observed.sample_frames),
        averaged=averaged,
        adjusted=adjusted,
        matches=matches,
        uncertainty=uncertainty,
        poses=poses,
        time_offsets=offsets,
    )
    with clock("verdict"):
        verdict = assess(group, check_rig(group, config), config)
    return replace(group, assessment=verdict, seconds=clock.seconds)


@single_threaded_libraries()
def conclude_without_pairs(
    sample: Sample,
    lifted: LiftedPoses,
    rig: CameraRig,
    adjusted: Adjusted,
    config: Config,
) -> CalibrationResult:
    """Return what `conclude` finds of the frames of a sample alone, where no pairs are known.

    rig: that was adjusted.
    """
    none = np.zeros(0)
    group = conclude(
        Observed(sample, np.arange(len(sample.frames)), sample, lifted, pairs=()),
        Averaged(rig, loop_error=none, translation_error=none, weight=none),
        adjusted,
        adjusted.matches,
        TimeOffsets.unknown(len(rig)),
        config=config,
        clock=Clock(),
        progress=silent,
    )
    clocks = Clocks.of_one(sample)
    return judge(
        CalibrationResult((group,), left_out=(), unused_pairs=(), config=config, clocks=clocks)
    )


def _certain_outliers(group: GroupResult, config: Config) -> GroupResult:
    """Return the group with outlier cameras only where the others are consistent.

    None where the rig is not determined, where half of the cameras are outliers, and where most
    cameras are uncertain or belong to no good pair.
    """
    none, known = np.zeros(len(group.rig), dtype=bool), group.uncertainty
    usual = np.rad2deg(np.median(known.covariance.rotation_sigma))
    score = np.median(best_scores(group.pairs, len(none)))  # NaN: no pairs are known
    uncertain = usual > VERDICT_LIMITS_DEG[1] or score < config.averaging.weak_score
    if group.verdict == "not determined":
        known = replace(known, outlier_cameras=none, wrong_focal=none)
    elif 2 * known.outlier_cameras.sum() >= len(none) or uncertain:
        known = replace(known, outlier_cameras=none)
    return replace(group, uncertainty=known)


# --- what keypoints leave uncertain


@single_threaded_libraries()
def assess_uncertainty(
    sample: Sample, rig: CameraRig, matches: Matches, config: Config
) -> Uncertainty:
    """Return how well the sample determines the rig, and which cameras stand out.

    Few frames accuse no camera: standard deviations over time are too small then.
    """
    fit = measure_fit(sample, rig, matches, config)
    covariance = rig_covariance(sample, rig, matches, config)
    free = _free_focal(sample, rig, matches, config)
    off = uncertain_focal_changes(sample, rig, matches, config)
    if free is not None:
        off = np.concatenate([off, given_change(rig, free, config.uncertainty)[None]])
    change, sigma = np.full((2, len(rig.cameras)), np.nan)
    # what was estimated is not found to be wrong
    if free is not None and not any(isinstance(each, EstimatedCamera) for each in rig.cameras):
        stated = np.nan_to_num(focal_sigmas(rig.cameras, config.uncertainty))
        change, sigma = free.change, np.hypot(free.sigma, stated)
    aspect, squeezed = _free_aspect(sample, rig, matches, config), np.zeros((len(rig), POSE))
    if aspect is not None:
        squeezed = given_change(rig, aspect, config.uncertainty)
    tells = len(labelled_frames(matches)) >= config.uncertainty.time_blocks
    return Uncertainty(
        covariance=covariance.with_changes(off),
        intrinsics_turn=np.sqrt((off[..., :3] ** 2).sum((0, 2))),
        outlier_cameras=find_outlier_cameras(fit, config.uncertainty) & tells,
        weak_perspective=fit.perspective < fit.noise,
        focal_change=change,
        focal_sigma=sigma,
        wrong_focal=find_wrong_focal(change, sigma, config) & tells,
        aspect_turn=np.linalg.norm(squeezed[:, :3], axis=1),
        aspect=float(np.exp(aspect.change)) if aspect is not None else 1.0,
    )


def _free_focal(
    sample: Sample, rig: CameraRig, matches: Matches, config: Config
) -> FreeFocal | None:
    """Return the rig with free focal lengths, None where nothing more can be said.

    That is where each was estimated by itself, and where nothing goes with free ones.
    """
    groups = shared_intrinsics(rig.cameras, config.intrinsics)
    estimated = any(isinstance(camera, EstimatedCamera) for camera in rig.cameras)
    if estimated and len(np.unique(groups)) == len(rig.cameras):
        return None
    try:
        return free_focal_lengths(sample, rig, matches, config)
    except DegenerateError:
        return None


def _free_aspect(
    sample: Sample, rig: CameraRig, matches: Matches, config: Config
) -> FreeAspect | None:
    """Return the rig with a free aspect of all images, None where nothing goes with it."""
    try:
        return free_aspect(sample, rig, matches, config)
    except DegenerateError:
        return None


def given_change(rig: CameraRig, free: FreeFocal | FreeAspect, config: UncertaintyConfig) -> Floats:
    """Return by how much `[view, 6]` cameras may be off because of intrinsics held fixed.

    What the rig changes by when they are free, less what right ones change by: chance, and what is
    wrong with detections beside it. Of the mean square of the changes of focal length or of aspect,
    in standard deviations of both, that is 1. Efron and Morris 1973: "Stein's Estimation Rule and
    Its Competitors", the positive-part rule. Those of stated uncertainty are known as well.
    """
    usual = np.hypot(free.sigma, config.focal_systematic)
    given = np.array([not isinstance(camera, EstimatedCamera) for camera in rig.cameras])
    stated = given & np.isfinite(focal_sigmas(rig.cameras, config))
    significance = float(np.where(stated, 0.0, (free.change / usual) ** 2).mean())
    beyond_usual = max(0.0, 1 - 1 / max(significance, 1e-12))
    return np.sqrt(beyond_usual) * rig_change(rig, free.rig)


def uncertain_focal_changes(
    sample: Sample, rig: CameraRig, matches: Matches, config: Config
) -> Floats:
    """Return by how much `[change, view, 6]` cameras may be off by what focal lengths may be.

    What the rig changes by when focal lengths that were estimated together, or one of stated
    uncertainty, become longer by a standard deviation and the rig is adjusted again.
    """
    sigma = np.nan_to_num(focal_sigmas(rig.cameras, config.uncertainty))
    estimated = np.array([isinstance(camera, EstimatedCamera) for camera in rig.cameras])
    kind = shared_intrinsics(rig.cameras, config.intrinsics)
    kind = np.where(estimated, kind, -1 - np.arange(len(rig)))  # each was calibrated by itself
    # cameras whose focal lengths are one estimate have one sigma
    _, group = np.unique(np.stack([kind, sigma.round(9)]), axis=1, return_inverse=True)
    changes = []
    for number in np.unique(group[sigma > 0]):
        longer = np.where(group == number, sigma, 0.0)
        cameras = tuple(
            change_intrinsics(camera, log_focal=change, k1=0.0)
            for camera, change in zip(rig.cameras, longer, strict=True)
        )
        changed = replace(rig, cameras=cameras)
        try:
            found = adjust_once(with_cameras(sample, cameras), changed, matches, config)
            changes.append(rig_change(rig, found))
        except DegenerateError:  # nothing goes with these: as much as can be
            nothing = RigCovariance.unknown(len(cameras), rig_size(rig)).matrix
            changes.append(np.sqrt(np.einsum("vivi->vi", nothing)))
    return np.array(changes).reshape(-1, len(rig.cameras), POSE)


# --- whether bodies are seen in the mirror


def agreement_of_depths(
    observed: Observed, rig: CameraRig, matches: Matches, poses: Poses3D
) -> Floats:
    """Return the correlations `[view, frame]` of predicted and of triangulated depths of joints.

    Of the detections of a frame of the sample together, about the mean of each; NaN = none.
    matches: of the sample.
    """
    sample, labels = observed.sample, matches.labels
    known = np.flatnonzero(sample.vocabulary >= 0)
    points = mapped.take(poses.raw, observed.sample_frames)[:, :, known]
    found = np.full(labels.shape[:2], np.nan)
    for view, axis in enumerate(rig.rotation[:, 2]):
        frame, instance = np.nonzero(labels[view] >= 0)
        depth = points[frame, labels[view, frame, instance]] @ axis
        lifted = observed.lifted.body[view, frame, instance][:, sample.vocabulary[known], 2]
        both = np.isfinite(depth + lifted)
        depth, lifted = (_about_mean(values, both) for values in (depth, lifted))
        sums = [(depth * lifted).sum(1), (depth**2).sum(1), (lifted**2).sum(1)]
        count = len(found[view])
        product, *squares = (np.bincount(frame, each, minlength=count) for each in sums)
        some = np.minimum(*squares) > 0
        found[view, some] = (product / np.sqrt(np.maximum(squares[0] * squares[1], 1e-300)))[some]
    return found


def _about_mean(values: Floats, known: Bools) -> Floats:
    """Return values `[N, joint]` less the mean of those known, 0 where not known."""
    mean = np.where(known, values, 0.0).sum(1) / np.maximum(known.sum(1), 1)
    return np.where(known, values - mean[:, None], 0.0)


def mirror_nats(agreement: Floats, config: UncertaintyConfig) -> float:
    """Return the log evidence (nats) that bodies are seen in the mirror; NaN where none is known.

    agreement: `[view, frame]` correlations, negative in the mirror. That their mean is no chance,
    given its spread over stretches of time (Vuong 1989), in which errors of depths go together.
    """
    frames = agreement[:, np.isfinite(agreement).any(0)]
    if frames.shape[1] < 2:
        return float("nan")
    stretches = np.array_split(frames, min(config.time_blocks, frames.shape[1]), axis=1)
    means = np.array([np.nanmean(part) for part in stretches])
    mean, variance = float(means.mean()), float(means.var(ddof=1))
    return -mean * abs(mean) * len(means) / max(2 * variance, 1e-12)


# --- which focal lengths that were given are wrong


def find_wrong_focal(change: Floats, sigma: Floats, config: Config) -> Bools:
    """Return the cameras `[view]` whose focal lengths are certainly other than was given.

    What was given is an observation like others, wrong where it is an outlier: by a change that is
    certain by itself, and by changes of all cameras alike, which are less uncertain together. At 3
    standard deviations in place of 4, sound cameras were named in seven damaged copies of shelf.

    change, sigma: `[view]` of their logarithms, as of `FreeFocal`; NaN = not known.
    """
    uncertain = np.hypot(sigma, config.uncertainty.focal_systematic / 2)
    certain = np.abs(change) > config.triangulate.outlier * uncertain
    return np.asarray(certain | _all_change_alike(change, sigma, config))


def _all_change_alike(change: Floats, sigma: Floats, config: Config) -> Bools:
    """Return where a camera `[view]` has a wrong focal length as all others have, or none.

    The mean of the changes weighed by their certainty is that of one focal length that the cameras
    share, and nearly as certain.
    """
    weight, systematic = 1 / sigma**2, config.uncertainty.focal_systematic
    mean = float((change * weight).sum() / weight.sum())  # NaN where a change is not known
    uncertain = float(np.hypot(np.sqrt(1 / weight.sum()), systematic / 2))
    apart = np.abs(change - mean) > 2 * np.hypot(sigma, systematic)
    certain = abs(mean) >= config.triangulate.outlier * uncertain
    alike = len(change) >= 3 and certain and not apart.any()
    return np.asarray(alike & (np.sign(mean) * change > sigma))
