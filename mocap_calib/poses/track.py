"""What was seen of bodies over time, by joint, as the energy of `poses.energy` takes it.

A track is made of stretches of frames, of one individual or of several, one after the other: what
is linear in time works on all of them at once.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.config import PosesConfig
from mocap_calib.geometry.lens import rays_in_world
from mocap_calib.results import POINT_SOURCES
from mocap_calib.rig.tracks import Tracks
from mocap_calib.types import Bools, CameraRig, Floats, Ints

_TRIANGULATED = POINT_SOURCES.index("triangulated")
_ONE_VIEW = POINT_SOURCES.index("one view")
_INTERPOLATED = POINT_SOURCES.index("interpolated")


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
    """

    edges: Ints
    lengths: Floats
    varies: Floats
    size: Floats
    steps: Floats

    def join(self, others: Sequence["Body"]) -> "Body":
        """Return this body and then, later in time, the others."""
        parts = [self, *others]
        names = ("lengths", "varies", "size", "steps")
        joined = {
            name: np.concatenate([getattr(part, name) for part in parts], axis=-1) for name in names
        }
        return replace(self, **joined)


def detections_of(
    rig: CameraRig, seen: Tracks, noise: Floats, *, individuals: int, keypoints: int
) -> list[Detections]:
    """Return the detections of each individual.

    All detections of a view count alike: weights by confidence make poses of some detectors worse.

    seen: of N = frames x individuals x keypoints. noise: `[view]` in radians.
    """
    rays = rays_in_world(rig, seen.rays)  # [view, 3, N]
    known = np.isfinite(seen.rays[:, 0]) & (seen.weight > 0)
    precision = known / noise[:, None] ** 2
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


def accelerations(points: Floats, body: Body) -> Floats:
    """Return the accelerations `[keypoint, frame - 2, 3]` by the first of their frames.

    0 where frames do not follow each other. points: `[keypoint, frame, 3]`.
    """
    ends = max(points.shape[1] - 2, 0)
    steps = body.steps[:, :ends, None]
    parts = (step * points[:, k : k + ends] for k, step in enumerate(steps))
    return np.asarray(sum(parts))


# Gaps that are bridged, and blocks of frames


def time_around(there: Bools, times: Floats) -> Floats:
    """Return times `[2, keypoint, frame]`: since the last that is there, and to the next."""
    last = np.maximum.accumulate(np.where(there, times, -np.inf), axis=1)
    following = np.minimum.accumulate(np.where(there, times, np.inf)[:, ::-1], axis=1)[:, ::-1]
    return np.stack([times - last, following - times])


def with_gaps(there: Ints, times: Floats, longest: int) -> Ints:
    """Return indices of frames, with those of gaps between them that are no longer than this."""
    if not len(there):
        return there
    short = np.diff(times[there]) <= longest + 1
    inside = np.zeros(len(times) + 1, dtype=np.int64)
    np.add.at(inside, there[:-1][short], 1)
    np.add.at(inside, there[1:][short], -1)
    wanted = np.cumsum(inside)[:-1] > 0
    wanted[there] = True
    return np.flatnonzero(wanted)


def point_sources(seen: Detections, met: Bools, times: Floats, longest: int) -> Ints:
    """Return what points are made of, `[keypoint, frame]`, 0 = missing.

    met: `[keypoint, frame]` whether there is a point that was started from. longest: gap that is
    bridged, and distance from a triangulated point up to which one view will do: along its ray a
    point may be at either of two places. Below 0 neither is.
    """
    views = (seen.precision > 0).sum(0)
    firm = met & (views >= 2)
    gap = time_around(views > 0, times)
    source = np.where(gap.sum(0) <= longest + 1, _INTERPOLATED, 0)
    near = time_around(firm, times).min(0) <= longest
    source = np.where(views > 0, np.where(near, _ONE_VIEW, 0), source)
    return np.where(firm, _TRIANGULATED, source)


def blocks(frames: Ints, config: PosesConfig) -> Iterator[tuple[slice, Ints]]:
    """Yield frames to fit at once, and which of them are new there: the others are margins."""
    margin = 4 * config.longest_gap
    for start in range(0, len(frames), config.block_frames):
        first = max(start - margin, 0)
        last = start + config.block_frames
        own = frames[first : last + margin]
        yield slice(start - first, min(last, len(frames)) - first), own
