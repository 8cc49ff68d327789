"""Scenes with truth, made once per test session."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from mocap_calib.config import Config, SimulateConfig
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.pipeline import calibrate
from mocap_calib.recording.joints import load_skeleton
from mocap_calib.recording.sampling import take_sample
from mocap_calib.recording.synchronise import make_recording
from mocap_calib.steerpose.lift import lift
from mocap_calib.steerpose.loading import load_lifter
from mocap_calib.synthetic import Scene, simulate
from mocap_calib.types import (
    CalibrationResult,
    CameraRig,
    GroupResult,
    LiftedPoses,
    Matches,
    Recording,
    Sample,
    silent,
)

PEOPLE = load_skeleton("people")


@lru_cache
def scene(**changes) -> Scene:
    return simulate(replace(SimulateConfig(frames=60), **changes))


@lru_cache
def recording(**changes) -> Sample:
    made = scene(**changes)
    return take_sample(make_recording(made.files, made.rig.cameras, PEOPLE, {}), slice(None))


def permuted(found: Sample, *, views=None, frames=None, instances=None) -> Sample:
    """The same recording in another order."""
    views = np.arange(len(found.cameras)) if views is None else np.array(views)
    if frames is not None:
        found = found.select(frames=np.array(frames))
    instances = np.arange(found.positions.shape[2]) if instances is None else np.array(instances)
    pick = np.ix_(views, np.arange(len(found.frames)), instances)
    return replace(
        found,
        cameras=tuple(found.cameras[v] for v in views),
        positions=found.positions[pick],
        confidence=found.confidence[pick],
        rays=found.rays[pick],
        tracked=found.tracked[views],
    )


@lru_cache
def lifted(**changes) -> LiftedPoses:
    return lift(recording(**changes), load_lifter()[0], progress=silent)


def calibrate_all(recording: Recording, *, seed: int = 0, **options) -> CalibrationResult:
    """Calibrate all groups of a recording's cameras."""
    lifter = options.pop("lifter", None) or load_lifter()[0]
    config = options.pop("config", Config())
    return calibrate(recording, lifter, config, seed=seed, device="cpu", progress=silent, **options)


def calibrate_group(recording: Recording, *, seed: int = 0, **options) -> GroupResult:
    """Calibrate a recording whose cameras all see the same bodies."""
    (group,) = calibrate_all(recording, seed=seed, **options).groups
    return group


@lru_cache
def calibrated(**changes) -> GroupResult:
    return calibrate_group(recording(**changes))


def truth(**changes) -> Matches:
    """The true identities as labels."""
    return Matches(scene(**changes).identity.astype(np.int64))


def rotation_errors_deg(rig: CameraRig, reference: CameraRig) -> np.ndarray:
    """Angle between the relative rotations of all pairs."""
    errors = []
    for a in range(len(rig.cameras)):
        for b in range(a):
            found, true = rig.relative(a, b)[0], reference.relative(a, b)[0]
            errors.append(np.degrees(np.arccos(np.clip((np.trace(found.T @ true) - 1) / 2, -1, 1))))
    return np.array(errors)


def precision(labels: np.ndarray, identity: np.ndarray) -> float:
    """Share of detections of one label in two views, both of known identity, that are the same
    person.
    """
    good = wrong = 0
    for a in range(len(labels)):
        for b in range(a):
            same_label = (labels[a][:, :, None] == labels[b][:, None]) & (
                labels[a][:, :, None] >= 0
            )
            known = (identity[a][:, :, None] >= 0) & (identity[b][:, None] >= 0)
            same = identity[a][:, :, None] == identity[b][:, None]
            good += int((same_label & known & same).sum())
            wrong += int((same_label & known & ~same).sum())
    return good / max(good + wrong, 1)


def turn_cameras(rig: CameraRig, degrees: float, seed: int = 0) -> CameraRig:
    """Turn every camera but the first about its centre by so much."""
    axis = np.random.default_rng(seed).normal(size=(len(rig.cameras), 3))
    axis *= np.radians(degrees) / np.linalg.norm(axis, axis=1, keepdims=True)
    axis[0] = 0
    rotation = matrix_from_vector(axis) @ rig.rotation
    return rig.stand(rotation, rig.centres)
