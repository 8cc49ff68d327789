"""Follow groups of detections through space, as far as there is no doubt who goes on as whom.

A piece is a stretch of neighbouring frames in each of which one group is the same individual. It
ends where the group vanishes, and where another could as well go on as it: `join`
says who the pieces are.
"""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.parallel import do_in_threads
from mocap_calib.config import LEAST_JOINTS, MatchingConfig
from mocap_calib.geometry.graphs import connected_parts
from mocap_calib.types import Bools, Floats, Ints

SAMPLE = 2000  # groups that scales and spreads are measured on
_FRAMES = 512  # compared at a time


@dataclass(frozen=True)
class Pieces:
    """Stretches of frames in which one group is certainly one individual.

    number: `[frame, group]` the piece that a group is in, -1 = there is no such group.
    before, after: `[frame, group]` the same piece's group in the frame before and after, -1 = none.
    first, last: `[piece, 2]` index of the frame and of the group at the ends of a piece.
    nearest: `[frame - 1, group, group]` groups that are each other's nearest in the next frame,
        certain or not. step: how far these are apart, the median.
    """

    number: Ints
    before: Ints
    after: Ints
    first: Ints
    last: Ints
    nearest: Bools
    step: float

    @property
    def count(self) -> int:
        """How many pieces there are."""
        return len(self.first)

    def join(self, individual: Ints) -> "Pieces":
        """Return the individuals `[piece]` as pieces, which may have gaps; -1 = nobody."""
        there = np.flatnonzero(individual >= 0)
        _, first = np.unique(individual[there], return_index=True)
        latest = there[np.lexsort((self.last[there, 0], individual[there]))]
        last = np.flatnonzero(np.diff(individual[latest], append=-1))
        return replace(
            self,
            number=np.append(individual, -1)[self.number],
            first=self.first[there[first]],
            last=self.last[latest[last]],
        )

    @property
    def lengths(self) -> Ints:
        """`[piece]` number of frames from the first to the last."""
        return self.last[:, 0] - self.first[:, 0] + 1


def rms_distance(a: Floats, b: Floats) -> Floats:
    """Return the RMS distance `[...]` of the joints that two bodies `[..., joint, 3]` both have.

    Infinite where these are too few.
    """
    squares = ((a - b) ** 2).sum(-1)
    common = np.isfinite(squares)
    joints = common.sum(-1)
    total = np.where(common, squares, 0.0).sum(-1)
    return np.where(joints >= LEAST_JOINTS, np.sqrt(total / np.maximum(joints, 1)), np.inf)


def surprise(distance: Floats, scale: Floats | float) -> Floats:
    """Return how unlikely a distance in space is, in nats: Student's t with three degrees.

    It grows with the logarithm of large distances: what jumps once is not refused for ever.
    """
    return 3 * np.log1p((distance / scale) ** 2 / 3)


def step_distances(points: Floats) -> Floats:
    """Return how far each group is from each of the next frame, `[frame - 1, group, group]`.

    points: `[frame, group, joint, 3]`.
    """
    frames, groups = points.shape[:2]
    distance = np.empty((max(frames - 1, 0), groups, groups))

    def measure(block: slice) -> None:
        later = points[block.start + 1 : block.stop + 1]
        distance[block] = rms_distance(points[block][:, :, None], later[:, None])

    do_in_threads(measure, mapped.frame_slices(frames - 1, _FRAMES))
    return distance


def usual_step(distance: Floats) -> float:
    """Return the median distance of groups from the nearest of the next frame; NaN = nobody.

    distance: `[frame - 1, group, group]` of `step_distances`.
    """
    near = distance[_nearest_both_ways(distance)]
    return float(np.median(near)) if len(near) else np.nan


def cut_into_pieces(points: Floats, frames: Ints, config: MatchingConfig) -> Pieces:
    """Follow the groups of each frame into the next as far as that is certain.

    points: `[frame, group, joint, 3]`, NaN = missing; frames: `[frame]` numbers.
    """
    present = mapped.in_blocks(
        lambda block: np.isfinite(points[block, ..., 0]).any(-1), len(points)
    )
    distance = np.where(_follows(frames)[:, None, None], step_distances(points), np.inf)
    links = _certain_links(distance, config)
    return _number_pieces(links, present, distance)


def _follows(frames: Ints) -> Bools:
    """Return which frames `[frame - 1]` are as near to the next as frames usually are."""
    gaps = np.diff(frames)
    return gaps <= (np.median(gaps) if len(gaps) else 1)


def _nearest_both_ways(distance: Floats) -> Bools:
    """Return the pairs of groups that are each other's nearest, in the shape of `distance`."""
    if distance.size == 0:
        return np.zeros(distance.shape, dtype=bool)
    nearest = (distance == distance.min(-1, keepdims=True)) & (
        distance == distance.min(-2, keepdims=True)
    )
    return nearest & np.isfinite(distance)


def _certain_links(distance: Floats, config: MatchingConfig) -> Bools:
    """Return the pairs of groups that are one individual beyond doubt.

    Each other's nearest, as near as bodies usually are, of which all others are by
    `config.decisive` nats less likely: who vanishes may have appeared near another who does.
    """
    links: Bools = _nearest_both_ways(distance)
    if not links.any():
        return links
    cost = surprise(distance, max(float(np.median(distance[links])), np.finfo(float).tiny))
    links = np.asarray(links & (cost <= config.decisive))
    for axis in (-1, -2):
        rivals = np.where(links, np.inf, cost).min(axis, keepdims=True)
        with np.errstate(invalid="ignore"):
            links = np.asarray(links & (rivals - cost >= config.decisive))
    return links


def _number_pieces(links: Bools, present: Bools, distance: Floats) -> Pieces:
    """Return the pieces that links `[frame - 1, group, group]` make of the groups that are there.

    They are numbered in the order of their first frames.
    """
    before = np.full(present.shape, -1, dtype=np.int64)
    after = before.copy()
    frame, i, j = np.nonzero(links)
    before[frame + 1, j] = i
    after[frame, i] = j

    groups = present.shape[1]
    earlier, later = frame * groups + i, (frame + 1) * groups + j
    component = connected_parts(earlier, later, present.size)[present.ravel()]
    _, begin, inverse = np.unique(component, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(begin))
    number = np.full(present.shape, -1, dtype=np.int64)
    number[present] = rank[inverse]
    ends = np.argwhere(present & (after < 0))
    return Pieces(
        number=number,
        before=before,
        after=after,
        first=np.argwhere(present & (before < 0)),
        last=ends[np.argsort(number[tuple(ends.T)])],
        nearest=_nearest_both_ways(distance),
        step=usual_step(distance),
    )
