"""Tell whether what was seen determines the rig, and whether all cameras agree on it.

Reprojection errors are small also where nothing is determined: where a subject is small in the
image and stands still, all frames share the errors of its joints (of the detector, of the lens
model), and the rig bends to fit them. Two halves of the joints share the cameras but not these
errors: the rig is adjusted to each, and the angle between the two rigs is an estimate of the
rig's error. One split may agree by chance, so several are made.

Errors that both halves share do not show there: those of a camera that is out of step, was moved,
or has other intrinsics than given. Its reprojection errors are several times those of the others.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np

from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import Config, UncertaintyConfig
from mocap_calib.errors import DegenerateError, UnderconstrainedCameraError
from mocap_calib.geometry.lens import change_intrinsics
from mocap_calib.geometry.rotation import angle_between
from mocap_calib.multi_view.bundle_adjustment import adjust
from mocap_calib.multi_view.fit import find_outlier_cameras, find_weak_perspective, measure_fit
from mocap_calib.multi_view.intrinsics import check_focal_lengths, shared_intrinsics
from mocap_calib.multi_view.wrong_focal import find_wrong_focal
from mocap_calib.recording.sampling import with_cameras
from mocap_calib.types import (
    Bools,
    Camera,
    CameraRig,
    EstimatedCamera,
    Floats,
    Ints,
    Matches,
    Sample,
    Uncertainty,
    Verdict,
)


def assess_uncertainty(
    sample: Sample, rig: CameraRig, matches: Matches, config: Config, *, seed: int
) -> Uncertainty:
    """Return how well the sample determines the rig, and which cameras stand out."""
    fit = measure_fit(sample, rig, matches, config)
    focal_change, focal_sigma = _free_focal_lengths(sample, rig, matches, config)
    return Uncertainty(
        split_half_angle=split_half_angle(sample, rig, matches, config, seed=seed),
        outlier_cameras=find_outlier_cameras(fit, config.uncertainty),
        weak_perspective=find_weak_perspective(fit),
        intrinsics_angle=intrinsics_angle(sample, rig, matches, config),
        focal_change=focal_change,
        focal_sigma=focal_sigma,
        wrong_focal=find_wrong_focal(rig.cameras, focal_change, focal_sigma, config.uncertainty),
    )


def judge_rig(uncertainty: Uncertainty, config: UncertaintyConfig) -> Verdict:
    """Return what the uncertainty means for the rig: the verdict on the camera that is worst off.

    What counts for a camera is the median split-half angle of its pairs, and twice the angle that
    is due to estimated focal lengths: both are twice an error of the rig. No rig with an outlier
    camera, or a wrong focal length, is well determined.
    """
    outlier_cameras = uncertainty.outlier_cameras | uncertainty.wrong_focal
    twice_error = np.hypot(uncertainty.split_half_angle, 2 * uncertainty.intrinsics_angle)
    angle = angle_of_worst_camera(twice_error, len(outlier_cameras))
    worst = np.rad2deg(angle)
    mostly_outliers = 2 * outlier_cameras.sum() > len(outlier_cameras)
    if worst > config.weak_deg or mostly_outliers:
        return "not determined"
    if worst > config.well_determined_deg or outlier_cameras.any():
        return "weak"
    return "well determined"


def split_half_angle(
    sample: Sample, rig: CameraRig, matches: Matches, config: Config, *, seed: int
) -> Floats:
    """Return the angle `[pair]` in radians between rigs that are adjusted to halves of the joints.

    Of the relative rotation of each pair of cameras: RMS over several random splits, pi where a
    half does not constrain one of the two cameras.
    """
    splits = config.uncertainty.splits
    # what halves differ by is not chance: more points do not show it better
    points = config.adjust.points // splits
    fewer_points = replace(config, adjust=replace(config.adjust, points=points))
    work = partial(_rotations_from, rig=rig, matches=matches, config=fewer_points)
    halves = _split_halves(sample, splits, seed)
    rotations = np.stack(list(map_in_threads(work, halves)))  # [half, view, 3, 3]
    a, b = _pairs(len(rig.cameras))
    relative = rotations[:, b] @ np.swapaxes(rotations[:, a], -1, -2)
    first, second = relative[::2], relative[1::2]
    angle = np.nan_to_num(angle_between(first, second), nan=np.pi)  # [split, pair]
    return np.sqrt((angle**2).mean(0))


def _free_focal_lengths(
    sample: Sample, rig: CameraRig, matches: Matches, config: Config
) -> tuple[Floats, Floats]:
    """Return what `check_focal_lengths` does, NaN where focal lengths were not given."""
    unknown = np.full(len(rig.cameras), np.nan)
    if any(isinstance(camera, EstimatedCamera) for camera in rig.cameras):
        return unknown, unknown
    try:
        return check_focal_lengths(sample, rig, matches, config)
    except DegenerateError:
        return unknown, unknown


def intrinsics_angle(sample: Sample, rig: CameraRig, matches: Matches, config: Config) -> Floats:
    """Return the angle `[pair]` in radians that estimated focal lengths are uncertain by.

    Of the relative rotation of each pair of cameras, when focal lengths that were estimated
    together become longer by a standard deviation and the rig is adjusted again; RMS where
    several were estimated. It is 0 where they were given.
    """
    a, b = _pairs(len(rig.cameras))
    sigma = np.array([_log_focal_sigma(camera) for camera in rig.cameras])
    group = shared_intrinsics(rig.cameras, config.intrinsics)
    relative = rig.rotation[b] @ np.swapaxes(rig.rotation[a], -1, -2)
    square = np.zeros(len(a))
    for number in np.unique(group[sigma > 0]):
        log_focal = np.where(group == number, sigma, 0.0)
        rotation = _rotation_with_focal(sample, rig, matches, config, log_focal=log_focal)
        changed = rotation[b] @ np.swapaxes(rotation[a], -1, -2)
        square += np.nan_to_num(angle_between(relative, changed), nan=np.pi) ** 2
    return np.sqrt(square)


def _log_focal_sigma(camera: Camera) -> float:
    """Return the standard deviation of the logarithm of a focal length, 0 where it was given."""
    return camera.focal_sigma / camera.focal if isinstance(camera, EstimatedCamera) else 0.0


def _rotation_with_focal(
    sample: Sample, rig: CameraRig, matches: Matches, config: Config, *, log_focal: Floats
) -> Floats:
    """Return the rotations `[view, 3, 3]` of the rig with focal lengths changed by `[view]`.

    NaN where nothing goes with these.
    """
    cameras = tuple(
        change_intrinsics(camera, log_focal=change, k1=0.0)
        for camera, change in zip(rig.cameras, log_focal, strict=True)
    )
    changed = replace(rig, cameras=cameras)
    try:
        return adjust(with_cameras(sample, cameras), changed, matches, config).rotation
    except DegenerateError:
        return np.full_like(rig.rotation, np.nan)


def angle_of_worst_camera(angle: Floats, views: int) -> float:
    """Return the largest angle of a camera, which is the median of those of its pairs."""
    a, b = _pairs(views)
    medians = [np.median(angle[(a == view) | (b == view)]) for view in range(views)]
    return float(max(medians))


def _pairs(views: int) -> tuple[Ints, Ints]:
    """Return the first and the second view of all pairs, `[pair]` each."""
    a, b = np.array(list(combinations(range(views), 2))).T
    return a, b


def _split_halves(sample: Sample, splits: int, seed: int) -> Iterator[Sample]:
    """Return samples with one half of the joints and with the other, for random splits in turn."""
    rng = np.random.default_rng(seed)
    joints = np.arange(len(sample.keypoints))
    for _ in range(splits):
        shuffled = rng.permutation(len(joints))
        for half in (shuffled[::2], shuffled[1::2]):
            yield _with_joints(sample, np.isin(joints, half))


def _with_joints(sample: Sample, kept: Bools) -> Sample:
    """Return the sample with the detections of some keypoints (kept: `[keypoint]`) alone."""
    return replace(
        sample,
        positions=np.where(kept[:, None], sample.positions, np.nan),
        confidence=np.where(kept, sample.confidence, 0.0),
        rays=np.where(kept[:, None], sample.rays, np.nan),
    )


def _rotations_from(half: Sample, *, rig: CameraRig, matches: Matches, config: Config) -> Floats:
    """Return the rotations `[view, 3, 3]` of the rig adjusted to a part of the detections.

    NaN for cameras that this part does not constrain.
    """
    rotations = np.full_like(rig.rotation, np.nan)
    constrained = np.arange(len(rig.cameras))
    while len(constrained) >= 2:
        try:
            adjusted = adjust(
                half.select(views=constrained),
                rig.select(constrained),
                matches.select(views=constrained),
                config,
                already_close=True,
            )
        except UnderconstrainedCameraError as error:
            underconstrained = rig.names.index(error.camera)
            constrained = constrained[constrained != underconstrained]
        except DegenerateError:
            break
        else:
            rotations[constrained] = adjusted.rotation
            break
    return rotations
