"""Determine what the sizes of images leave open: the direction of a quarter turn, a corner.

Either turn leaves the bodies upright; the two differ in where the principal point lies beside the
middle of the image. The corner of a part of the image is estimated from the points of the others.
"""

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import replace
from functools import cache

import numpy as np

from mocap_calib.adjust.camera_fit import CameraFit, Unknown, fit_camera
from mocap_calib.adjust.resection import match
from mocap_calib.config import LEAST_JOINTS, Config
from mocap_calib.faults.hypotheses import Hypothesis, describe, mend_of
from mocap_calib.faults.leave_one_out import Held, hold_each
from mocap_calib.geometry.epipolar import essential_matrix, sampson_angle
from mocap_calib.geometry.rotation import mean_of_known
from mocap_calib.recording.corrections import Cropped, Resized, Rotated, apply_mends
from mocap_calib.recording.sampling import evenly_spaced, take_sample
from mocap_calib.results import CalibrationResult, Fault, Mend
from mocap_calib.rig import Observed
from mocap_calib.types import Camera, CameraClock, CameraRig, Recording, Sample

_SAME_PIXEL = 0.5  # of principal points that are as good as equal
_FRAMES = 100  # of a recording, in which a rig is held against its images
_KEPT = 16  # likeliest turns of some cameras, to which those of the next are added


def alternative_images(
    recording: Recording, observed: Observed, result: CalibrationResult
) -> list[Recording]:
    """Return the recording with what the sizes of its images leave open in other ways.

    With other quarter turns, of all cameras and of those that prefer it; and with corners of parts
    of images as the other cameras have them.

    recording: as corrected by sizes. observed: what was known before the rigs of it were built.
    result: what was found with it.
    """
    if not recording.corrected:
        return []
    held = {
        each.camera.name: each
        for group in result.groups
        for each in hold_each(observed, group, result.config)
    }
    turned = _other_turns(recording, held, result.config)
    corners = _with_corners(recording, held, result.config)
    return turned if corners is None else [*turned, corners]


def _other_turns(recording: Recording, held: Mapping[str, Held], config: Config) -> list[Recording]:
    """Return the recording with other quarter turns. held: the cameras, by name."""
    names = {each.camera for each in recording.corrected if isinstance(each.mend, Rotated)}
    over = turn_over(recording, names)
    pairs = {
        one.name: (one, other) for one, other in zip(recording.cameras, over.cameras, strict=True)
    }
    names = {
        name
        for name in names
        if np.abs(pairs[name][0].matrix - pairs[name][1].matrix).max() > _SAME_PIXEL
    }
    preferring = {
        name for name in names if name in held and _prefers(held[name], pairs[name][1], config)
    }
    found = dict.fromkeys(frozenset(each) for each in (names, preferring) if each)
    return [turn_over(recording, each) for each in found]


def turn_over(recording: Recording, names: AbstractSet[str]) -> Recording:
    """Return the recording with the images of cameras turned by 270 degrees in place of 90."""
    turned = apply_mends(recording, tuple(Rotated(name, 180) for name in sorted(names)))
    corrected = (
        replace(fault, mend=Rotated(fault.camera, (fault.mend.degrees + 180) % 360))
        if isinstance(fault.mend, Rotated) and fault.camera in names
        else fault
        for fault in recording.corrected
    )
    return replace(turned, corrected=tuple(corrected))


def _with_corners(
    recording: Recording, held: Mapping[str, Held], config: Config
) -> Recording | None:
    """Return the recording with corners of parts of images as estimated, None where none is."""
    found: list[Fault] = []
    mends: list[Mend] = []
    for fault in recording.corrected:
        if isinstance(fault.mend, Cropped) and fault.camera in held:
            camera = held[fault.camera].camera
            fit = _fit(held[fault.camera], camera, config, free=("x", "y"))
            cropped = Hypothesis("cropped", camera, np.empty((0, 0, 0, 2)), free=("x", "y"))
            if fit is not None and (mend := mend_of(cropped, fit)) is not None:
                found.append(replace(fault, mend=mend))
                mends.append(mend)
    if not found:
        return None
    changed = apply_mends(recording, tuple(mends))
    return replace(changed, corrected=combine_corrections(recording.corrected, found))


def _prefers(held: Held, other: Camera, config: Config) -> bool:
    """Return whether a camera sees the points of the others better with another centre."""
    matrix = held.camera.matrix.copy()
    matrix[:2, 2] = other.matrix[:2, 2]
    given = _fit(held, held.camera, config)
    over = _fit(held, replace(held.camera, matrix=matrix), config)
    return bool(given and over and np.median(over.error) < np.median(given.error))


def _fit(
    held: Held, camera: Camera, settings: Config, free: tuple[Unknown, ...] = ()
) -> CameraFit | None:
    """Return the pose of a camera by the points of the others, None where it saw too few."""
    tolerance, blocks = settings.adjust.outlier * held.noise, settings.uncertainty.time_blocks
    body, _ = match(held.seen, held.pose, tolerance)
    known = held.seen.known_points(body, body >= 0, held.pixels, blocks=blocks)
    if len(known.points) < settings.diagnosis.least_keypoints:
        return None
    noise = settings.diagnosis.focal_noise * camera.focal
    return fit_camera(camera, known, held.pose, settings.diagnosis.fit, noise=noise, free=free)


# --- rigs whose poses are known


def turn_rig(
    rig: CameraRig, recording: Recording, mends: Sequence[Mend]
) -> tuple[CameraRig, Recording]:
    """Return a rig with the cameras of a recording, turned about their axes as the images were.

    Of the two turns that sizes leave open, those are taken that bring the detections of two cameras
    closest to their epipolar lines; the recording has them, too.

    rig: of the cameras of the recording. mends: what is stated to be wrong with the files.
    """
    stated = tuple(mend for mend in mends if isinstance(mend, Rotated))
    undecided = {each.camera for each in recording.corrected if isinstance(each.mend, Rotated)}
    over = turn_over(recording, undecided)
    both = [(_turned(rig, each, stated), each) for each in (recording, over)]
    if not undecided:
        return both[0]
    frames = evenly_spaced(np.arange(len(recording.frames)), _FRAMES)
    posed = [(one, take_sample(each, frames)) for one, each in both]

    @cache
    def error(a: int, b: int, of_a: int, of_b: int) -> float:
        """Return how far detections of two cameras are from epipolar lines; 1: turned over."""
        return _epipolar_error(*posed[of_a], a, *posed[of_b], b)

    likeliest: list[tuple[float, tuple[int, ...]]] = [(0.0, ())]
    for view, name in enumerate(rig.names):
        longer = (
            (
                total + sum(error(k, view, each, turn) for k, each in enumerate(turns)),
                (*turns, turn),
            )
            for total, turns in likeliest
            for turn in ((0, 1) if name in undecided else (0,))
        )
        likeliest = sorted(longer)[:_KEPT]
    names = {name for name, turn in zip(rig.names, likeliest[0][1], strict=True) if turn}
    chosen = turn_over(recording, names)
    return _turned(rig, chosen, stated), chosen


def _turned(rig: CameraRig, recording: Recording, stated: Sequence[Rotated]) -> CameraRig:
    """Return the rig with the cameras of a recording, and poses that are turned like its images."""
    rotation, translation = rig.rotation.copy(), rig.translation.copy()
    for mend in (*stated, *(fault.mend for fault in recording.corrected)):
        if isinstance(mend, Rotated):
            view = rig.names.index(mend.camera)
            quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
            turn = np.linalg.matrix_power(quarter, mend.degrees // 90)
            rotation[view], translation[view] = turn @ rotation[view], turn @ translation[view]
    return replace(rig, cameras=recording.cameras, rotation=rotation, translation=translation)


def _epipolar_error(  # noqa: PLR0917 - two cameras
    rig_a: CameraRig, sample_a: Sample, a: int, rig_b: CameraRig, sample_b: Sample, b: int
) -> float:
    """Return the median angle of bodies of two cameras to epipolar lines, 0 where nothing is seen.

    Each detection counts with the one of the other camera, of the same frame, that is closest.
    """
    turn = rig_b.rotation[b] @ rig_a.rotation[a].T
    matrix = essential_matrix(turn, rig_b.translation[b] - turn @ rig_a.translation[a])
    rays = sample_a.rays[a][:, :, None], sample_b.rays[b][:, None]
    angle = np.abs(sampson_angle(matrix, *rays))  # [frame, instance, instance, joint]
    known = np.isfinite(angle).sum(-1) >= LEAST_JOINTS
    closest = np.where(known, mean_of_known(angle, -1), np.inf).min(-1, initial=np.inf)
    found = closest[np.isfinite(closest)]
    return float(np.median(found)) if len(found) else 0.0


# --- corrections as one


def combine_corrections(corrected: Sequence[Fault], found: Sequence[Fault]) -> tuple[Fault, ...]:
    """Return the faults of a recording, those that sizes show and those found after, each once.

    Two corrections of one kind of one camera are one: both turns, factors or corners together.
    """
    faults = {(fault.camera, fault.word): fault for fault in corrected}
    others = []
    for fault in found:
        first = faults.get((fault.camera, fault.word))
        if first is None or not isinstance(fault.mend, Rotated | Resized | Cropped):
            others.append(fault)
            continue
        mend = _combine(first.mend, fault.mend)
        evidence = {**first.evidence, **fault.evidence}
        faults[fault.camera, fault.word] = replace(
            fault, says=describe(mend), evidence=evidence, mend=mend
        )
    return (*faults.values(), *others)


def _combine(first: Mend | CameraClock | None, second: Mend) -> Mend:
    """Return two corrections of one kind as one."""
    if isinstance(first, Rotated) and isinstance(second, Rotated):
        return replace(first, degrees=(first.degrees + second.degrees) % 360)
    if isinstance(first, Resized) and isinstance(second, Resized):
        width, height = (first.factors * second.factors).tolist()
        return replace(second, x=width, y=height)
    if isinstance(first, Cropped) and isinstance(second, Cropped):
        return replace(second, x=first.x + second.x, y=first.y + second.y)
    return second
