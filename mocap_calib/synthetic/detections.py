"""What a keypoint detector makes of bodies in the images of a rig: noise, gaps, gross errors."""

from dataclasses import dataclass

import numpy as np

from mocap_calib.config import LEAST_JOINTS
from mocap_calib.geometry.lens import project_points
from mocap_calib.recording.synchronise import split_by_view
from mocap_calib.synthetic.bodies import JOINTS
from mocap_calib.synthetic.config import FALSE_CONFIDENCE, FALSE_COPIES, SimulateConfig
from mocap_calib.synthetic.signals import direction, turn_about
from mocap_calib.types import Bools, CameraRig, Floats, Ints, Keypoints2D, Record

LAYOUTS: dict[str, tuple[str, ...]] = {"coco17": JOINTS[:17], "all": JOINTS}


@dataclass(frozen=True, eq=False, repr=False)
class Detections(Record):
    """Keypoints of all views.

    keypoints: `[keypoint]` names.
    positions: `[view, frame, instance, keypoint, 2]` pixels, NaN = missing.
    confidence: `[view, frame, instance, keypoint]` 0..1, 0 = missing.
    identity: `[view, frame, instance]` the individual, -1 = a false detection or no detection;
        those that are there come first.
    """

    keypoints: tuple[str, ...]
    positions: Floats
    confidence: Floats
    identity: Ints


def detect(
    rng: np.random.Generator,
    rig: CameraRig,
    poses: Floats,
    joints: tuple[str, ...],
    config: SimulateConfig,
) -> Detections:
    """Detect the poses `[frame, individual, joint, 3]` of people or animals in every view.

    Nothing is found behind the camera or outside the image, and four joints at least make a
    detection. With `config.shuffle` the order of the instances carries no information; otherwise it
    is that of the individuals.

    poses: in the rig's unit, NaN for joints that a body does not have. joints: names of those that
    are detected, the first of the poses.
    """
    poses = poses[:, :, : len(joints)]
    individuals = poses.shape[1]
    bodies = np.concatenate([poses, _strangers(rng, poses)[:, None]], axis=1)
    image = _replace_by_copies(rng, project_points(rig, bodies))
    rng.random(image.shape[:3])  # is not used: seeds keep their scenes
    real = np.arange(individuals + 1) < individuals  # [body]: the last is false
    present = real | (rng.random((*image.shape[:2], 1)) < config.false_detections)
    found = rng.random(image.shape[:-1]) >= config.missing
    seen = _inside(rig, image) & present[..., None] & found
    seen &= seen.sum(-1, keepdims=True) >= LEAST_JOINTS
    positions, quality = _blur(rng, image, config.noise_px, config.outliers)
    trust = np.where(real, 1.0, FALSE_CONFIDENCE)[:, None]
    confidence = np.clip(quality * trust, 0.05, 1.0)
    individual = np.where(real, np.arange(len(real)), -1)  # [body]
    identity = np.broadcast_to(individual, seen.shape[:3])
    there = seen.any(-1)  # [view, frame, body]
    order = _order_of_instances(rng, there, shuffle=config.shuffle)
    positions = np.where(seen[..., None], positions, np.nan)
    confidence = np.where(seen, confidence, 0.0)
    return Detections(
        keypoints=joints,
        positions=np.take_along_axis(positions, order[..., None, None], axis=2),
        confidence=np.take_along_axis(confidence, order[..., None], axis=2),
        identity=np.take_along_axis(np.where(there, identity, -1), order, axis=2),
    )


def keypoint_files(rig: CameraRig, detections: Detections) -> tuple[Keypoints2D, ...]:
    """Return what the files of the views hold, in the order of the rig's cameras."""
    return split_by_view(
        rig.cameras,
        keypoints=detections.keypoints,
        frames=np.arange(detections.identity.shape[1]),
        positions=detections.positions,
        confidence=detections.confidence,
        tracked=np.zeros(len(rig.cameras), dtype=bool),
        source="synthetic",
    )


def _inside(rig: CameraRig, image: Floats) -> Bools:
    """Return whether pixels are in the image, `[view, frame, body, joint]`.

    Integer pixels are centres, so the image reaches half a pixel further.
    """
    size = np.array([camera.size for camera in rig.cameras])[:, None, None, None]
    return np.asarray(((image >= -0.5) & (image <= size - 0.5)).all(-1))


def _strangers(rng: np.random.Generator, poses: Floats) -> Floats:
    """Return a body `[frame, joint, 3]` that is not there, for every frame.

    Anybody's pose of any time, elsewhere in the room, turned.
    """
    frames, individuals = poses.shape[:2]
    body = poses[rng.integers(frames, size=frames), rng.integers(individuals, size=frames)]
    middle = np.nanmean(body, axis=1, keepdims=True) * [1, 1, 0]
    low, high = np.nanmin(poses, axis=(0, 1, 2)), np.nanmax(poses, axis=(0, 1, 2))
    level = rng.uniform(low[:2], high[:2], (frames, 2))
    place = np.concatenate([level, np.zeros((frames, 1))], axis=1)
    turn = turn_about(np.asarray(rng.uniform(0, 2 * np.pi, frames)))
    return np.asarray((body - middle) @ np.swapaxes(turn, 1, 2) + place[:, None])


def _replace_by_copies(rng: np.random.Generator, image: Floats) -> Floats:
    """Replace some false bodies, the last of each image, by a distorted copy of a real one.

    The copy is beside the real one. image: `[view, frame, body, joint, 2]` pixels.
    """
    views, frames, bodies = image.shape[:3]
    whose = rng.integers(bodies - 1, size=(views, frames))
    index = whose[:, :, None, None, None]
    original = np.take_along_axis(image, index, axis=2)[:, :, 0]
    shift = 0.3 * rng.normal(size=(views, frames, 1, 2))
    distortion = 0.06 * rng.normal(size=original.shape)
    copy = original + _size(original)[..., None, None] * (shift + distortion)
    copied = rng.random((views, frames, 1, 1)) < FALSE_COPIES
    false = np.where(copied, copy, image[:, :, -1])
    return np.concatenate([image[:, :, :-1], false[:, :, None]], axis=2)


def _size(image: Floats) -> Floats:
    """Return the diagonal `[...]` of the box around bodies `[..., joint, 2]`, in pixels.

    0 where nothing is seen.
    """
    seen = np.isfinite(image)
    high = np.where(seen, image, -np.inf).max(-2)
    low = np.where(seen, image, np.inf).min(-2)
    box = np.where(seen.any(-2), high - low, 0.0)
    return np.asarray(np.linalg.norm(box, axis=-1))


def _blur(
    rng: np.random.Generator, image: Floats, noise_px: float, outliers: float
) -> tuple[Floats, Floats]:
    """Return pixels with noise and gross errors, and the confidence `[view, frame, body, joint]`.

    The confidence knows of the errors, though not too well.
    image: `[view, frame, body, joint, 2]` pixels.
    """
    shape = image.shape[:-1]
    doubt = rng.beta(2.0, 4.0, shape)
    # E[doubt] = 1/3 and E[doubt^2] = 1/7: the RMS of the spread is 1
    spread = (0.4 + 2 * doubt) / np.sqrt(0.16 + 1.6 / 3 + 4 / 7)
    blurred = image + noise_px * spread[..., None] * rng.normal(size=image.shape)
    quality = 1.0 - 0.75 * doubt + 0.05 * rng.normal(size=shape)
    gross = rng.random(shape) < outliers
    angle = rng.uniform(0, 2 * np.pi, shape)
    distance = rng.uniform(0.15, 0.8, shape) * _size(image)[..., None]
    blurred += (gross * distance)[..., None] * direction(angle)
    return blurred, np.where(gross, quality * rng.uniform(0.3, 1.0, shape), quality)


def _order_of_instances(rng: np.random.Generator, present: Bools, *, shuffle: bool) -> Ints:
    """Return the bodies `[view, frame, instance]` (indices), those that are present first.

    present: `[view, frame, body]`. shuffle: in an order that tells nothing.
    """
    rank = rng.random(present.shape) if shuffle else np.arange(present.shape[2])
    order = np.argsort(np.where(present, rank, np.inf), axis=2, kind="stable")
    return order[:, :, : max(int(present.sum(2).max(initial=0)), 1)]
