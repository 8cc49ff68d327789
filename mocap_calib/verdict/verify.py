"""Compare a given calibration with the keypoints of moving subjects.

Match by the given rig -> search for the cameras that match nothing -> adjust from the given rig ->
compare the two rigs -> refit the cameras that moved, in the given coordinates.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from mocap_calib.adjust.camera_fit import (
    CameraFit,
    CameraPose,
    place_points,
    refit_camera,
    typical_error,
)
from mocap_calib.adjust.refine import adjust_until_stable
from mocap_calib.adjust.resection import find_lost_camera
from mocap_calib.adjust.rig_covariance import cautious_covariances, covariance_of, fit_again
from mocap_calib.clocks.estimate import estimate_clocks
from mocap_calib.compute.parallel import single_threaded_libraries
from mocap_calib.config import VERDICT_LIMITS_DEG, Config
from mocap_calib.errors import DegenerateError, UnderconstrainedCameraError
from mocap_calib.geometry.alignment import rig_size
from mocap_calib.geometry.lens import change_intrinsics
from mocap_calib.geometry.rotation import angle_between
from mocap_calib.io.provenance import judgement, round_sigma
from mocap_calib.lift.lift import RememberedLift
from mocap_calib.lift.lifter import AUTO, Lifter, choose_model
from mocap_calib.recording.sampling import choose_sample_frames, take_sample
from mocap_calib.recording.synchronise import hide_blind_spots
from mocap_calib.recording.timeline import clocks_from, clocks_of_rates, retime
from mocap_calib.results import (
    Adjusted,
    Clocks,
    LiftedPoses,
    Matches,
    PlaceWord,
    Verification,
    VerifiedCamera,
)
from mocap_calib.rig.associate import associate
from mocap_calib.rig.observed import PlacedCameras
from mocap_calib.rig.tracks import matched_share
from mocap_calib.rig.triangulate import check_same_cameras
from mocap_calib.training import on_device
from mocap_calib.types import (
    Bools,
    Camera,
    CameraRig,
    Floats,
    Ints,
    Progress,
    Recording,
    Sample,
    silent,
)
from mocap_calib.verdict.rig_changes import (
    RigChange,
    assess_calibration,
    describe_refits,
    explain_cameras,
    find_changes,
)


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
    """Compare a calibration with the keypoints of a recording, and name the cameras that moved.

    rig: the calibration, anyone's, in any unit and any coordinates, of the recording's cameras in
        their order. The other arguments are those of `calibrate`.

    Identities need not be known. Clocks that differ are corrected first, as `config.sync` says.
    Of two cameras it is not known which one moved: both are named.

    Raises MismatchError where rig and recording have other cameras, DegenerateError where not most
    cameras of the rig, two at least, agree on any subject, and what `calibrate` raises of model and
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
        cameras = estimate_clocks(recording, lift_sample, rotations, config, seed=seed)
        applied = config.sync.mode != "check"
        clocks = (clocks_from if applied else Clocks.of_one)(recording, cameras)
        recording = hide_blind_spots(retime(recording, clocks))
        sample = take_sample(recording, choose_sample_frames(recording, config.sample))
        lifted = lift_sample(sample)
        found = verify_rig(sample, lifted, rig, config, progress=progress)
    return replace(found, clocks=clocks.after(said))


def verify_rig(
    sample: Sample,
    lifted: LiftedPoses,
    rig: CameraRig,
    config: Config,
    *,
    progress: Progress,
) -> Verification:
    """Return how far a rig agrees with a sample of a recording. Raises as `verify` does."""
    enough = _have_detections(sample, config)
    views, adjusted = _adjust_from(sample, lifted, rig, enough, config, progress=progress)
    part, given = sample.select(views=views), rig.select(views)
    fitted = fit_again(part, adjusted.rig, adjusted.matches, config)
    change = find_changes(given, adjusted.rig, cautious_covariances(fitted, config), config)
    covariance = covariance_of(fitted, config)
    placed = PlacedCameras.of(part, adjusted.rig, adjusted.matches, config)
    placed = replace(placed, rig=given)
    mended = _refit(part, placed, change, config)
    checked = {each.name: each for each in _compare(part, placed, mended, change, config)}
    # cameras that contradict each other do not show that another one is inconsistent
    known = sum(camera.word != "not checked" for camera in checked.values()) >= 2
    cameras = tuple(
        checked.get(name)
        or VerifiedCamera(name, "inconsistent" if known and seen else "not checked")
        for name, seen in zip(rig.names, enough.tolist(), strict=True)
    )
    verdict = assess_calibration(cameras, change, covariance, given.names, config)
    errors = [camera.refitted_px for camera in checked.values() if camera.refitted_px < np.inf]
    said = judgement(
        verdict.word,
        [*describe_refits(cameras), *verdict.reasons],
        float(np.mean(errors)) if errors else None,
        rotation_sigma_deg=_by_name(given, np.rad2deg(covariance.rotation_sigma)),
        centre_sigma_percent=_by_name(given, 100 * covariance.centre_sigma),
    )
    for place, view in enumerate(views.tolist()):
        pose = CameraPose(mended.rotation[place], mended.translation[place])
        rig = _with_camera(rig, view, mended.cameras[place], pose)
    return Verification(
        cameras=cameras,
        verdict=verdict.word,
        reasons=(*explain_cameras(cameras), *verdict.reasons),
        rig=rig,
        clocks=Clocks.of_one(sample),
        provenance=said,
    )


def _by_name(rig: CameraRig, values: Floats) -> dict[str, float]:
    """Return standard deviations `[view]` by the names of the cameras, as files have them."""
    return {name: round_sigma(value) for name, value in zip(rig.names, values, strict=True)}


# --- the rig as the keypoints have it


def _have_detections(sample: Sample, config: Config) -> Bools:
    """Return the views `[view]` with enough detections, in frames of two others, to be placed."""
    sees = sample.detected.any(2)
    with_others = sample.detected.sum(2) * (sees.sum(0) - sees >= 2)
    return np.asarray(with_others.sum(1) >= config.moved.least_detections)


def _adjust_from(
    sample: Sample,
    lifted: LiftedPoses,
    rig: CameraRig,
    enough: Bools,
    config: Config,
    *,
    progress: Progress,
) -> tuple[Ints, Adjusted]:
    """Return the rig adjusted to the sample from the given one, and its views (indices).

    Cameras that match nothing are searched for first. Raises as `verify` does: where not two
    cameras are left, and most of those with enough detections (`[view]`), it is another calibration
    and no camera of it is to blame.
    """
    matches = associate(sample, lifted, rig, config, progress=progress)
    start, kept = _find_lost_cameras(sample, rig, matches, config)
    while len(kept) > max(1, np.delete(enough, kept).sum()):
        part, bodies, known = sample.select(views=kept), lifted.select(kept), start.select(kept)
        try:
            matches = associate(part, bodies, known, config, progress=progress)
            return kept, adjust_until_stable(
                part, known, matches, config, lifted=bodies, progress=progress
            )
        except UnderconstrainedCameraError as error:
            kept = kept[kept != rig.names.index(error.camera)]
        except DegenerateError:
            break
    raise DegenerateError(
        "expected a calibration most of whose cameras agree on somebody, found another; "
        "check that the keypoints belong to it, or calibrate anew: `mocap-calib run`"
    )


def _find_lost_cameras(
    sample: Sample, rig: CameraRig, matches: Matches, config: Config
) -> tuple[CameraRig, Ints]:
    """Return the rig with cameras that match nothing where they may be, and the views found.

    Lost are those of whose detections far fewer match than is usual.
    """
    share = matched_share(sample, matches)
    usual = [np.median(np.delete(share, view)) for view in range(len(share))]
    lost = share < config.verify.least_matched * np.array(usual)
    if not lost.any() or (~lost).sum() < 2:
        return rig, np.arange(len(rig))
    labels = np.where(lost[:, None, None], -1, matches.labels)
    placed, found = PlacedCameras.of(sample, rig, Matches(labels), config), ~lost
    for view in np.flatnonzero(lost).tolist():
        pose = find_lost_camera(sample, placed, view, config)
        if pose is not None:
            rig, found[view] = _with_camera(rig, view, rig.cameras[view], pose), True
    return rig, np.flatnonzero(found)


# --- where the cameras that moved are now


def _refit(sample: Sample, placed: PlacedCameras, change: RigChange, config: Config) -> CameraRig:
    """Return the given rig with the moved cameras where they are now, by the others as given.

    With another focal length where that explains the move. Of two cameras it is not known where
    they are.
    """
    rig, in_place = placed.rig, np.flatnonzero(~change.moved)
    if not change.moved.any() or len(in_place) < 2:
        return rig
    known = place_points(sample, placed, in_place, config)
    for view in np.flatnonzero(change.moved).tolist():
        noise = float(placed.noise[view])
        seen = known.seen_by(view, config.diagnosis.keypoints)
        if len(seen.points) < config.adjust.least_keypoints:
            continue
        plain, free = refit_camera(seen, change.refitted, view, noise=noise, config=config)
        focal = _is_focal(plain, free, placed.rig, view, config)
        log_focal = float(free.unknowns[0]) if focal else 0.0
        camera = change_intrinsics(rig.cameras[view], log_focal=log_focal, k1=0.0)
        start = CameraPose(change.refitted.rotation[view], change.refitted.translation[view])
        pose = (free if focal else plain).pose
        turn = np.rad2deg(angle_between(pose.rotation, start.rotation))
        # a telescope sees the same from the opposite side (Necker's cube): the rig of all does not
        pose = pose if turn < VERDICT_LIMITS_DEG[2] else start
        rig = _with_camera(rig, view, camera, pose)
    return rig


def _is_focal(
    plain: CameraFit, free: CameraFit, given: CameraRig, view: int, config: Config
) -> bool:
    """Return whether another focal length explains what looks like a move."""
    settings = config.uncertainty
    uncertain = np.hypot(np.sqrt(free.covariance[0, 0]), settings.focal_systematic / 2)
    certain = abs(free.unknowns[0]) > settings.focal_significance * uncertain
    turns, shifts = zip(*(_move_of(fit.pose, given, view) for fit in (free, plain)), strict=True)
    distance = np.hypot(turns, np.array(shifts) / rig_size(given))
    return bool(certain and distance[0] < distance[1] / 2)


def _move_of(pose: CameraPose, given: CameraRig, view: int) -> tuple[float, float]:
    """Return the turn in radians and the shift in the unit of the rig."""
    centre = -pose.rotation.T @ pose.translation
    shift = float(np.linalg.norm(centre - given.centres[view]))
    return float(angle_between(pose.rotation, given.rotation[view])), shift


def _with_camera(rig: CameraRig, view: int, camera: Camera, pose: CameraPose) -> CameraRig:
    """Return the rig with one camera elsewhere."""
    rotation, translation = rig.rotation.copy(), rig.translation.copy()
    rotation[view], translation[view] = pose.rotation, pose.translation
    cameras = (*rig.cameras[:view], camera, *rig.cameras[view + 1 :])
    return replace(rig, cameras=cameras, rotation=rotation, translation=translation)


# --- records


def _compare(
    sample: Sample,
    placed: PlacedCameras,
    mended: CameraRig,
    change: RigChange,
    config: Config,
) -> Iterator[VerifiedCamera]:
    """Yield how each camera of the adjusted rig differs from the given one."""
    given = placed.rig
    size, views = rig_size(given), np.arange(len(given))
    focal = [
        float(np.log(now.focal / before.focal))
        for now, before in zip(mended.cameras, given.cameras, strict=True)
    ]
    for view, name in enumerate(given.names):
        others = views[views != view] if len(views) > 2 else views
        known = place_points(sample, replace(placed, rig=mended), others, config)
        (turn, shift), (turn_sigma, shift_sigma) = (
            each[view].tolist() for each in (change.size, change.sigma)
        )
        shift *= size
        if change.moved[view] and (~change.moved).sum() >= 2:
            pose = CameraPose(mended.rotation[view], mended.translation[view])
            turn, shift = _move_of(pose, given, view)
        moved: PlaceWord = "focal" if focal[view] else "moved"
        told = np.rad2deg(turn_sigma) < VERDICT_LIMITS_DEG[2]
        stays: PlaceWord = "in place" if told else "not checked"
        yield VerifiedCamera(
            name=name,
            word=moved if change.moved[view] else stays,
            turn=turn,
            turn_sigma=turn_sigma,
            shift=shift,
            shift_sigma=shift_sigma * size,
            relative_shift=shift / size,
            focal_change=focal[view],
            error_px=typical_error(known, given, view, config),
            refitted_px=typical_error(known, mended, view, config),
        )
