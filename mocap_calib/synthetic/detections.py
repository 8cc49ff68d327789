"""What a keypoint detector makes of people in the images of a rig: noise, gaps, gross errors, and who is who."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from mocap_calib.errors import MismatchError
from mocap_calib.geometry.projection import pixels_from_points
from mocap_calib.synthetic.bodies import JOINTS
from mocap_calib.types import Bools, CameraRig, Floats, Ints, Keypoints2D, check_shape

Layout = Literal["coco17", "all"]

LAYOUTS: dict[str, tuple[str, ...]] = {"coco17": JOINTS[:17], "all": JOINTS}

_FEWEST = 4  # joints that make a detection


@dataclass(frozen=True)
class Detections:
    """Keypoints of all views.

    keypoints: `[keypoint]` names. positions: `[view, frame, instance, keypoint, 2]` pixels, NaN = missing.
    confidence: `[view, frame, instance, keypoint]` 0..1, 0 = missing. identity: `[view, frame, instance]` the
    individual, -1 = a false detection or no detection; those that are there come first.
    """

    keypoints: tuple[str, ...]
    positions: Floats
    confidence: Floats
    identity: Ints

    def __post_init__(self) -> None:
        views, frames, instances = self.identity.shape
        check_shape(
            "detections: positions",
            self.positions,
            views,
            frames,
            instances,
            len(self.keypoints),
            2,
        )
        check_shape(
            "detections: confidence", self.confidence, views, frames, instances, len(self.keypoints)
        )


def detect(  # noqa: PLR0913 - each is one plain number of the detector
    rng: np.random.Generator,
    rig: CameraRig,
    poses: Floats,
    *,
    layout: Layout = "coco17",
    noise_px: float = 0.0,
    missing: float = 0.0,
    outliers: float = 0.0,
    false_detections: float = 0.0,
    swaps: float = 0.0,
    shuffle: bool = True,
) -> Detections:
    """Detects `[frame, individual, joint, 3]` poses (the joints of `people`, in the rig's unit) in every view.

    noise_px: RMS error of a coordinate in pixels. missing, outliers: shares of joints that are not found, that are
    found somewhere else on or near the body. false_detections: share of frames, in each view, with a body too many.
    swaps: share of detections that take left for right. shuffle: the order of the instances says nothing; otherwise
    it is that of the individuals. Behind the camera or outside the image nothing is found, and four joints at
    least make a detection. Raises MismatchError.
    """
    shares = {
        "missing": missing,
        "outliers": outliers,
        "false detections": false_detections,
        "swaps": swaps,
    }
    wrong = [f"{name} {share}" for name, share in shares.items() if not 0 <= share <= 1]
    if wrong or layout not in LAYOUTS or noise_px < 0:
        raise MismatchError(
            f"detect: expected shares in 0..1, noise >= 0 and layout {' or '.join(LAYOUTS)}, got {', '.join(wrong) or f'{noise_px}, {layout}'}"
        )
    joints = LAYOUTS[layout]
    poses = poses[:, :, : len(joints)]
    bodies = np.concatenate([poses, _strangers(rng, poses)[:, None]], axis=1)
    image = _swapped(rng, _with_copies(rng, _images(rig, bodies)), joints, swaps)
    real = np.arange(bodies.shape[1]) < poses.shape[1]
    there = real | (rng.random((*image.shape[:2], 1)) < false_detections)
    seen = _inside(rig, image) & there[..., None] & (rng.random(image.shape[:-1]) >= missing)
    seen &= seen.sum(-1, keepdims=True) >= _FEWEST
    positions, quality = _blurred(rng, image, noise_px, outliers)
    confidence = np.clip(quality * np.where(real, 1.0, 0.7)[:, None], 0.05, 1.0)
    identity = np.broadcast_to(np.where(real, np.arange(len(real)), -1), seen.shape[:3])
    return _ordered(rng, Detections(joints, positions, confidence, identity), seen, shuffle)


def keypoint_files(rig: CameraRig, detections: Detections) -> tuple[Keypoints2D, ...]:
    """What the files of the views hold."""
    frames = np.arange(detections.identity.shape[1])
    return tuple(
        Keypoints2D(
            camera.name,
            detections.keypoints,
            frames,
            positions,
            confidence,
            False,
            camera.size,
            f"synthetic {camera.name}",
        )
        for camera, positions, confidence in zip(
            rig.cameras, detections.positions, detections.confidence, strict=True
        )
    )


def _images(rig: CameraRig, bodies: Floats) -> Floats:
    """`[view, frame, body, joint, 2]` pixels; NaN behind the camera."""
    views = zip(rig.cameras, rig.rotation, rig.translation, strict=True)
    return np.stack(
        [
            pixels_from_points(camera, bodies @ rotation.T + translation)
            for camera, rotation, translation in views
        ]
    )


def _inside(rig: CameraRig, image: Floats) -> Bools:
    """`[view, frame, body, joint]` in the image; integer pixels are centres, so it reaches half a pixel further."""
    size = np.array([camera.size for camera in rig.cameras])[:, None, None, None]
    return np.asarray(((image >= -0.5) & (image <= size - 0.5)).all(-1))


def _strangers(rng: np.random.Generator, poses: Floats) -> Floats:
    """`[frame, joint, 3]` in every frame a body that is not there: anybody's pose of any time, elsewhere, turned."""
    frames, individuals = poses.shape[:2]
    body = poses[rng.integers(frames, size=frames), rng.integers(individuals, size=frames)]
    middle = body.mean(1, keepdims=True) * [1, 1, 0]
    low, high = poses.min((0, 1, 2))[:2], poses.max((0, 1, 2))[:2]
    place = np.concatenate([rng.uniform(low, high, (frames, 2)), np.zeros((frames, 1))], axis=1)
    angle = rng.uniform(0, 2 * np.pi, frames)
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros(frames), np.ones(frames)
    turn = np.stack([c, -s, zero, s, c, zero, zero, zero, one], axis=-1).reshape(-1, 3, 3)
    return np.asarray((body - middle) @ np.swapaxes(turn, 1, 2) + place[:, None])


def _with_copies(rng: np.random.Generator, image: Floats) -> Floats:
    """Half of the false bodies, the last of each image, become a distorted copy of a real one, beside it."""
    views, frames, bodies = image.shape[:3]
    whose = rng.integers(bodies - 1, size=(views, frames))
    original = np.take_along_axis(image, whose[:, :, None, None, None], axis=2)[:, :, 0]
    size = _size(original)[..., None, None]
    copy = original + size * (
        0.3 * rng.normal(size=(views, frames, 1, 2)) + 0.06 * rng.normal(size=original.shape)
    )
    false = np.where(rng.random((views, frames, 1, 1)) < 0.5, copy, image[:, :, -1])
    return np.concatenate([image[:, :, :-1], false[:, :, None]], axis=2)


def _size(image: Floats) -> Floats:
    """`[...]` diagonal in pixels of the box around `[..., joint, 2]`; 0 where nothing is seen."""
    seen = np.isfinite(image)
    box = np.where(seen, image, -np.inf).max(-2) - np.where(seen, image, np.inf).min(-2)
    return np.asarray(np.linalg.norm(np.where(seen.any(-2), box, 0.0), axis=-1))


def _blurred(
    rng: np.random.Generator, image: Floats, noise_px: float, outliers: float
) -> tuple[Floats, Floats]:
    """Positions with noise and gross errors, and `[view, frame, body, joint]` a confidence that knows of them, not too well."""
    doubt = rng.beta(2.0, 4.0, image.shape[:-1])
    spread = (0.4 + 2 * doubt) / np.sqrt(
        0.16 + 1.6 / 3 + 4 / 7
    )  # E[doubt] = 1/3, E[doubt^2] = 1/7: RMS 1
    noisy = image + noise_px * spread[..., None] * rng.normal(size=image.shape)
    quality = 1.0 - 0.75 * doubt + 0.05 * rng.normal(size=doubt.shape)
    gross = rng.random(doubt.shape) < outliers
    angle = rng.uniform(0, 2 * np.pi, doubt.shape)
    far = rng.uniform(0.15, 0.8, doubt.shape) * _size(image)[..., None]
    noisy += (gross * far)[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return noisy, np.where(gross, quality * rng.uniform(0.3, 1.0, doubt.shape), quality)


def _swapped(
    rng: np.random.Generator, positions: Floats, joints: tuple[str, ...], swaps: float
) -> Floats:
    """Some detections with left and right exchanged."""
    twin = [joints.index(_other_side(joint)) for joint in joints]
    chosen = rng.random(positions.shape[:3]) < swaps
    return np.where(chosen[..., None, None], positions[..., twin, :], positions)


def _other_side(joint: str) -> str:
    """`left_hip` <-> `right_hip`; the others are their own twins."""
    return (
        joint.replace("left_", "right_")
        if joint.startswith("left_")
        else joint.replace("right_", "left_")
    )


def _ordered(rng: np.random.Generator, found: Detections, seen: Bools, shuffle: bool) -> Detections:
    """Blanks out what is not seen and puts the detections that are there first, in an order that tells nothing if shuffled."""
    present = seen.any(-1)
    order = np.argsort(
        np.where(
            present, rng.random(present.shape) if shuffle else np.arange(present.shape[2]), np.inf
        ),
        axis=2,
        kind="stable",
    )
    most = max(int(present.sum(2).max(initial=0)), 1)
    order = order[:, :, :most]
    positions = np.take_along_axis(
        np.where(seen[..., None], found.positions, np.nan), order[..., None, None], axis=2
    )
    confidence = np.take_along_axis(np.where(seen, found.confidence, 0.0), order[..., None], axis=2)
    identity = np.take_along_axis(np.where(present, found.identity, -1), order, axis=2)
    return Detections(found.keypoints, positions, confidence, identity)
