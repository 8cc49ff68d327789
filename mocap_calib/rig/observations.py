"""Gather what all views saw of each point."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_calib.geometry import lens
from mocap_calib.types import Camera, Floats, Ints, Matches, Recording


@dataclass(frozen=True)
class Observations:
    """Detections by point and by component.

    pixels: `[view, 2, N]`, NaN = missing.
    rays: `[view, 3, N]` unit vectors in each camera's frame, NaN = missing.
    confidence: `[view, N]`, 0 = missing.
    """

    pixels: Floats
    rays: Floats
    confidence: Floats


def gather_observations(recording: Recording, matches: Matches, frames: Ints) -> Observations:
    """Return the detections of all individuals in the frames with these indices `[frame]`.

    N = frames x individuals x keypoints, in that order.
    """
    pixels, confidence = matched_pixels(recording, matches, frames)
    views = len(pixels)
    return observe(recording.cameras, pixels.reshape(views, -1, 2), confidence.reshape(views, -1))


def matched_pixels(recording: Recording, matches: Matches, frames: Ints) -> tuple[Floats, Floats]:
    """Return the detections of all individuals in the frames with these indices `[frame]`.

    Pixels `[view, frame, individual, keypoint, 2]`, NaN = missing, and the confidence, 0 = missing.
    """
    labels = matches.labels[:, frames]
    view, frame, instance = np.nonzero(labels >= 0)
    individual = labels[view, frame, instance]
    views, keypoints = len(recording.cameras), len(recording.keypoints)
    shape = (views, len(frames), matches.individuals, keypoints)
    pixels = np.full((*shape, 2), np.nan)
    confidence = np.zeros(shape)
    part = recording.select(frames=frames)
    pixels[view, frame, individual] = part.positions[view, frame, instance]
    confidence[view, frame, individual] = part.confidence[view, frame, instance]
    return pixels, confidence


def observe(cameras: Sequence[Camera], pixels: Floats, confidence: Floats) -> Observations:
    """Return the detections with their rays.

    pixels: `[view, N, 2]`, NaN = missing; confidence: `[view, N]`, 0 = missing.
    """
    return Observations(
        pixels=np.ascontiguousarray(np.moveaxis(pixels, -1, 1)),
        rays=lens.unproject_views(cameras, pixels, by_component=True),
        confidence=confidence,
    )


def labelled_frames(matches: Matches) -> Ints:
    """Return the indices `[frame]` of the frames with any label."""
    return np.flatnonzero((matches.labels >= 0).any((0, 2)))
