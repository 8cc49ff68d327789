"""Put into records and words what a second look at a calibration found."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_calib.adjust.camera_fit import CameraFit, CameraPose
from mocap_calib.adjust.relocation import place_points, refit_camera, typical_error
from mocap_calib.config import VERDICT_LIMITS_DEG, Config
from mocap_calib.geometry.alignment import rig_size
from mocap_calib.geometry.lens import change_intrinsics
from mocap_calib.geometry.rotation import angle_between
from mocap_calib.io.provenance import judgement, round_sigma
from mocap_calib.results import (
    Adjusted,
    Clocks,
    PlaceWord,
    RigCovariance,
    Verification,
    VerifiedCamera,
)
from mocap_calib.rig.placed import PlacedCameras
from mocap_calib.types import Camera, CameraRig, Floats, Ints, Sample
from mocap_calib.verdict.rig_changes import RigChange
from mocap_calib.verdict.verify_words import (
    describe_refits,
    explain_cameras,
    judge_calibration,
)


@dataclass(frozen=True)
class SecondLook:
    """A rig that was adjusted from a given one.

    views: `[view]` indices of its cameras among the given ones. sample: of these.
    """

    views: Ints
    sample: Sample
    adjusted: Adjusted


def describe_rig(
    sample: Sample,
    look: SecondLook,
    rig: CameraRig,
    *,
    change: RigChange,
    covariance: RigCovariance,
    config: Config,
) -> Verification:
    """Return what is said of a rig. sample: of all its cameras."""
    given = rig.select(look.views)
    placed = PlacedCameras.of(look.sample, look.adjusted.rig, look.adjusted.matches, config)
    placed = replace(placed, rig=given)
    mended, focal = _refit(look.sample, placed, change, config)
    checked = {
        camera.name: camera
        for camera in _describe_cameras(
            look.sample, placed, mended, focal=focal, change=change, config=config
        )
    }
    # cameras that say nothing of each other say nothing of another one either
    known = sum(camera.word != "not checked" for camera in checked.values()) >= 2
    cameras = tuple(
        checked.get(name)
        or _describe_unchecked(name, known and has_detections(sample, view, config))
        for view, name in enumerate(rig.names)
    )
    sigma = covariance.rotation_sigma
    verdict, doubts = judge_calibration(cameras, change, sigma, given.names, config)
    errors = [camera.refitted_px for camera in checked.values() if camera.refitted_px < np.inf]
    remarks = [*describe_refits(cameras), *doubts]
    sigmas = {
        "rotation_sigma_deg": _by_name(given, np.rad2deg(sigma)),
        "centre_sigma_percent": _by_name(given, 100 * covariance.centre_sigma),
    }
    error = float(np.mean(errors)) if errors else None
    said = judgement(verdict, remarks, error, **sigmas)
    return Verification(
        cameras=cameras,
        verdict=verdict,
        reasons=(*explain_cameras(cameras), *doubts),
        rig=_put_back(rig, look.views, mended),
        clocks=Clocks.of_one(sample),
        provenance=said,
    )


def _by_name(rig: CameraRig, values: Floats) -> dict[str, float]:
    """Return standard deviations `[view]` by the names of the cameras, as files say them."""
    return {name: round_sigma(value) for name, value in zip(rig.names, values, strict=True)}


def verification_to_dict(found: Verification) -> dict[str, Any]:
    """Return the figures under the keys of `mocap-calib verify --json`; angles in degrees."""
    return {
        "verdict": found.verdict,
        "passes": found.passes,
        "named": list(found.named),
        "reasons": list(found.reasons),
        "unit": found.rig.unit,
        "cameras": [_camera_to_dict(camera) for camera in found.cameras],
    }


def _camera_to_dict(camera: VerifiedCamera) -> dict[str, Any]:
    """Return the figures of one camera; None where nothing tells."""
    figures = {
        "turn_deg": np.rad2deg(camera.turn),
        "turn_sigma_deg": np.rad2deg(camera.turn_sigma),
        "shift": camera.shift,
        "shift_sigma": camera.shift_sigma,
        "relative_shift": camera.relative_shift,
        "focal_change": np.expm1(camera.focal_change),
        "error_px": camera.error_px,
        "refitted_px": camera.refitted_px,
    }
    known = {key: float(value) if np.isfinite(value) else None for key, value in figures.items()}
    return {"name": camera.name, "place": camera.word, **known}


# --- where the cameras that moved are now


def _refit(
    sample: Sample, placed: PlacedCameras, change: RigChange, config: Config
) -> tuple[CameraRig, Floats]:
    """Return the given rig with the moved cameras where they are now, by the others as given.

    Also `[view]` what the logarithms of the focal lengths change by, 0 where they are as given. Of
    two cameras nobody can say where they are.
    """
    rig, focal = placed.rig, np.zeros(len(placed.rig))
    in_place = np.flatnonzero(~change.moved)
    if not change.moved.any() or len(in_place) < 2:
        return rig, focal
    known = place_points(sample, placed, in_place, config)
    for view in np.flatnonzero(change.moved).tolist():
        noise = float(placed.noise[view])
        seen = known.seen_by(view, config.diagnosis.keypoints)
        if len(seen.points) < config.adjust.least_keypoints:
            continue
        plain, free = refit_camera(seen, change.refitted, view, noise=noise, config=config)
        if _is_focal(plain, free, placed.rig, view, config):
            focal[view] = float(free.unknowns[0])
        camera = change_intrinsics(rig.cameras[view], log_focal=focal[view], k1=0.0)
        start = CameraPose(change.refitted.rotation[view], change.refitted.translation[view])
        pose = (free if focal[view] else plain).pose
        turn = np.rad2deg(angle_between(pose.rotation, start.rotation))
        # a telescope sees the same from the opposite side (Necker's cube): the rig of all does not
        pose = pose if turn < VERDICT_LIMITS_DEG[2] else start
        rig = _with_camera(rig, view, camera, pose)
    return rig, focal


def _is_focal(
    plain: CameraFit, free: CameraFit, given: CameraRig, view: int, config: Config
) -> bool:
    """Return whether another focal length explains what looks like another place."""
    settings = config.verify
    if abs(free.unknowns[0]) < settings.least_focal_change:
        return False
    if free.significance < settings.focal_significance:
        return False
    return _distance(free.pose, given, view) < _distance(plain.pose, given, view) / 2


def _distance(pose: CameraPose, given: CameraRig, view: int) -> float:
    """Return how far a camera is from where it was given, turn (radians) and shift (rig sizes)."""
    turn, shift = _change_of(pose, given, view)
    return float(np.hypot(turn, shift / rig_size(given)))


def _change_of(pose: CameraPose, given: CameraRig, view: int) -> tuple[float, float]:
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


def _put_back(rig: CameraRig, views: Ints, mended: CameraRig) -> CameraRig:
    """Return the rig with some of its cameras (indices) as another rig has them."""
    for place, view in enumerate(views.tolist()):
        pose = CameraPose(mended.rotation[place], mended.translation[place])
        rig = _with_camera(rig, view, mended.cameras[place], pose)
    return rig


# --- records


def _describe_cameras(
    sample: Sample,
    placed: PlacedCameras,
    mended: CameraRig,
    *,
    focal: Floats,
    change: RigChange,
    config: Config,
) -> Iterator[VerifiedCamera]:
    """Yield what is said of each camera of the adjusted rig."""
    given, in_place = placed.rig, np.flatnonzero(~change.moved)
    size, views = rig_size(given), np.arange(len(given))
    for view, name in enumerate(given.names):
        others = views[views != view] if len(views) > 2 else views
        known = place_points(sample, replace(placed, rig=mended), others, config)
        turn, shift = float(change.turn[view]), float(change.shift[view]) * size
        if change.moved[view] and len(in_place) >= 2:
            pose = CameraPose(mended.rotation[view], mended.translation[view])
            turn, shift = _change_of(pose, given, view)
        moved: PlaceWord = "focal" if focal[view] else "moved"
        told = np.rad2deg(change.turn_sigma[view]) < VERDICT_LIMITS_DEG[2]
        stays: PlaceWord = "in place" if told else "not checked"
        yield VerifiedCamera(
            name=name,
            word=moved if change.moved[view] else stays,
            turn=turn,
            turn_sigma=float(change.turn_sigma[view]),
            shift=shift,
            shift_sigma=float(change.shift_sigma[view]) * size,
            relative_shift=shift / size,
            focal_change=float(focal[view]),
            error_px=typical_error(known, given, view, config),
            refitted_px=typical_error(known, mended, view, config),
        )


def _describe_unchecked(name: str, has_detections: bool) -> VerifiedCamera:
    """Return what is said of a camera that goes with none of the others."""
    unknown = float("nan")
    return VerifiedCamera(
        name=name,
        word="inconsistent" if has_detections else "not checked",
        turn=unknown,
        turn_sigma=unknown,
        shift=unknown,
        shift_sigma=unknown,
        relative_shift=unknown,
        focal_change=0.0,
        error_px=unknown,
        refitted_px=unknown,
    )


def has_detections(sample: Sample, view: int, config: Config) -> bool:
    """Return whether a view sees enough, while others see somebody, for it to be placed."""
    detected = sample.detected
    others = np.delete(detected, view, axis=0).any(2).sum(0) >= 2
    return bool(detected[view, others].sum() >= config.moved.least_detections)
