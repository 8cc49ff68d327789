"""Tracks: what was seen of a body over time, by joint, and where the fit of its poses starts.

The fit starts from bones' lengths and triangulated points with their gaps filled in.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtri

from mocap_calib import mapped
from mocap_calib.compute.parallel import do_in_threads
from mocap_calib.config import PosesConfig
from mocap_calib.geometry.lens import rays_in_world
from mocap_calib.results import POINT_SOURCES, Poses3D
from mocap_calib.rig import Tracks
from mocap_calib.types import Bools, CameraRig, Floats, Ints

_TRIANGULATED = POINT_SOURCES.index("triangulated")
_ONE_VIEW = POINT_SOURCES.index("one view")
_INTERPOLATED = POINT_SOURCES.index("interpolated")
_MEDIAN_SQUARE = chdtri(1, 0.5)  # of normal errors of variance 1
ROUNDS = 5  # of reweighting: lengths of bones, and the median of accelerations
_BLOCK = 1000  # frames that are fitted at once, besides margins of four longest gaps


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


@dataclass(frozen=True)
class Body:
    """What is expected of the body of a track.

    edges: `[edge, 2]` keypoints whose distance is constant. lengths: `[edge]` these distances, NaN
        where they are not known. varies: `[edge]` by how much (standard deviation) they vary all
        the same. size: of the body: strengths are in it.
    steps: `[3, frame]` what the positions in a frame, the next one and the one after that are
        multiplied by for the acceleration there, zero where these frames do not follow each other.
        Times are in the usual step from one frame to the next.
    """

    edges: Ints
    lengths: Floats
    varies: Floats
    size: float
    steps: Floats


def detections_of(rig: CameraRig, seen: Tracks, noise: Floats, *, keypoints: int) -> Detections:
    """Return the detections of an individual.

    All detections of a view count alike: weights by confidence make poses of some detectors worse.

    seen: of N = frames x keypoints. noise: `[view]` in radians.
    """
    views = len(rig)
    rays = rays_in_world(rig, seen.rays).reshape(views, 3, -1, keypoints).transpose(1, 0, 3, 2)
    known = np.isfinite(seen.rays[:, 0]) & (seen.weight > 0)
    precision = (known / noise[:, None] ** 2).reshape(views, -1, keypoints).swapaxes(1, 2)
    return Detections(np.ascontiguousarray(rays), np.ascontiguousarray(precision), rig.centres)


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
    frames = np.arange(there[0], there[-1] + 1)
    last = there[np.searchsorted(there, frames, side="right") - 1]
    following = there[np.searchsorted(there, frames)]
    return frames[times[following] - times[last] <= longest + 1]


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
    for start in range(0, len(frames), _BLOCK):
        first = max(start - margin, 0)
        last = start + _BLOCK
        own = frames[first : last + margin]
        yield slice(start - first, min(last, len(frames)) - first), own


# Where the fit starts


def bone_lengths(points: Floats, sigma: Floats, edges: Ints) -> tuple[Floats, Floats]:
    """Return the length `[edge]` of each bone and how much it varies; NaN where it was never seen.

    points: `[frame, keypoint, 3]` triangulated; sigma: `[frame, keypoint]` of these, of all axes
    together. Noise across a bone makes it longer: that is taken off. A bone's length varies beyond
    its noise (standard deviation): detectors see joints elsewhere as a body turns, and spines bend.
    Half of the values are within the median of a normal error; each counts by its whole variance,
    robustly.
    """
    a, b = edges.T
    length = np.linalg.norm(points[:, a] - points[:, b], axis=-1)
    noise = (sigma[:, a] ** 2 + sigma[:, b] ** 2) / 3
    known = np.isfinite(length) & np.isfinite(noise) & (length > 0)
    seen = np.flatnonzero(known.any(0))
    known, length, noise = (each[:, seen].T for each in (known, length, noise))
    length, noise = (np.where(known, each, np.nan) for each in (length, noise))
    length -= np.minimum(noise / length, length / 2)
    usual = np.nanmedian(noise, axis=1)[:, None]
    middle = np.nanmedian(np.where(noise <= usual, length, np.nan), axis=1)
    varies = np.zeros(len(seen))
    for _ in range(ROUNDS):
        square = (length - middle[:, None]) ** 2
        varies = np.maximum(np.nanmedian(square / _MEDIAN_SQUARE - noise, axis=1), 0.0)
        weight = np.where(known, 1 / (noise + varies[:, None] + square / 4), 0.0)
        middle = (weight * np.where(known, length, 0.0)).sum(1) / weight.sum(1)
    found = np.full((2, len(edges)), np.nan)
    found[:, seen] = middle, np.sqrt(varies)
    return found[0], found[1]


def with_second_neighbours(bones: Ints, keypoints: int) -> Ints:
    """Return bones `[bone, 2]` and then the pairs that two bones join, all of them `[edge, 2]`.

    Hips, shoulders and heads hardly change their shape: the ends of two bones of theirs are as far
    from each other as those of one. Those of a leg are not; how much they vary is measured.
    """
    joined = np.zeros((keypoints, keypoints), dtype=np.int64)
    a, b = bones.T
    joined[a, b] = joined[b, a] = 1
    second = np.triu((joined @ joined > 0) & (joined == 0), k=1)
    return np.concatenate([bones, np.argwhere(second)])


def fill_gaps(points: Floats, times: Floats) -> Floats:
    """Return points `[frame, keypoint, 3]` without gaps.

    The joint that is known most often is interpolated in time, and the others by their offsets from
    it. times: `[frame]`.
    """
    known = np.isfinite(points[..., 0])
    middle = int(known.sum(0).argmax())
    filled = np.zeros(points.shape)
    for joint in (middle, *range(points.shape[1])):
        there, base = known[:, joint], filled[:, middle]
        between = np.zeros(base.shape)
        if there.any():
            offset = points[there, joint] - base[there]
            between = np.transpose([np.interp(times, times[there], axis) for axis in offset.T])
        filled[:, joint] = base + between
    return filled


def arrays_to_fill(poses: Poses3D, fitted: list[int]) -> dict[str, Any]:
    """Return positions, covariance and source: of those who are fitted, nothing yet.

    Of the others they are as they were triangulated. fitted: indices of individuals.
    """
    arrays: dict[str, Any] = {
        "positions": mapped.empty(poses.raw.shape, poses.raw.dtype),
        "covariance": mapped.empty(poses.covariance.shape, poses.covariance.dtype),
        "source": mapped.empty(poses.source.shape, np.int8),
    }
    known = {"positions": poses.raw, "covariance": poses.covariance, "source": poses.source}

    def fill(block: slice) -> None:
        for name, array in arrays.items():
            array[block] = known[name][block]
            array[block, fitted] = 0 if name == "source" else np.nan

    do_in_threads(fill, mapped.frame_slices(len(poses.frames)))
    return arrays
