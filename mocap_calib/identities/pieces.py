"""Follow groups of detections as far as that is certain, and measure the bodies of these pieces.

A piece is a stretch of neighbouring frames in each of which one group is the same individual. It
ends where the group vanishes, and where another could as well go on as it: `track` joins the pieces
of one individual.

Bone lengths are metric up to one scale. They distinguish individuals as far as those that are seen
together differ, and prove as much as they do in this recording: their evidence is calibrated on the
halves of pieces, which are of one individual, against pieces that are seen together.
"""

from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.parallel import do_in_threads
from mocap_calib.config import LEAST_JOINTS, MatchingConfig
from mocap_calib.geometry.graphs import connected_parts, spanning_tree
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.rig import replace_labels
from mocap_calib.rig.associate import LogRatio, measure_log_ratio
from mocap_calib.rig.triangulate import frame_blocks
from mocap_calib.types import Bools, Floats, Ints

SAMPLE = 2000  # groups that scales and spreads are measured on
# standard deviations over the median distance of a normal error from 0
_NORMAL = 1 / NormalDist().inv_cdf(0.75)
_LEAST_SPREAD = 0.005  # of the logarithm of a length


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

    def join(self, individual: Ints) -> "Pieces":
        """Return the individuals `[piece]` as pieces, which may have gaps."""
        latest = np.lexsort((self.last[:, 0], individual))
        return replace(
            self,
            number=replace_labels(self.number, individual),
            first=self.first[np.unique(individual, return_index=True)[1]],
            last=self.last[latest[np.diff(individual[latest], append=-1) != 0]],
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
    frames, groups, joints = points.shape[:3]
    distance = np.empty((max(frames - 1, 0), groups, groups))

    def measure(block: Ints) -> None:
        earlier, later = points[block][:, :, None], points[block + 1][:, None]
        distance[mapped.as_slice(block)] = rms_distance(earlier, later)

    do_in_threads(measure, frame_blocks(frames - 1, groups**2 * joints))
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


@dataclass(frozen=True)
class BoneLengths:
    """The bones of pieces or of individuals: logarithms of lengths, which a log-normal describes.

    precision: `[body, bone]` 1 / variance of the mean, 0 = never seen. total: `[body, bone]` the
    mean times this. apart: `[bone]` variance between individuals. ratio: of their log-likelihood
    ratio that bodies are one, what it proves; None where that is not known.
    """

    total: Floats
    precision: Floats
    apart: Floats
    ratio: LogRatio | None = None

    def select(self, bodies: Ints) -> "BoneLengths":
        """Return a copy of these bodies (indices) alone."""
        return replace(self, total=self.total[bodies], precision=self.precision[bodies])

    def join(self, individual: Ints) -> "BoneLengths":
        """Return the bodies of individuals, `[body]`."""
        precision = np.zeros((int(individual.max(initial=-1)) + 1, len(self.apart)))
        total = precision.copy()
        np.add.at(precision, individual, self.precision)
        np.add.at(total, individual, self.total)
        return replace(self, total=total, precision=precision)

    @property
    def mean(self) -> Floats:
        """`[body, bone]`, 0 = never seen."""
        return self.total / np.maximum(self.precision, np.finfo(float).tiny)

    def evidence(self, body: int) -> Floats:
        """Return `[body]` the evidence in nats that each is the same as this one, 0 = none."""
        if self.ratio is None:
            return np.zeros(len(self.total))
        return self.ratio(self.likeness(np.arange(len(self.total)), np.array([body]))[:, None])

    def likeness(self, first: Ints, second: Ints) -> Floats:
        """Return `[pair]` log-likelihood ratios that two bodies are one, NaN without common bones.

        Of Student's t with three degrees of freedom, and of bones as if they were independent.
        """
        square, same = _compare(self, first, second)
        other = same + 2 * self.apart
        nats = 0.5 * np.log(other / same)
        nats += 2 * (np.log1p(square / (3 * other)) - np.log1p(square / (3 * same)))
        return np.where(np.isfinite(square).any(-1), np.nansum(nats, axis=-1), np.nan)


def _compare(bodies: BoneLengths, first: Ints, second: Ints) -> tuple[Floats, Floats]:
    """Return squared differences of bones and their variances, `[pair, bone]`, NaN = not known."""
    precision = bodies.precision[first], bodies.precision[second]
    known = (precision[0] > 0) & (precision[1] > 0)
    square = np.where(known, (bodies.mean[first] - bodies.mean[second]) ** 2, np.nan)
    return square, np.asarray(sum(1 / np.where(known, each, np.nan) for each in precision))


def measure_bones(points: Floats, pieces: Pieces, longest: int) -> BoneLengths:
    """Return the bone lengths of all pieces, between the joints that are most rigid.

    points: `[frame, group, joint, 3]`. longest: how many pieces, the longest, are compared with
    those seen at the same time.
    """
    bones, spread = _find_bones(points, pieces)
    frame, group = np.nonzero(pieces.number >= 0)
    piece = pieces.number[frame, group]
    middle = (pieces.first[:, 0] + pieces.last[:, 0] + 1) // 2
    half = 2 * piece + (frame >= middle[piece])
    lengths = _log_lengths(points, bones, frame, group)
    mean = np.full((2 * len(pieces.first), len(bones)), np.nan)
    order = np.argsort(half, kind="stable")
    for part in np.split(order, np.flatnonzero(np.diff(half[order])) + 1):
        if len(part):
            mean[half[part[0]]] = _medians(lengths[part])
    residual = np.abs(lengths - mean[half])
    some = evenly_spaced(np.arange(len(residual)), SAMPLE)
    spread = np.fmax(spread, _NORMAL * _medians(residual[some]) + _LEAST_SPREAD)
    # a body errs in each pose, and neighbouring frames err together: a half, or a piece, is as
    # certain as one frame and one pose
    precision = np.isfinite(mean) / (2 * spread**2)
    halves = BoneLengths(np.nan_to_num(mean) * precision, precision, np.zeros(len(bones)))
    whole = halves.join(np.arange(len(mean)) // 2)
    certain = np.minimum(whole.precision, 1 / (2 * spread**2))
    whole = replace(whole, total=whole.mean * certain, precision=certain)
    own, other = _halves(pieces, longest)
    square, variance = _compare(whole, *(other // 2).T)
    apart = 0.5 * (_NORMAL**2 * _medians(square) - _medians(variance))
    halves = replace(halves, apart=np.maximum(np.nan_to_num(apart), 0.0))
    one = (np.arange(len(own) + len(other)) < len(own)).astype(np.float64)
    likeness = halves.likeness(*np.concatenate([own, other]).T)
    return replace(
        whole, apart=halves.apart, ratio=measure_log_ratio(likeness[:, None], one, 1 - one)
    )


def _halves(pieces: Pieces, count: int) -> tuple[Ints, Ints]:
    """Return pairs `[pair, 2]` of halves of one piece, and of pieces that are seen together.

    A piece has the halves 2 x its number and that + 1. Of so many pieces, the longest.
    """
    longest = np.sort(np.argsort(-pieces.lengths, kind="stable")[:count])
    own = 2 * longest[pieces.lengths[longest] > 1]
    first, last = pieces.first[longest, 0], pieces.last[longest, 0]
    together = (first[:, None] <= last) & (first <= last[:, None])
    i, j = (2 * longest[index] for index in np.nonzero(np.triu(together, 1)))
    two = [np.stack([i + a, j + b], axis=-1) for a in (0, 1) for b in (0, 1)]
    return np.stack([own, own + 1], axis=-1), np.concatenate(two)


def _find_bones(points: Floats, pieces: Pieces) -> tuple[Ints, Floats]:
    """Return the pairs of joints `[bone, 2]` whose distance changes least, and by how much.

    They are the tree of the joints of least changes, so that no length follows from others: in
    people and animals mostly the bones. The spread `[bone]` is the usual change of the logarithm
    between neighbouring frames, of groups that are each other's nearest.
    """
    joints = points.shape[2]
    a, b = np.triu_indices(joints, 1)
    pairs = np.stack([a, b], axis=-1)
    frame, i, j = np.nonzero(pieces.nearest)
    some = evenly_spaced(np.arange(len(frame)), SAMPLE)
    frame, i, j = frame[some], i[some], j[some]
    before = _log_lengths(points, pairs, frame, i)
    usual = (
        _NORMAL / np.sqrt(2) * _medians(np.abs(_log_lengths(points, pairs, frame + 1, j) - before))
        + _LEAST_SPREAD
    )
    cost = np.full((joints, joints), np.inf)
    cost[a, b] = np.nan_to_num(usual * np.exp(_medians(before)), nan=np.inf)
    bones = np.unique(np.sort(spanning_tree(cost), axis=1), axis=0)
    spread = np.zeros((joints, joints))
    spread[a, b] = np.nan_to_num(usual)
    return bones, spread[tuple(bones.T)]


def _log_lengths(points: Floats, pairs: Ints, frame: Ints, group: Ints) -> Floats:
    """Return the logarithms of the distances `[body, pair]` of joints, NaN where one is missing.

    pairs: `[pair, 2]` joints; frame, group: `[body]`. In blocks, as copies of the joints of all
    bodies of a long recording would not fit in memory.
    """
    lengths = np.empty((len(frame), len(pairs)))
    a, b = pairs.T

    def measure(block: slice) -> None:
        bodies = np.ascontiguousarray(np.moveaxis(points[frame[block], group[block]], -1, 0))
        square = np.asarray(sum((part[:, a] - part[:, b]) ** 2 for part in bodies))
        lengths[block] = np.log(np.maximum(square, np.finfo(float).tiny)) / 2

    do_in_threads(measure, mapped.frame_slices(len(frame)))
    return lengths


def _medians(values: Floats) -> Floats:
    """Return the lower medians of columns without NaN; NaN of nothing."""
    if not len(values):
        return np.full(values.shape[1], np.nan)
    ordered = np.sort(values, axis=0)  # NaN last
    middle = np.maximum(np.isfinite(values).sum(0) - 1, 0) // 2
    return np.asarray(ordered[middle, np.arange(values.shape[1])])
