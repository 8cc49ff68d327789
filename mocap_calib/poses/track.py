"""What was seen of bodies over time, by joint, as the energy of `poses.energy` takes it.

A track is made of stretches of frames, of one individual or of several, one after the other: what
is linear in time works on all of them at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.geometry.rays import rays_in_world
from mocap_calib.rig.observations import Observations
from mocap_calib.types import CameraRig, Floats, Ints


@dataclass(frozen=True, eq=False, repr=False)
class Detections:
    """Rays of one track.

    rays: `[3, view, keypoint, frame]` unit vectors in the world's axes; zero = missing.
    precision: `[view, keypoint, frame]` inverse variance of the ray's angle in each of the two
        directions across it, in 1 / radians squared; 0 = missing.
    centres: `[view, 3]` of the cameras.
    """

    rays: Floats
    precision: Floats
    centres: Floats

    def join(self, others: Sequence["Detections"]) -> "Detections":
        """Return these detections and then, later in time, the others'."""
        parts = [self, *others]
        return replace(
            self,
            rays=np.concatenate([part.rays for part in parts], axis=-1),
            precision=np.concatenate([part.precision for part in parts], axis=-1),
        )


@dataclass(frozen=True)
class Body:
    """What is expected of bodies in each frame of a track.

    edges: `[edge, 2]` keypoints whose distance is constant. lengths: `[edge, frame]` these
        distances, NaN where they are not known. varies: `[edge, frame]` by how much (standard
        deviation) they vary all the same. size: `[frame]` of the bodies: strengths are in it.
    steps: `[3, frame]` what the positions in a frame, the next one and the one after that are
        multiplied by for the acceleration there, zero where these frames do not follow each other.
        Times are in the usual step from one frame to the next.
    agility: `[keypoint]` how strongly each joint accelerates; 1 is usual.
    """

    edges: Ints
    lengths: Floats
    varies: Floats
    size: Floats
    steps: Floats
    agility: Floats

    def join(self, others: Sequence["Body"]) -> "Body":
        """Return this body and then, later in time, the others."""
        parts = [self, *others]
        names = ("lengths", "varies", "size", "steps")
        joined = {
            name: np.concatenate([getattr(part, name) for part in parts], axis=-1) for name in names
        }
        return replace(self, **joined)


def detections_of(
    rig: CameraRig, seen: Observations, noise: Floats, *, individuals: int, keypoints: int
) -> list[Detections]:
    """Return the detections of each individual.

    seen: of N = frames x individuals x keypoints. noise: `[view]` in radians.
    """
    rays = rays_in_world(rig, seen.rays)  # [view, 3, N]
    weight = np.where(np.isfinite(seen.rays[:, 0]), seen.confidence, 0.0)
    precision = weight / noise[:, None] ** 2
    views = len(rig)
    rays = rays.reshape(views, 3, -1, individuals, keypoints).transpose(3, 1, 0, 4, 2)
    precision = precision.reshape(views, -1, individuals, keypoints).transpose(2, 0, 3, 1)
    return [
        Detections(np.ascontiguousarray(own), np.ascontiguousarray(weights), rig.centres)
        for own, weights in zip(rays, precision, strict=True)
    ]


def acceleration_steps(frames: Floats, longest_gap: float) -> Floats:
    """Return `Body.steps` `[3, frame]` of one stretch.

    frames: numbers, in the usual step from one to the next. Second divided differences, doubled.
    longest_gap: steps between frames that still follow each other.
    """
    steps = np.zeros((3, len(frames)))
    if len(frames) < 3:
        return steps
    gap = np.diff(frames)
    before, after = gap[:-1], gap[1:]
    follow = np.maximum(before, after) <= longest_gap
    first, last = 2 / (before * (before + after)), 2 / (after * (before + after))
    steps[:, :-2] = np.where(follow, np.stack([first, -first - last, last]), 0.0)
    return steps
