"""Scenes with truth, made once per test session."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from mocap_calib.adjust.refine import adjust_once
from mocap_calib.config import Config
from mocap_calib.geometry.rotation import Similarity, angle_between, matrix_from_vector
from mocap_calib.lift import lift
from mocap_calib.lift.lifter import load_lifter
from mocap_calib.pipeline import calibrate
from mocap_calib.recording.joints import load_skeleton
from mocap_calib.recording.sampling import take_sample
from mocap_calib.recording.synchronise import make_recording
from mocap_calib.results import CalibrationResult, GroupResult, LiftedPoses, Matches
from mocap_calib.synthetic.config import SimulateConfig
from mocap_calib.synthetic.scene import Scene, simulate
from mocap_calib.types import Camera, CameraRig, Recording, Sample, silent

PEOPLE = load_skeleton("people")
AXIS = np.array([0.48, 0.6, 0.64])  # about which cameras are turned
MIRROR = np.array([-1.0, 1.0, 1.0])


@lru_cache
def scene(**changes) -> Scene:
    return simulate(replace(SimulateConfig(frames=60), **changes))


@lru_cache
def recording(**changes) -> Sample:
    made = scene(**changes)
    return take_sample(make_recording(made.files, made.rig.cameras, PEOPLE, {}), slice(None))


def sample_of(found: Recording, frames: np.ndarray | slice = slice(None)) -> Sample:
    """Return some frames (indices) of a recording, with their rays."""
    return take_sample(found, frames)


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


def backwards(found: Sample) -> Sample:
    """The same recording as if time ran the other way."""
    first, last = found.frames[[0, -1]]
    turned = found.select(frames=np.arange(len(found.frames))[::-1])
    return replace(turned, frames=first + last - found.frames[::-1])


def mirrored(found: Sample) -> Sample:
    """The same recording of the scene's mirror image: left and right keep their names."""
    cameras = tuple(map(_mirrored_camera, found.cameras))
    positions = found.positions.copy()
    widths = np.array([camera.size[0] for camera in cameras])
    positions[..., 0] = widths[:, None, None, None] - 1 - positions[..., 0]
    return replace(found, cameras=cameras, positions=positions, rays=found.rays * MIRROR)


def mirrored_rig(rig: CameraRig) -> CameraRig:
    """The cameras of the mirror image, which is at -x of the world."""
    cameras = tuple(map(_mirrored_camera, rig.cameras))
    rotation = MIRROR[:, None] * rig.rotation * MIRROR
    return replace(rig, cameras=cameras, rotation=rotation, translation=rig.translation * MIRROR)


def _mirrored_camera(camera: Camera) -> Camera:
    """The camera of the mirror image, of a lens without tangential distortion."""
    matrix = camera.matrix.copy()
    matrix[0, 2] = camera.size[0] - 1 - matrix[0, 2]
    return replace(camera, matrix=matrix)


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


def with_labels(group: GroupResult, labels: np.ndarray) -> GroupResult:
    """Return a group whose detections have other labels `[view, frame, instance]`."""
    return replace(group, matches=replace(group.matches, labels=labels))


def truth(**changes) -> Matches:
    """The true identities as labels."""
    return Matches(scene(**changes).identity.astype(np.int64))


def rotation_errors_deg(rig: CameraRig, reference: CameraRig) -> np.ndarray:
    """Angle between the relative rotations of all pairs."""
    pairs = combinations(range(len(rig)), 2)
    return np.array([angles_deg(rig.relative(*p)[0], reference.relative(*p)[0]) for p in pairs])


def precision(labels: np.ndarray, identity: np.ndarray) -> float:
    """Share of detections of one label in two views, both of known identity, that are the same
    person.
    """
    found = []
    for a, b in combinations(range(len(labels)), 2):
        (label, other), (who, whom) = (
            (each[a][:, :, None], each[b][:, None]) for each in (labels, identity)
        )
        compared = (label == other) & (label >= 0) & (who >= 0) & (whom >= 0)
        found.append((who == whom)[compared])
    return float(np.concatenate(found).mean()) if sum(map(len, found)) else 0.0


def gaps(rig: CameraRig, seen: Recording, matches: Matches, points: np.ndarray) -> np.ndarray:
    """Return the ways `[view, frame, individual, joint, 2]` from detections to images of points.

    points: `[frame, individual, joint, 3]`. NaN = not seen, or no point.
    """
    images = rig.project(points)
    found = np.full_like(images, np.nan)
    for view, frame, instance in np.argwhere(matches.labels >= 0):
        individual = matches.labels[view, frame, instance]
        there = seen.seen[view, frame, instance]
        gap = images[view, frame, individual] - seen.positions[view, frame, instance]
        found[view, frame, individual, there] = gap[there]
    return found


def turn_cameras(rig: CameraRig, degrees: float, seed: int = 0) -> CameraRig:
    """Turn every camera but the first about its centre by so much."""
    axis = np.random.default_rng(seed).normal(size=(len(rig.cameras), 3))
    axis *= np.radians(degrees) / np.linalg.norm(axis, axis=1, keepdims=True)
    axis[0] = 0
    rotation = matrix_from_vector(axis) @ rig.rotation
    return rig.stand(rotation, rig.centres)


def turn_matrix(degrees: float) -> np.ndarray:
    """Return a rotation by so much about an axis that is none of the coordinates'."""
    return matrix_from_vector(np.deg2rad(degrees) * AXIS)


def angles_deg(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the angles `[...]` between rotations `[..., 3, 3]`."""
    return np.degrees(angle_between(first, second))


def turn_camera(
    rig: CameraRig, view: int, degrees: float, *, shift: ArrayLike = (0.0, 0.0, 0.0)
) -> CameraRig:
    """Turn one camera about its centre, and shift that."""
    rotation, translation = rig.rotation.copy(), rig.translation.copy()
    rotation[view] = turn_matrix(degrees) @ rotation[view]
    translation[view] = -rotation[view] @ (rig.centres[view] + shift)
    return replace(rig, rotation=rotation, translation=translation)


def adjust_twice(sample: Sample, rig: CameraRig, matches: Matches, config: Config) -> CameraRig:
    """Return an adjusted rig, adjusted again by the errors of a rig that is close."""
    close = adjust_once(sample, rig, matches, config)
    return adjust_once(sample, close, matches, config, already_close=True)


def similar(rig: CameraRig, rng: np.random.Generator) -> tuple[CameraRig, Similarity]:
    """Return the rig in a world of other axes and another unit, and how points move into it."""
    turn, factor = matrix_from_vector(rng.normal(size=3)), rng.uniform(0.1, 10)
    shift = rng.normal(size=3)
    rotation = rig.rotation @ turn.T
    translation = factor * rig.translation - rotation @ shift
    return replace(rig, rotation=rotation, translation=translation), Similarity(factor, turn, shift)


def moved(rig: CameraRig, rng: np.random.Generator) -> tuple[CameraRig, np.ndarray, float]:
    """The rig in another world and unit: with the turn `[3, 3]` and the factor of lengths."""
    world, move = similar(rig, rng)
    return world, move.rotation, move.scale


def rigs_differ(first: CameraRig, second: CameraRig) -> float:
    """Return how far two rigs are from similar: in radians, or of the largest distance."""
    pairs = list(combinations(range(len(first)), 2))
    turns = [angle_between(first.relative(*p)[0], second.relative(*p)[0]) for p in pairs]
    a, b = np.array(pairs).T
    apart = [np.linalg.norm(rig.centres[a] - rig.centres[b], axis=1) for rig in (first, second)]
    apart = [each / each.max() for each in apart]
    return float(max(*turns, np.abs(apart[0] - apart[1]).max()))


def told(
    how: str, rng: np.random.Generator, **size
) -> tuple[Sample, Callable[[CameraRig], CameraRig], Matches, np.ndarray]:
    """Return a scene in another order, time, mirror or world.

    The recording; what makes its rig of that of the scene; the true labels; and the views `[view]`
    of the scene in its order.
    """
    found, labels = recording(**size), truth(**size).labels
    views, _, instances = (np.arange(count) for count in labels.shape)
    if how == "views":
        views = rng.permutation(views)
        found, labels = permuted(found, views=views), labels[views]
        return found, lambda rig: rig.select(views), Matches(labels), views
    if how == "instances":
        instances = rng.permutation(instances)
        found, labels = permuted(found, instances=instances), labels[:, :, instances]
    if how == "names":
        labels = np.append(rng.permutation(labels.max() + 1), -1)[labels]
    if how == "time":
        found, labels = backwards(found), labels[:, ::-1]
    if how == "mirror":
        return mirrored(found), mirrored_rig, Matches(labels), views
    if how == "world":
        state = rng.bit_generator.state

        def move(rig: CameraRig) -> CameraRig:
            rng.bit_generator.state = state
            return moved(rig, rng)[0]

        return found, move, Matches(labels), views
    return found, lambda rig: rig, Matches(labels), views
