"""Bone lengths: whether two pieces of tracks are one individual.

Lengths are metric up to one scale. They distinguish individuals as far as those that are seen
together differ, and prove as much as they do in this recording: their evidence is calibrated on the
halves of pieces, which are of one individual, against pieces that are seen together.
"""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.parallel import do_in_threads
from mocap_calib.geometry.graphs import spanning_tree
from mocap_calib.identities.pieces import SAMPLE, Pieces
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.rig.associate import LogRatio, measure_log_ratio
from mocap_calib.types import Floats, Ints

_NORMAL = 1.48  # standard deviations over the median distance of a normal error from 0
_LEAST_SPREAD = 0.005  # of the logarithm of a length
_ENOUGH = 3  # frames of a half, whose median is more than its own
_MEMORY = 10  # frames after which a body errs in another way


@dataclass(frozen=True)
class BoneLengths:
    """The bones of pieces or of individuals: logarithms of lengths, which a log-normal describes.

    mean: `[body, bone]`; precision: `[body, bone]` 1 / variance of the mean, 0 = never seen.
    apart: `[bone]` variance between individuals. ratio: of their log-likelihood ratio that bodies
    are one, what it proves; None where that is not known.
    """

    mean: Floats
    precision: Floats
    apart: Floats
    ratio: LogRatio | None = None

    def copy(self) -> "BoneLengths":
        """Return the same bodies, of which nothing is changed with these."""
        return BoneLengths(self.mean.copy(), self.precision.copy(), self.apart, self.ratio)

    def select(self, among: Ints) -> "BoneLengths":
        """Return these bodies alone."""
        return BoneLengths(self.mean[among], self.precision[among], self.apart, self.ratio)

    def join_all(self, individual: Ints) -> "BoneLengths":
        """Return the bodies of individuals `[piece]`, -1 = unassigned."""
        there = individual >= 0
        precision = np.zeros((int(individual.max(initial=-1)) + 1, len(self.apart)))
        total = precision.copy()
        np.add.at(precision, individual[there], self.precision[there])
        np.add.at(total, individual[there], (self.precision * self.mean)[there])
        mean = total / np.maximum(precision, np.finfo(float).tiny)
        return BoneLengths(mean, precision, self.apart, self.ratio)

    def join(self, kept: int, merged: int) -> None:
        """Make `kept` the body that both are, in place."""
        precision = self.precision[[kept, merged]]
        total = precision.sum(0)
        weighted = (precision * self.mean[[kept, merged]]).sum(0)
        self.mean[kept] = weighted / np.maximum(total, np.finfo(float).tiny)
        self.precision[kept] = total

    def evidence(self, body: int) -> Floats:
        """Return `[body]` the evidence in nats that each is the same as this one, 0 = none."""
        if self.ratio is None:
            return np.zeros(len(self.mean))
        likeness = self.likeness(np.arange(len(self.mean)), body)
        return np.where(np.isfinite(likeness), self.ratio(likeness[:, None]), 0.0)

    def likeness(self, first: Ints, second: Ints | int) -> Floats:
        """Return `[pair]` log-likelihood ratios that two bodies are one, NaN without common bones.

        Of Student's t with three degrees of freedom, and of bones as if they were independent.
        """
        precision = self.precision[first], self.precision[second]
        known = (precision[0] > 0) & (precision[1] > 0)
        same = sum(1 / np.where(known, each, 1.0) for each in precision)
        other = same + 2 * self.apart
        square = (self.mean[first] - self.mean[second]) ** 2
        nats = 0.5 * np.log(other / same)
        nats += 2 * (np.log1p(square / (3 * other)) - np.log1p(square / (3 * same)))
        return np.where(known.any(-1), np.where(known, nats, 0.0).sum(-1), np.nan)


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
    mean, seen = np.zeros((2, 2 * pieces.count, len(bones)))
    order = np.argsort(half, kind="stable")
    for part in np.split(order, np.flatnonzero(np.diff(half[order])) + 1):
        if len(part):
            mean[half[part[0]]] = np.nan_to_num(_medians(lengths[part]))
            seen[half[part[0]]] = np.isfinite(lengths[part]).sum(0)
    residual = np.abs(lengths - mean[half])[seen[half].max(1) >= _ENOUGH]
    some = evenly_spaced(np.arange(len(residual)), SAMPLE)
    spread = np.fmax(spread, _NORMAL * _medians(residual[some]) + _LEAST_SPREAD)
    own, other = _halves(pieces, longest)
    halves = BoneLengths(mean, _precision(seen, spread), np.zeros(len(bones)))
    whole = halves.join_all(np.arange(2 * pieces.count) // 2)
    whole = replace(whole, precision=_precision(seen[::2] + seen[1::2], spread))
    apart = _variance_apart(whole, other // 2)
    halves = replace(halves, apart=apart)
    pairs = np.concatenate([own, other])
    one = (np.arange(len(pairs)) < len(own)).astype(np.float64)
    ratio = measure_log_ratio(halves.likeness(*pairs.T)[:, None], one, 1 - one)
    return replace(whole, apart=apart, ratio=ratio)


def _precision(seen: Floats, spread: Floats) -> Floats:
    """Return `[body, bone]` 1 / variance of lengths that were seen in so many frames, 0 = never.

    Neighbouring frames err together, and each pose in its own way, which no frame more takes away.
    """
    independent = 1 + np.maximum(seen - 1, 0) / _MEMORY
    return np.where(seen > 0, 1 / (spread**2 * (1 / independent + 1)), 0.0)


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


def _variance_apart(bodies: BoneLengths, pairs: Ints) -> Floats:
    """Return the variance of each bone `[bone]` between pairs of bodies that are two."""
    i, j = pairs.T
    known = (bodies.precision[i] > 0) & (bodies.precision[j] > 0)
    own = sum(1 / np.where(known, bodies.precision[k], 1.0) for k in (i, j))
    square = np.where(known, (bodies.mean[i] - bodies.mean[j]) ** 2, np.nan)
    excess = 0.5 * (_NORMAL**2 * _medians(square) - _medians(np.where(known, own, np.nan)))
    return np.asarray(np.maximum(np.nan_to_num(excess), 0.0))


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
