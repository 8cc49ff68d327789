"""Tracks: what the views saw of points, each a keypoint of an individual in a frame."""

from dataclasses import dataclass

import numpy as np

from mocap_calib.geometry import lens
from mocap_calib.results import Matches
from mocap_calib.types import Bools, Floats, Ints, Recording


@dataclass(frozen=True, eq=False, repr=False)
class Tracks:
    """The detections of N points, by view and by component.

    pixels: `[view, 2, N]`, NaN = missing.
    rays: `[view, 3, N]` unit vectors in each camera's frame, NaN = missing.
    weight: `[view, N]` of each detection, 0 = missing or not used; the confidence, as gathered.
    frame, individual, keypoint: `[N]` indices.
    """

    pixels: Floats
    rays: Floats
    weight: Floats
    frame: Ints
    individual: Ints
    keypoint: Ints

    @property
    def used(self) -> Bools:
        """`[view, N]` the detections that have a weight."""
        return np.asarray(self.weight > 0)

    def select(self, points: Ints) -> "Tracks":
        """Return the tracks of some of the points (`[n]` indices)."""
        return Tracks(
            pixels=self.pixels[..., points],
            rays=self.rays[..., points],
            weight=self.weight[:, points],
            frame=self.frame[points],
            individual=self.individual[points],
            keypoint=self.keypoint[points],
        )

    def time_blocks(self, blocks: int) -> Ints:
        """Return the number `[N]`, below `blocks`, of the period that each point belongs to.

        Periods have about equally many frames.
        """
        frames, rank = np.unique(self.frame, return_inverse=True)
        return np.asarray(rank * blocks // max(len(frames), 1), dtype=np.int64)


def gather_tracks(recording: Recording, matches: Matches, frames: Ints) -> Tracks:
    """Return the detections of all individuals in some frames (`[frame]` indices).

    N = frames x individuals x keypoints, in that order.
    """
    pixels, confidence = matched_pixels(recording, matches, frames)
    views, shape = len(pixels), confidence.shape[1:]
    pixels = pixels.reshape(views, -1, 2)
    frame, individual, keypoint = (index.ravel() for index in np.indices(shape))
    return Tracks(
        pixels=np.ascontiguousarray(np.moveaxis(pixels, -1, 1)),
        rays=lens.unproject_views(recording.cameras, pixels, by_component=True),
        weight=confidence.reshape(views, -1),
        frame=frames[frame],
        individual=individual,
        keypoint=keypoint,
    )


def matched_pixels(recording: Recording, matches: Matches, frames: Ints) -> tuple[Floats, Floats]:
    """Return the detections of all individuals in some frames (`[frame]` indices).

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


def labelled_frames(matches: Matches) -> Ints:
    """Return the indices `[frame]` of the frames with any label."""
    return np.flatnonzero((matches.labels >= 0).any((0, 2)))
