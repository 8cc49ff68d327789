"""Where the fit starts: bones' lengths, and triangulated points with their gaps filled in."""

from typing import Any

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.medians import known_medians
from mocap_calib.compute.parallel import do_in_threads
from mocap_calib.config import TriangulateConfig
from mocap_calib.results import Matches, Poses3D
from mocap_calib.rig.triangulate import frame_blocks, triangulate_frames
from mocap_calib.types import Bools, CameraRig, Floats, Ints, Recording

_MEDIAN_SQUARE = 0.455  # of normal errors of variance 1


def add_refused(
    recording: Recording,
    rig: CameraRig,
    matches: Matches,
    points: Floats,
    *,
    noise: Floats,
    config: TriangulateConfig,
) -> Floats:
    """Return triangulated points with those that a wider limit lets through where there are none.

    Where frames do not follow each other, views that disagree by more than their noise are still
    the best evidence, and the robust fit decides between them: MVOR has 45.5 % of its joints with
    it, 43.6 % without. In motions interpolated points are better.

    points: `[frame, individual, keypoint, 3]`. noise: `[view]` in radians. config: with the wider
    limit.
    """
    frames, individuals, keypoints, _ = points.shape
    found = mapped.empty(points.shape)
    for block in frame_blocks(frames, individuals * keypoints):
        _, wider, _ = triangulate_frames(
            block, recording=recording, rig=rig, matches=matches, noise=noise, config=config
        )
        own = points[block]
        found[block] = np.where(np.isfinite(own), own, wider.T.reshape(own.shape))
        mapped.let_go()
    return found


def bone_lengths(points: Floats, sigma: Floats, edges: Ints) -> tuple[Floats, Floats]:
    """Return the length `[edge]` of each bone and how much it varies; NaN where it was never seen.

    points: `[frame, keypoint, 3]` triangulated; sigma: `[frame, keypoint]` of these, of all axes
    together. Noise across a bone makes it longer: that is taken off.
    """
    found = np.full((2, len(edges)), np.nan)
    length, noise = _measure_bones(points, sigma, edges)
    seen = np.flatnonzero(np.isfinite(length).any(1))
    length, noise = length[seen], noise[seen]
    length -= np.minimum(noise / length, length / 2)
    found[:, seen] = _middle_and_spread(length, noise)
    return found[0], found[1]


def _measure_bones(points: Floats, sigma: Floats, edges: Ints) -> Floats:
    """Return lengths and the variances of their noise `[2, edge, frame]`, both NaN or neither.

    points, sigma: as of `bone_lengths`.
    """
    a, b = edges.T
    along = (points[:, a, axis] - points[:, b, axis] for axis in range(3))
    length = np.sqrt(np.asarray(sum(part * part for part in along)))
    noise = (sigma[:, a] ** 2 + sigma[:, b] ** 2) / 3
    known = np.isfinite(length) & np.isfinite(noise) & (length > 0)
    return np.stack([np.where(known, each, np.nan).T for each in (length, noise)])


def reach_of_bones(lengths: Floats, varies: Floats, bones: Ints, keypoints: int) -> Floats:
    """Return how far each keypoint can be from each other `[keypoint, keypoint]`.

    That is the sum of the bones between them, each as long as three standard deviations of what it
    varies by allow; inf where no bones of known length lead from one to the other.

    lengths, varies: `[bone]` as `bone_lengths` finds them.
    """
    known = np.isfinite(lengths)
    a, b = bones[known].T
    reach = np.where(np.eye(keypoints, dtype=bool), 0.0, np.inf)
    reach[a, b] = reach[b, a] = (lengths + 3 * varies)[known]
    for via in range(keypoints):  # Floyd and Warshall 1962; scipy's graphs take long to import
        reach = np.minimum(reach, reach[:, via, None] + reach[via])
    return reach


def are_beyond_reach(points: Floats, reach: Floats) -> Bools:
    """Return which points `[frame, keypoint]` are farther from most of the others than is possible.

    Two views that take the same thing in the background for a joint agree on where it is. What the
    bones allow, they do not.

    points: `[frame, keypoint, 3]`. reach: `[keypoint, keypoint]` the largest possible distances.
    """
    known = np.triu(np.isfinite(reach), k=1)
    a, b = np.nonzero(known)
    square = sum((axis[:, a] - axis[:, b]) ** 2 for axis in points.transpose(2, 0, 1))
    ends = ((a[:, None] == np.arange(len(reach))) | (b[:, None] == np.arange(len(reach)))) * 1.0
    beyond, compared = square > reach[known] ** 2, np.isfinite(square)
    return np.asarray(2 * (beyond @ ends) > compared @ ends)


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


def _middle_and_spread(values: Floats, noise: Floats) -> tuple[Floats, Floats]:
    """Return the middle of rows of values and their standard deviation beyond that of their noise.

    values, noise: `[edge, N]`, noise as variances, NaN where there is none. Returns `[edge]` each.
    A bone's length varies as well: detectors see joints elsewhere as a body turns, and spines bend.
    Half of the values are within the median of a normal error; each counts by its whole variance,
    robustly.
    """
    usual = known_medians(noise)[:, None]
    middle, varies = known_medians(np.where(noise <= usual, values, np.nan)), np.zeros(len(values))
    known = np.isfinite(values)
    there = np.where(known, values, 0.0)
    for _ in range(10):
        square = (values - middle[:, None]) ** 2
        varies = np.maximum(known_medians(square / _MEDIAN_SQUARE - noise), 0.0)
        weight = np.where(known, 1 / (noise + varies[:, None] + square / 4), 0.0)
        middle = (weight * there).sum(1) / weight.sum(1)
    return middle, np.sqrt(varies)


def fill_gaps(points: Floats, times: Floats, edges: Ints) -> Floats:
    """Return points `[frame, keypoint, 3]` without gaps.

    The joint that is known most often is interpolated in time, what hangs on it by its offset from
    it, and so on outwards. times: `[frame]`.
    """
    known = np.isfinite(points[..., 0])
    filled = points.copy()
    middle = np.zeros((len(points), 3))
    done: dict[int, None] = {}
    for joint, anchor in _outwards(known.sum(0), edges):
        base = filled[:, anchor] if anchor >= 0 else middle
        there = known[:, joint]
        offset = points[there, joint] - base[there]
        for axis in range(3):
            if there.any():
                between = np.interp(times, times[there], offset[:, axis])
            else:
                between = np.zeros(len(points))
            filled[:, joint, axis] = np.where(
                there, points[:, joint, axis], base[:, axis] + between
            )
        if anchor < 0 and not done:
            middle = filled[:, joint]
        done[joint] = None
    return filled


def _outwards(count: Ints, edges: Ints) -> list[tuple[int, int]]:
    """Return pairs (joint, the joint that it is filled in from), -1 for those that start."""
    order: list[tuple[int, int]] = []
    left = set(range(len(count)))
    while left:
        start = max(left, key=lambda joint: (count[joint], -joint))
        queue = [(start, -1)]
        left.discard(start)
        while queue:
            queue.sort(key=lambda pair: (-count[pair[0]], pair[0]))
            joint, anchor = queue.pop(0)
            order.append((joint, anchor))
            for a, b in edges.tolist():
                other = b if a == joint else a if b == joint else -1
                if other in left:
                    left.discard(other)
                    queue.append((other, joint))
    return order


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
