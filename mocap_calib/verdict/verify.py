"""Judge a given calibration by the keypoints of moving subjects.

Match by the given rig -> search for the cameras that match nothing -> adjust from the given rig ->
compare the two rigs -> refit the cameras that moved, in the given coordinates. The keypoints' own
rig is judged as that of a run; what the calibration differs from it by is one more cause.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from mocap_calib.adjust.camera_fit import pose_of
from mocap_calib.adjust.covariance import cautious_covariances, fit_again
from mocap_calib.adjust.refine import adjust_once, adjust_until_stable
from mocap_calib.adjust.resection import find_lost_camera
from mocap_calib.clocks.estimate import clocks_from, clocks_of_rates, estimate_clocks, retime
from mocap_calib.compute.parallel import single_threaded_libraries
from mocap_calib.config import Config
from mocap_calib.errors import DegenerateError, UnderconstrainedCameraError, spell_as_option
from mocap_calib.geometry.lens import change_intrinsics, pixels_from_points
from mocap_calib.geometry.rotation import angle_between, rig_size
from mocap_calib.io.provenance import judgement, round_sigma
from mocap_calib.lift import RememberedLift
from mocap_calib.lift.lifter import AUTO, Lifter, choose_model
from mocap_calib.recording.sampling import (
    choose_sample_frames,
    evenly_spaced,
    take_sample,
    with_cameras,
)
from mocap_calib.results import (
    VERDICTS,
    Adjusted,
    Cause,
    Clocks,
    GroupResult,
    LiftedPoses,
    Matches,
    PlaceWord,
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
from mocap_calib.verdict.evaluation import RigChange, find_changes, lay_over
from mocap_calib.verdict.verdict import conclude_without_pairs, expected_error, judge

_CALIBRATE = "calibrate again"
_RECORD = "record longer, with subjects that move through the room"
_Known = tuple[Floats, Floats]  # points `[N, 3]` and their pixels `[N, 2]` in a view
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
        found = verify_rig(sample, lifted, rig, config, clocks=clocks, progress=progress)
    return replace(found, clocks=clocks.after(said))


def verify_rig(
    sample: Sample,
    lifted: LiftedPoses,
    rig: CameraRig,
    config: Config,
    *,
    clocks: Clocks | None = None,
    progress: Progress,
) -> Verification:
    """Return how far a rig agrees with a sample of a recording. Raises as `verify` does.

    clocks: of the recording, by default one.
    """
    sees = sample.detected.any(2)
    with_others = sample.detected.sum(2) * (sees.sum(0) - sees >= 2)
    enough = with_others.sum(1) >= config.moved.least_detections  # [view] may be placed by others
    views, adjusted = _adjust_from(sample, lifted, rig, enough, config, progress=progress)
    part, given = sample.select(views=views), rig.select(views)
    fitted = fit_again(part, adjusted.rig, adjusted.matches, config)
    change = find_changes(given, adjusted.rig, cautious_covariances(fitted, config))
    now, moved = given, change.moved & (len(given) > 2)  # two do not show which one moved
    for view in np.flatnonzero(moved).tolist():
        now = _with_camera(now, view, given.cameras[view], pose_of(change.refitted, view))
    placed = PlacedCameras.of(part, adjusted.rig, adjusted.matches, config)
    known = _known_points(part, replace(placed, rig=now), config)
    now = _refocus(given, now, known, moved, config)
    lost = sorted({*np.array(rig.names)[enough].tolist()} - {*given.names})
    part, own = with_cameras(part, now.cameras), replace(adjusted.rig, cameras=now.cameras)
    adjusted = replace(adjusted, rig=adjust_once(part, own, adjusted.matches, config))
    bodies = lifted.select(views)
    result = conclude_without_pairs(part, bodies, adjusted.rig, adjusted, config)
    (group,) = judge(replace(result, clocks=clocks or result.clocks)).groups
    verdict = assess_calibration(group, now, lost)
    if verdict.word == VERDICTS[-1]:  # no camera is named
        now, lost = given, []
        change = replace(change, moved=np.zeros(len(given), dtype=bool))
    compared = _compare(given, now, known, change, verdict)
    cameras = tuple(
        compared.get(name)
        or VerifiedCamera(name, "inconsistent" if name in lost else "not checked")
        for name in rig.names
    )
    for place, view in enumerate(views.tolist()):
        rig = _with_camera(rig, view, now.cameras[place], pose_of(now, place))
    return Verification(
        cameras=cameras,
        assessment=verdict,
        reasons=(*explain_cameras(cameras), *verdict.reasons),
        rig=rig,
        clocks=Clocks.of_one(sample),
        provenance=_provenance(cameras, verdict, group),
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


def _known_points(sample: Sample, placed: PlacedCameras, config: Config) -> list[_Known]:
    """Return what each view sees, as the others place it; of two cameras, as both do."""
    frames = evenly_spaced(labelled_frames(placed.matches), config.diagnosis.frames)
    seen, known = gather_tracks(sample, placed.matches, frames), []
    for view in range(len(placed.rig)):
        without = view if len(placed.rig) > 2 else None
        bodies = place_bodies(sample, placed, frames, config, seen=seen, without=without)
        points, pixels = bodies.reshape(-1, 3), seen.pixels[view].T
        both = np.isfinite(points[:, 0]) & np.isfinite(pixels[:, 0])
        known.append((points[both], pixels[both]))
    return known


def _refocus(
    given: CameraRig, now: CameraRig, known: list[_Known], moved: Bools, config: Config
) -> CameraRig:
    """Return the rig as it is now, with other focal lengths where these explain what moves do.

    The pose of such a camera is the given one.
    """
    for view in np.flatnonzero(moved).tolist():
        camera = _zoomed(*known[view], given, view)
        zoomed = _with_camera(now, view, camera, pose_of(given, view))
        errors = [_median_error(*known[view], each, view) for each in (zoomed, now)]
        if errors[0] <= config.uncertainty.same_misfit * errors[1]:
            now = zoomed
    return now


def _compare(
    given: CameraRig,
    now: CameraRig,
    known: list[_Known],
    change: RigChange,
    verdict: Verdict,
) -> dict[str, VerifiedCamera]:
    """Return how each camera of the given rig differs from it, by its name.

    known: as of `_known_points`.
    """
    in_place: PlaceWord = "in place" if verdict.word != VERDICTS[-1] else "not checked"
    size, found = rig_size(given), {}
    for view, name in enumerate(given.names):
        focal = float(np.log(now.cameras[view].focal / given.cameras[view].focal))
        (turn, shift), (turn_sigma, shift_sigma) = (change.size[view], change.sigma[view])
        found[name] = VerifiedCamera(
            name=name,
            word="focal" if focal else "moved" if change.moved[view] else in_place,
            turn=float(turn),
            turn_sigma=float(turn_sigma),
            shift=float(shift * size),
            shift_sigma=float(shift_sigma * size),
            relative_shift=float(shift),
            focal_change=focal,
            error_px=_median_error(*known[view], given, view),
            refitted_px=_median_error(*known[view], now, view),
        )
    return found


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
    seen = pixels_from_points(camera, in_camera)
    expected, found = np.linalg.norm(np.stack([seen, pixels]) - camera.matrix[:2, 2], axis=2)
    factor = (found / expected)[expected >= np.nanmedian(expected)]
    return change_intrinsics(camera, log_focal=float(np.log(np.median(factor))), k1=0.0)


def _with_camera(rig: CameraRig, view: int, camera: Camera, pose: Floats) -> CameraRig:
    """Return the rig with one camera elsewhere, at a pose `[3, 4]`."""
    rotation, translation = rig.rotation.copy(), rig.translation.copy()
    rotation[view], translation[view] = pose[:, :3], pose[:, 3]
    cameras = (*rig.cameras[:view], camera, *rig.cameras[view + 1 :])
    return replace(rig, cameras=cameras, rotation=rotation, translation=translation)


# --- verdict and words


def assess_calibration(group: GroupResult, given: CameraRig, lost: Sequence[str]) -> Verdict:
    """Return the verdict on a calibration: each camera is as far off as two rigs together.

    As the keypoints' own rig may be, and as it differs from that.

    group: the keypoints' own rig. given: the calibration. lost: names of further cameras of it,
        which agree with no others at any pose.
    """
    own = lay_over(group.rig, given, np.arange(len(given)))
    apart = np.rad2deg(angle_between(given.rotation, own.rotation)).tolist()
    causes = list(group.assessment.causes)
    for name, turn in zip(given.names, apart, strict=True):
        meaning = f"{name}: {turn:.1f} deg from where the keypoints have it"
        causes.append(Cause("difference", name, turn, meaning, _CALIBRATE))
    for name in lost:
        meaning = f"{name}: nothing that it sees agrees with the others, at any pose"
        causes.append(Cause("inconsistent", "", OPEN_DEG, meaning, "check its files and clock"))
    causes.sort(key=lambda cause: -cause.error_deg)
    expected = expected_error(given.names, causes)
    return replace(group.assessment, error_deg=expected, causes=tuple(causes))


def explain_cameras(cameras: Sequence[VerifiedCamera]) -> list[Cause]:
    """Return a reason for each camera that moved, or about which nothing is known."""
    if len(cameras) == 2 and cameras[0].word == "moved":
        either, turn = " or ".join(camera.name for camera in cameras), cameras[0].turn
        meaning = f"{either} moved, by {_deg(cameras[0])} deg against the other: two cameras do not"
        return [Cause("moved", "", float(np.rad2deg(turn)), f"{meaning} show which", _CALIBRATE)]
    reasons = []
    for camera in cameras:
        change, turn = float(np.expm1(camera.focal_change)), float(np.rad2deg(camera.turn))
        text = f"{abs(change):.1%} {'longer' if change > 0 else 'shorter'}"
        if camera.word in _REASONS and not (camera.word == "not checked" and np.isfinite(turn)):
            meaning, remedy = _REASONS[camera.word]
            meaning = meaning.format(camera=camera.name, move=describe_move(camera), change=text)
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
    cameras: Sequence[VerifiedCamera], verdict: Verdict, group: GroupResult
) -> dict[str, Any]:
    """Return what the file of a corrected rig holds of its verdict.

    group: the keypoints' own rig.
    """
    refits = [
        f"{camera.name}: refitted by keypoints; as given before it {describe_move(camera)}"
        for camera in cameras
        if camera.word in ("moved", "focal")
    ]
    errors = [camera.refitted_px for camera in cameras if camera.refitted_px < np.inf]
    covariance, names = group.uncertainty.covariance, group.rig.names
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
