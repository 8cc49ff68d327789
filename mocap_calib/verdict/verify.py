"""Judge a calibration that was given by the keypoints of moving subjects.

match by the given rig -> find the cameras that match nobody -> adjust from the given rig ->
compare the two rigs -> refit the cameras that moved, in the given coordinates.
"""

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from mocap_calib.adjust.refine import adjust_until_stable
from mocap_calib.adjust.relocation import find_lost_camera
from mocap_calib.adjust.rig_covariance import cautious_covariances, covariance_of, fit_again
from mocap_calib.clocks.estimate import estimate_clocks
from mocap_calib.compute.parallel import single_threaded_libraries
from mocap_calib.config import Config
from mocap_calib.errors import DegenerateError, UnderconstrainedCameraError
from mocap_calib.lift.lift import RememberedLift
from mocap_calib.lift.lifter import Lifter
from mocap_calib.lift.weights import AUTO, choose_model
from mocap_calib.recording.retiming import clocks_of_rates, retime
from mocap_calib.recording.sampling import choose_sample_frames, take_sample
from mocap_calib.recording.synchronise import hide_blind_spots
from mocap_calib.results import Adjusted, Clocks, LiftedPoses, Matches, Verification
from mocap_calib.rig.associate import associate
from mocap_calib.rig.labels import matched_share
from mocap_calib.rig.placed import PlacedCameras
from mocap_calib.rig.triangulate import check_same_cameras
from mocap_calib.training.device import on_device
from mocap_calib.types import Bools, CameraRig, Ints, Progress, Recording, Sample, silent
from mocap_calib.verdict.rig_changes import find_changes
from mocap_calib.verdict.verified import SecondLook, describe_rig, has_detections


def verify(
    recording: Recording,
    rig: CameraRig,
    model: str | Path | Lifter = AUTO,
    config: Config = Config(),
    *,
    seed: int = 0,
    device: str = "cpu",
    progress: Progress | None = None,
) -> Verification:
    """Judge a calibration by the keypoints of a recording, and say which cameras moved since.

    rig: the calibration, anyone's, in any unit and any coordinates, of the recording's cameras in
        their order. The other arguments are those of `calibrate`.

    Identities need not be known. Clocks that differ are put in step first, as `config.sync` says.
    Of two cameras nobody can say which one moved: both are named.

    Raises MismatchError where rig and recording have other cameras, DegenerateError where not most
    cameras of the rig, two at least, agree on anybody, and what `calibrate` raises of model and
    device.
    """
    check_same_cameras(recording, rig)
    recording, lifter = choose_model(recording, model)
    lifter = on_device(lifter, device)
    progress = progress or silent
    lift_sample = RememberedLift(lifter, progress)
    with single_threaded_libraries():
        said = clocks_of_rates(recording, dict(config.sync.rates))
        recording = retime(recording, said)
        rotations = {(a, b): rig.relative(a, b)[0] for a, b in combinations(range(len(rig)), 2)}
        clocks = estimate_clocks(recording, lift_sample, rotations, config, seed=seed)
        if config.sync.mode == "check":
            clocks = Clocks.of_one(recording, clocks.cameras)
        recording = hide_blind_spots(retime(recording, clocks))
        sample = take_sample(recording, choose_sample_frames(recording, config.sample))
        lifted = lift_sample(sample)
        found = verify_rig(sample, lifted, rig, config, seed=seed, progress=progress)
    return replace(found, clocks=clocks.after(said))


def verify_rig(
    sample: Sample,
    lifted: LiftedPoses,
    rig: CameraRig,
    config: Config,
    *,
    seed: int,
    progress: Progress,
) -> Verification:
    """Return what a sample of a recording says of a rig. Raises as `verify` does."""
    look = _look_again(sample, lifted, rig, config, progress=progress)
    adjusted, matches = look.adjusted.rig, look.adjusted.matches
    fitted = fit_again(look.sample, adjusted, matches, config)
    covariances = cautious_covariances(fitted, config)
    change = find_changes(rig.select(look.views), adjusted, covariances, config)
    covariance = covariance_of(fitted, config, seed=seed)
    return describe_rig(sample, look, rig, change=change, covariance=covariance, config=config)


def _look_again(
    sample: Sample, lifted: LiftedPoses, rig: CameraRig, config: Config, *, progress: Progress
) -> SecondLook:
    """Return the rig as the sample has it: adjusted from the given one.

    Cameras that match nobody any more are first looked for. Raises as `verify` does.
    """
    matches = associate(sample, lifted, rig, config, progress=progress)
    start, kept = _find_lost_cameras(sample, rig, matches, config)
    while _are_most(kept, sample, config):
        part, bodies = sample.select(views=kept), lifted.select(kept)
        try:
            adjusted = _adjust(part, bodies, start.select(kept), config, progress)
        except UnderconstrainedCameraError as error:
            kept = kept[kept != rig.names.index(error.camera)]
        except DegenerateError:
            break
        else:
            return SecondLook(kept, part, adjusted)
    raise DegenerateError(
        "expected a calibration most of whose cameras agree on somebody, found another; "
        "check that the keypoints belong to it, or calibrate anew: `mocap-calib run`"
    )


def _are_most(kept: Ints, sample: Sample, config: Config) -> bool:
    """Return whether some views (indices) are two, and most of those that see somebody.

    Otherwise it is another calibration, and no camera of it is to blame.
    """
    lost = np.setdiff1d(np.arange(len(sample.cameras)), kept).tolist()
    contradicting = sum(has_detections(sample, view, config) for view in lost)
    return len(kept) >= 2 and len(kept) > contradicting


def _adjust(
    sample: Sample, lifted: LiftedPoses, rig: CameraRig, config: Config, progress: Progress
) -> Adjusted:
    """Return the rig adjusted to what it matches."""
    matches = associate(sample, lifted, rig, config, progress=progress)
    return adjust_until_stable(sample, rig, matches, config, lifted=lifted, progress=progress)


def _find_lost_cameras(
    sample: Sample, rig: CameraRig, matches: Matches, config: Config
) -> tuple[CameraRig, Ints]:
    """Return the rig with cameras that match nobody where they may stand, and the views found."""
    lost = _lost_cameras(sample, matches, config)
    if not lost.any() or (~lost).sum() < 2:
        return rig, np.arange(len(rig))
    labels = np.where(lost[:, None, None], -1, matches.labels)
    placed = PlacedCameras.of(sample, rig, Matches(labels), config)
    rotation, translation, found = rig.rotation.copy(), rig.translation.copy(), ~lost
    for view in np.flatnonzero(lost).tolist():
        pose = find_lost_camera(sample, placed, view, config)
        if pose is not None:
            rotation[view], translation[view], found[view] = pose.rotation, pose.translation, True
    return replace(rig, rotation=rotation, translation=translation), np.flatnonzero(found)


def _lost_cameras(sample: Sample, matches: Matches, config: Config) -> Bools:
    """Return the cameras `[view]` of whose detections far fewer match than is usual."""
    share = matched_share(sample, matches)
    usual = [np.median(np.delete(share, view)) for view in range(len(share))]
    return share < config.verify.least_matched * np.array(usual)
