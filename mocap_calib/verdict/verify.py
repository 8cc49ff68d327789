"""Compare a given calibration with the keypoints of moving subjects.

Match by the given rig -> search for the cameras that match nothing -> adjust from the given rig ->
compare the two rigs -> refit the cameras that moved, in the given coordinates.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from mocap_calib.adjust.camera_fit import pose_of
from mocap_calib.adjust.covariance import cautious_covariances, covariance_of, fit_again
from mocap_calib.adjust.refine import adjust_until_stable
from mocap_calib.adjust.resection import find_lost_camera
from mocap_calib.clocks.estimate import clocks_from, clocks_of_rates, estimate_clocks, retime
from mocap_calib.compute.parallel import single_threaded_libraries
from mocap_calib.config import VERDICT_LIMITS_DEG, Config
from mocap_calib.errors import DegenerateError, UnderconstrainedCameraError, spell_as_option
from mocap_calib.geometry.lens import change_intrinsics, pixels_from_points
from mocap_calib.geometry.rotation import rig_size
from mocap_calib.io.provenance import judgement, round_sigma
from mocap_calib.lift import RememberedLift
from mocap_calib.lift.lifter import AUTO, Lifter, choose_model
from mocap_calib.recording.sampling import choose_sample_frames, evenly_spaced, take_sample
from mocap_calib.results import (
    Adjusted,
    Cause,
    Clocks,
    LiftedPoses,
    Matches,
    PlaceWord,
    RigCovariance,
    Verdict,
    Verification,
    VerifiedCamera,
)
from mocap_calib.rig import gather_tracks, labelled_frames, matched_share
from mocap_calib.rig.associate import associate
from mocap_calib.rig.triangulate import PlacedCameras, check_same_cameras, place_bodies
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
from mocap_calib.verdict.checks import OPEN_DEG
from mocap_calib.verdict.evaluation import RigChange, find_changes
from mocap_calib.verdict.verdict import expected_error

Names = tuple[str, ...]

_CALIBRATE = "calibrate again"
_RECORD = "record longer, with subjects that move through the room"
# meaning and remedy of a camera's word; {move}, {change} and {camera} are filled in
_REASONS = {
    "moved": ("{camera} {move}", f"put it back, or {_CALIBRATE}"),
    "focal": (
        "{camera}: its focal length is {change} than given (zoom, or images of another size)",
        f"correct its intrinsics, or {_CALIBRATE}",
    ),
    "not checked": ("{camera}: it sees too little with the others to be checked", _RECORD),
}


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
        recording = retime(recording, clocks)
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
    sees = sample.detected.any(2)
    with_others = sample.detected.sum(2) * (sees.sum(0) - sees >= 2)
    enough = with_others.sum(1) >= config.moved.least_detections  # [view] may be placed by others
    views, adjusted = _adjust_from(sample, lifted, rig, enough, config, progress=progress)
    part, given = sample.select(views=views), rig.select(views)
    fitted = fit_again(part, adjusted.rig, adjusted.matches, config)
    covariance = covariance_of(fitted, config)
    change = find_changes(given, adjusted.rig, cautious_covariances(fitted, config), config)
    placed = PlacedCameras.of(part, adjusted.rig, adjusted.matches, config)
    compared, refitted = _compare(part, replace(placed, rig=given), change, config)
    checked = {each.name: each for each in compared}
    # cameras that contradict each other do not show that another one is inconsistent
    known = sum(camera.word != "not checked" for camera in checked.values()) >= 2
    cameras = tuple(
        checked.get(name)
        or VerifiedCamera(name, "inconsistent" if known and seen else "not checked")
        for name, seen in zip(rig.names, enough.tolist(), strict=True)
    )
    verdict = assess_calibration(cameras, change, covariance, given.names)
    for place, view in enumerate(views.tolist()):
        rig = _with_camera(rig, view, refitted.cameras[place], pose_of(refitted, place))
    return Verification(
        cameras=cameras,
        verdict=verdict.word,
        reasons=(*explain_cameras(cameras), *verdict.reasons),
        rig=rig,
        clocks=Clocks.of_one(sample),
        provenance=_provenance(cameras, verdict, given.names, covariance),
    )


# --- the rig as the keypoints have it


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
        "",
        "a calibration most of whose cameras agree on somebody",
        "another",
        "check that the keypoints belong to it, or calibrate anew: `mocap-calib run`",
    )


def _find_lost_cameras(
    sample: Sample, rig: CameraRig, matches: Matches, config: Config
) -> tuple[CameraRig, Ints]:
    """Return the rig with cameras that match nothing where they may be, and the views found.

    Lost are those of whose detections far fewer match than is usual.
    """
    share = matched_share(sample, matches)
    usual = np.array([np.median(np.delete(share, view)) for view in range(len(share))])
    lost = share < config.diagnosis.least_matched * usual
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


def _compare(
    sample: Sample, placed: PlacedCameras, change: RigChange, config: Config
) -> tuple[list[VerifiedCamera], CameraRig]:
    """Return how each camera of the given rig differs from it, and the rig as the cameras are now.

    Moved cameras are where the adjustment has them, or where they were given with another focal
    length, if their images fit that as well. Of two cameras it is not known where they are.
    """
    given, cameras = placed.rig, []
    size, moved = rig_size(given), change.moved & (len(given) > 2)
    determined = np.rad2deg(change.sigma[:, 0]) < VERDICT_LIMITS_DEG[2]
    now = given
    for view in np.flatnonzero(moved).tolist():
        now = _with_camera(now, view, given.cameras[view], pose_of(change.refitted, view))
    by_moves = now
    frames = evenly_spaced(labelled_frames(placed.matches), config.diagnosis.frames)
    seen = gather_tracks(sample, placed.matches, frames)
    # rays may miss points by as much as in an adjustment: the rig may be a little off for all
    outlier = config.adjust.outlier
    loose = replace(config, triangulate=replace(config.triangulate, outlier=outlier))
    for view, name in enumerate(given.names):
        without, by_others = (view if len(given) > 2 else None), replace(placed, rig=by_moves)
        bodies = place_bodies(sample, by_others, frames, loose, seen=seen, without=without)
        points, pixels = bodies.reshape(-1, 3), seen.pixels[view].T
        both = np.isfinite(points[:, 0]) & np.isfinite(pixels[:, 0])
        known = points[both], pixels[both]
        word: PlaceWord = "in place" if determined[view] else "not checked"
        focal, error = 0.0, _median_error(*known, by_moves, view)
        if change.moved[view]:
            word = "moved"
        if moved[view]:
            camera = _zoomed(*known, given, view)
            zoomed = _with_camera(now, view, camera, pose_of(given, view))
            other = _median_error(*known, zoomed, view)
            if other <= config.uncertainty.same_misfit * error:
                word, now, error = "focal", zoomed, other
                focal = float(np.log(camera.focal / given.cameras[view].focal))
        (turn, shift), (turn_sigma, shift_sigma) = (change.size[view], change.sigma[view])
        camera_found = VerifiedCamera(
            name=name,
            word=word,
            turn=float(turn),
            turn_sigma=float(turn_sigma),
            shift=float(shift * size),
            shift_sigma=float(shift_sigma * size),
            relative_shift=float(shift),
            focal_change=focal,
            error_px=_median_error(*known, given, view),
            refitted_px=error,
        )
        cameras.append(camera_found)
    return cameras, now


def _median_error(points: Floats, pixels: Floats, rig: CameraRig, view: int) -> float:
    """Return the median reprojection error of a view in pixels, NaN where it saw nothing."""
    seen = pixels_from_points(
        rig.cameras[view], points @ rig.rotation[view].T + rig.translation[view]
    )
    error = np.linalg.norm(seen - pixels, axis=1)
    return float(np.median(np.nan_to_num(error, nan=np.inf))) if len(error) else float("nan")


def _zoomed(points: Floats, pixels: Floats, rig: CameraRig, view: int) -> Camera:
    """Return the camera with the focal length that fits known points best where the camera is.

    By how much farther from the principal point they are in the image: the median of the outer
    half, of which the errors matter least.
    """
    camera, in_camera = rig.cameras[view], points @ rig.rotation[view].T + rig.translation[view]
    middle = camera.matrix[:2, 2]
    expected, found = pixels_from_points(camera, in_camera) - middle, pixels - middle
    square = np.nan_to_num((expected**2).sum(1))
    if not square.any():
        return camera
    outer = square >= np.median(square[square > 0])
    factor = np.median(np.abs((expected * found).sum(1)[outer] / square[outer]))
    return change_intrinsics(camera, log_focal=float(np.log(factor)), k1=0.0)


def _with_camera(rig: CameraRig, view: int, camera: Camera, pose: Floats) -> CameraRig:
    """Return the rig with one camera elsewhere, at a pose `[3, 4]`."""
    rotation, translation = rig.rotation.copy(), rig.translation.copy()
    rotation[view], translation[view] = pose[:, :3], pose[:, 3]
    cameras = (*rig.cameras[:view], camera, *rig.cameras[view + 1 :])
    return replace(rig, cameras=cameras, rotation=rotation, translation=translation)


# --- verdict and words


def assess_calibration(
    cameras: Sequence[VerifiedCamera], change: RigChange, covariance: RigCovariance, names: Names
) -> Verdict:
    """Return the verdict on a calibration with the moved cameras where they are now.

    Each camera is as uncertain as the keypoints leave it, and as far off as they have it elsewhere.
    names: of the views of the change and of the covariance.
    """
    uncertain = np.rad2deg(covariance.rotation_sigma)
    refitted = change.moved & (len(names) > 2)  # of two it is not known where they are now
    apart = np.where(refitted, 0.0, np.rad2deg(change.difference))
    # keypoints that determine nothing give no better calibration
    remedy = _CALIBRATE if uncertain.max() <= VERDICT_LIMITS_DEG[1] else _RECORD
    causes = []
    for view, name in enumerate(names):
        meaning = f"{name}: the keypoints determine its rotation to +-{uncertain[view]:.1f} deg"
        causes.append(Cause("covariance", name, float(uncertain[view]), meaning, _RECORD))
        meaning = f"{name}: {apart[view]:.1f} deg from where the keypoints have it"
        causes.append(Cause("difference", name, float(apart[view]), meaning, remedy))
    for camera in cameras:
        if camera.word == "inconsistent":
            meaning = f"{camera.name}: nothing that it sees agrees with the others, at any pose"
            causes.append(Cause(camera.word, "", OPEN_DEG, meaning, "check its files and clock"))
    causes.sort(key=lambda cause: -cause.error_deg)
    return Verdict(expected_error(names, causes), tuple(causes))


def explain_cameras(cameras: Sequence[VerifiedCamera]) -> list[Cause]:
    """Return a reason for each camera that moved or was not checked."""
    if len(cameras) == 2 and all(camera.word == "moved" for camera in cameras):
        first, second = cameras
        meaning = (
            f"{first.name} or {second.name} moved, by {_deg(first)} deg against the other: two "
            "cameras do not show which"
        )
        return [Cause("moved", "", float(np.rad2deg(first.turn)), meaning, _CALIBRATE)]
    reasons = []
    for camera in cameras:
        change = float(np.expm1(camera.focal_change))
        text = f"{abs(change):.1%} {'longer' if change > 0 else 'shorter'}"
        if camera.word in _REASONS:
            meaning, remedy = _REASONS[camera.word]
            meaning = meaning.format(camera=camera.name, move=describe_move(camera), change=text)
            turn = float(np.rad2deg(camera.turn))
            reasons.append(Cause(camera.word, camera.name, turn, meaning, remedy))
    return reasons


def describe_move(camera: VerifiedCamera) -> str:
    """Return by how much a camera moved, for a person: `is turned by 2.1 +- 0.2 deg`.

    A turn or a shift of less than two standard deviations is none.
    """
    parts = []
    if camera.turn > 2 * camera.turn_sigma:
        parts.append(f"turned by {_deg(camera)} deg")
    if camera.shift > 2 * camera.shift_sigma:
        sigma = camera.relative_shift * camera.shift_sigma / camera.shift
        parts.append(f"shifted by {camera.relative_shift:.1%} +- {sigma:.1%} of the rig's size")
    return f"is {' and '.join(parts)}" if parts else "is elsewhere"


def _provenance(
    cameras: Sequence[VerifiedCamera], verdict: Verdict, names: Names, covariance: RigCovariance
) -> dict[str, Any]:
    """Return what the file of a corrected rig holds of its verdict.

    names: of the views of the covariance.
    """
    refits = [
        f"{camera.name}: refitted by keypoints; as given before it {describe_move(camera)}"
        for camera in cameras
        if camera.word in ("moved", "focal")
    ]
    errors = [camera.refitted_px for camera in cameras if camera.refitted_px < np.inf]
    sigmas = (np.rad2deg(covariance.rotation_sigma), 100 * covariance.centre_sigma)
    turns, shifts = (dict(zip(names, map(round_sigma, each), strict=True)) for each in sigmas)
    return judgement(
        verdict.word,
        [*refits, *(reason.render(spell_as_option) for reason in verdict.reasons)],
        float(np.mean(errors)) if errors else None,
        rotation_sigma_deg=turns,
        centre_sigma_percent=shifts,
    )


def _deg(camera: VerifiedCamera) -> str:
    """Return the turn of a camera and its standard deviation in degrees."""
    return f"{np.rad2deg(camera.turn):.2f} +- {np.rad2deg(camera.turn_sigma):.2f}"
