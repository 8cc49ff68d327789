"""Tell how far the cameras of a rig may be off, and whether all of them agree.

Reprojection errors are small also where nothing is determined: where a subject is small in the
image and stands still, all frames share the errors of its joints (of the detector, of the lens
model), and the rig bends to fit them. The covariance of the rig knows of that. It does not know of
intrinsics that are wrong: the rig bends to these too. By how much it would bend back if focal
lengths were free tells what they may be to blame for.

What all cameras but one share does not show there: one that is out of step, was moved, or has
other intrinsics than given. Its reprojection errors are several times those of the others.
"""

from dataclasses import replace

import numpy as np

from mocap_calib.adjust.covariance import rig_covariance
from mocap_calib.adjust.intrinsics import FreeFocal, free_focal_lengths, shared_intrinsics
from mocap_calib.adjust.refine import (
    adjust_once,
    find_outlier_cameras,
    find_weak_perspective,
    measure_fit,
)
from mocap_calib.compute.parallel import single_threaded_libraries
from mocap_calib.config import Config, UncertaintyConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.lens import change_intrinsics
from mocap_calib.geometry.rotation import rig_change, rig_size
from mocap_calib.recording.sampling import with_cameras
from mocap_calib.results import Matches, RigCovariance, Uncertainty
from mocap_calib.rig import labelled_frames
from mocap_calib.types import POSE, Bools, CameraRig, EstimatedCamera, Floats, Sample


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
    off = estimated_focal_changes(sample, rig, matches, config)
    if free is not None:
        off = np.concatenate([off, given_focal_change(rig, free, config.uncertainty)[None]])
    change, sigma = np.full((2, len(rig.cameras)), np.nan)
    # what was estimated is not found to be wrong
    if free is not None and not any(isinstance(each, EstimatedCamera) for each in rig.cameras):
        change, sigma = free.change, free.sigma
    tells = len(labelled_frames(matches)) >= config.uncertainty.time_blocks
    return Uncertainty(
        covariance=covariance.with_changes(off),
        intrinsics_turn=np.sqrt((off[..., :3] ** 2).sum((0, 2))),
        outlier_cameras=find_outlier_cameras(fit, config.uncertainty) & tells,
        weak_perspective=find_weak_perspective(fit),
        focal_change=change,
        focal_sigma=sigma,
        wrong_focal=find_wrong_focal(change, sigma, config) & tells,
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


def given_focal_change(rig: CameraRig, free: FreeFocal, config: UncertaintyConfig) -> Floats:
    """Return by how much `[view, 6]` cameras may be off because of focal lengths held fixed.

    What the rig changes by when they are free, less what right ones change by: chance, and what is
    wrong with detections beside it. Of the mean square of the changes of focal length, in standard
    deviations of both, that is 1. Efron and Morris 1973: "Stein's Estimation Rule and Its
    Competitors", the positive-part rule.
    """
    usual = np.hypot(free.sigma, config.focal_systematic)
    significance = float(np.mean((free.change / usual) ** 2))
    beyond_usual = max(0.0, 1 - 1 / max(significance, 1e-12))
    return np.sqrt(beyond_usual) * rig_change(rig, free.rig)


def estimated_focal_changes(
    sample: Sample, rig: CameraRig, matches: Matches, config: Config
) -> Floats:
    """Return by how much `[change, view, 6]` cameras may be off because of estimated focal lengths.

    What the rig changes by when focal lengths that were estimated together become longer by a
    standard deviation and the rig is adjusted again; none where focal lengths were given.
    """
    sigma = np.array(
        [
            camera.focal_sigma / camera.focal if isinstance(camera, EstimatedCamera) else 0.0
            for camera in rig.cameras
        ]
    )
    kind = shared_intrinsics(rig.cameras, config.intrinsics)
    # cameras whose focal lengths are one estimate have one sigma
    _, group = np.unique(np.stack([kind, sigma.round(9)]), axis=1, return_inverse=True)
    changes = [
        _change_with_focal(sample, rig, matches, config, np.where(group == number, sigma, 0.0))
        for number in np.unique(group[sigma > 0])
    ]
    return np.array(changes).reshape(-1, len(rig.cameras), POSE)


def _change_with_focal(
    sample: Sample, rig: CameraRig, matches: Matches, config: Config, log_focal: Floats
) -> Floats:
    """Return how the rig changes `[view, 6]` with focal lengths changed by `[view]`.

    As much as can be where nothing goes with these.
    """
    cameras = tuple(
        change_intrinsics(camera, log_focal=change, k1=0.0)
        for camera, change in zip(rig.cameras, log_focal, strict=True)
    )
    changed = replace(rig, cameras=cameras)
    try:
        found = adjust_once(with_cameras(sample, cameras), changed, matches, config)
    except DegenerateError:
        nothing = RigCovariance.unknown(len(cameras), rig_size(rig)).matrix
        return np.sqrt(np.einsum("vivi->vi", nothing))
    return rig_change(rig, found)


# --- which focal lengths that were given are wrong


def find_wrong_focal(change: Floats, sigma: Floats, config: Config) -> Bools:
    """Return the cameras `[view]` whose focal lengths are certainly other than was given.

    By what they would change to if they were free: by a change that is certain by itself, and by
    changes of all cameras alike, which are less uncertain together.

    change, sigma: `[view]` of their logarithms, as of `FreeFocal`; NaN = not known.
    """
    uncertain = np.hypot(sigma, config.uncertainty.focal_systematic / 2)
    certain = np.abs(change) > config.intrinsics.significance * uncertain
    return np.asarray(certain | _all_change_alike(change, sigma, config))


def _all_change_alike(change: Floats, sigma: Floats, config: Config) -> Bools:
    """Return where a camera `[view]` has a wrong focal length as all others have, or none.

    The mean of the changes weighed by their certainty is that of one focal length that the cameras
    share, and nearly as certain.
    """
    none = np.zeros(len(change), dtype=bool)
    if len(change) < 3 or not np.isfinite(change).all():
        return none
    weight, systematic = 1 / sigma**2, config.uncertainty.focal_systematic
    mean = float((change * weight).sum() / weight.sum())
    uncertain = float(np.hypot(np.sqrt(1 / weight.sum()), systematic / 2))
    apart = np.abs(change - mean) > 2 * np.hypot(sigma, systematic)
    if apart.any() or abs(mean) < config.intrinsics.significance * uncertain:
        return none
    return np.asarray(np.sign(mean) * change > sigma)
