"""The proportions of bodies: by the lengths of bones, pieces of tracks are one individual or two.

Lengths are metric up to one scale, and tell individuals apart as far as those that are seen
together differ: where these are alike, lengths say nothing of others.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.parallel import do_in_threads, map_in_threads
from mocap_calib.config import MatchingConfig
from mocap_calib.geometry.graphs import spanning_tree
from mocap_calib.identities.pieces import Pieces
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import Floats, Ints

_SAMPLE = 2000  # groups that spreads are measured on
_LONGEST = 500  # pieces that are compared with those seen at the same time
_NORMAL = 1.48  # standard deviations over the median distance of a normal error from 0
_NORMAL_SQUARE = 0.455  # the median square of a normal error over its variance
_NO_LENGTH = 1e-12
_BODIES = 8192  # measured at a time


@dataclass(frozen=True)
class Proportions:
    """The bodies of pieces or of individuals: logarithms of lengths, which a log-normal describes.

    mean: `[body, bone]`; precision: `[body, bone]` 1 / variance of the mean, 0 = never seen.
    apart: `[bone]` variance between individuals.
    """

    mean: Floats
    precision: Floats
    apart: Floats

    def copy(self) -> "Proportions":
        """Return the same bodies, of which nothing is changed with these."""
        return Proportions(self.mean.copy(), self.precision.copy(), self.apart)

    def select(self, among: Ints) -> "Proportions":
        """Return these bodies alone."""
        return Proportions(self.mean[among], self.precision[among], self.apart)

    def join_all(self, individual: Ints) -> "Proportions":
        """Return the bodies of individuals `[piece]`, -1 = nobody."""
        there = individual >= 0
        names = int(individual.max(initial=-1)) + 1
        precision = np.zeros((names, len(self.apart)))
        total = precision.copy()
        np.add.at(precision, individual[there], self.precision[there])
        np.add.at(total, individual[there], (self.precision * self.mean)[there])
        return Proportions(total / np.maximum(precision, 1e-300), precision, self.apart)

    def join(self, kept: int, merged: int) -> None:
        """Make `kept` the body that both are, in place."""
        total = self.precision[kept] + self.precision[merged]
        weighted = self.precision[[kept, merged]] * self.mean[[kept, merged]]
        self.mean[kept] = weighted.sum(0) / np.maximum(total, 1e-300)
        self.precision[kept] = total

    def evidence(self, body: int) -> Floats:
        """Return `[body]` the evidence that each is the same as this one."""
        same_as = (self.mean[body], self.precision[body])
        return _same_lengths(self.mean, self.precision, *same_as, apart=self.apart)

    def evidence_of(self, individual: Ints, names: int) -> Floats:
        """Return `[piece, individual]` the evidence that a piece is of each of so many.

        individual: `[piece]` who is thought to be who. A piece does not speak for itself.
        """
        weighted = self.precision * self.mean
        found = np.empty((len(individual), names))
        for name in range(names):
            own = individual == name
            precision = self.precision[own].sum(0) - np.where(own[:, None], self.precision, 0.0)
            total = weighted[own].sum(0) - np.where(own[:, None], weighted, 0.0)
            mean = total / np.maximum(precision, 1e-300)
            precision = np.where(precision > 1e-9 * self.precision, precision, 0.0)
            found[:, name] = _same_lengths(
                self.mean, self.precision, mean, precision, apart=self.apart
            )
        return found


def _same_lengths(
    mean_a: Floats, precision_a: Floats, mean_b: Floats, precision_b: Floats, *, apart: Floats
) -> Floats:
    """Return `[...]` the evidence of lengths `[..., bone]` that two bodies are one."""
    known = (precision_a > 0) & (precision_b > 0)
    same = sum(1 / np.where(known, precision, 1.0) for precision in (precision_a, precision_b))
    other = same + 2 * apart
    square = (mean_a - mean_b) ** 2
    nats = 0.5 * np.log(other / same)
    nats += 2 * (np.log1p(square / (3 * other)) - np.log1p(square / (3 * same)))
    return np.asarray(np.where(known, nats, 0.0).sum(-1))


def measure_proportions(points: Floats, pieces: Pieces, config: MatchingConfig) -> Proportions:
    """Return the lengths of the bodies of all pieces, between the joints that are most rigid.

    points: `[frame, group, joint, 3]`.
    """
    bones, spread = _find_bones(points, pieces, config)
    if not len(bones):
        nothing = np.zeros((pieces.count, 0))
        return Proportions(mean=nothing, precision=nothing.copy(), apart=np.zeros(0))
    frame, group = np.nonzero(pieces.number >= 0)
    lengths = _bone_lengths(points, bones, frame, group)
    piece = pieces.number[frame, group]
    order = np.argsort(piece, kind="stable")
    cuts = np.flatnonzero(np.diff(piece[order])) + 1
    parts = np.split(lengths[order], cuts)
    mean = np.concatenate(list(map_in_threads(_medians_of_parts, _in_groups(parts))))
    seen = np.stack([np.isfinite(part).sum(0) for part in parts])
    # neighbouring frames err together, and each pose in its own way
    independent = np.where(seen > 0, 1 + (seen - 1) / config.bone_memory, np.inf)
    variance = spread**2 * (1 / independent + config.bone_doubt**2)
    precision = np.where(seen > 0, 1 / variance, 0.0)
    mean = np.nan_to_num(mean)
    return Proportions(mean, precision, apart=_variance_apart(mean, precision, pieces))


def _in_groups(parts: list[Floats]) -> list[list[Floats]]:
    """Return parts `[body, bone]` in groups, each of which is worth a thread's while."""
    ends = np.cumsum([len(part) for part in parts])
    starts = np.flatnonzero(np.diff(ends // _BODIES, prepend=-1)).tolist()
    return [parts[start:end] for start, end in pairwise([*starts, len(parts)])]


def _medians_of_parts(parts: list[Floats]) -> Floats:
    """Return the medians `[part, bone]` of parts `[body, bone]`."""
    return np.stack([_medians(part) for part in parts])


def _bone_lengths(points: Floats, bones: Ints, frame: Ints, group: Ints) -> Floats:
    """Return the logarithms of the lengths `[body, bone]` of the bodies at `[body]` frame, group.

    In blocks, as copies of the joints of all bodies of a long recording would not fit in memory.
    """
    lengths = np.empty((len(frame), len(bones)))
    a, b = bones.T

    def measure(block: slice) -> None:
        lengths[block] = _log_lengths(points[frame[block], group[block]], (a, b))

    do_in_threads(measure, mapped.frame_slices(len(frame), _BODIES))
    return lengths


def _log_lengths(bodies: Floats, joints: tuple[Ints, Ints]) -> Floats:
    """Return the logarithms of the distances `[N, pair]` of joints, NaN where one is missing.

    bodies: `[N, joint, 3]`. joints: `[pair]` each.
    """
    a, b = joints
    by_component = np.ascontiguousarray(np.moveaxis(bodies, -1, 0))
    square = np.asarray(sum((part[:, a] - part[:, b]) ** 2 for part in by_component))
    return np.log(np.maximum(np.sqrt(square), _NO_LENGTH))


def _medians(values: Floats) -> Floats:
    """Return the medians of columns without NaN; NaN of nothing."""
    if not len(values):
        return np.full(values.shape[1], np.nan)
    known = np.isfinite(values)
    ordered = np.sort(values, axis=0)  # NaN last
    count = known.sum(0)
    middle = np.maximum(count - 1, 0) // 2
    return np.asarray(ordered[middle, np.arange(values.shape[1])])


def _find_bones(points: Floats, pieces: Pieces, config: MatchingConfig) -> tuple[Ints, Floats]:
    """Return the pairs of joints `[bone, 2]` whose distance changes least, and by how much.

    They are a tree of the joints, the one of least changes, so that no length follows from others:
    in people and animals mostly the bones. The spread `[bone]` is the standard deviation of the
    logarithm, of one individual.
    """
    joints = points.shape[2]
    pairs = np.triu_indices(joints, 1)
    steps = _length_changes(points, pieces, pairs)
    stays = _length_residuals(points, pieces, pairs, config)
    length = np.exp(_medians(np.concatenate([steps[1], stays[1]])))
    usual = np.fmax(
        _NORMAL / np.sqrt(2) * _medians(np.abs(steps[0])), _NORMAL * _medians(np.abs(stays[0]))
    )
    cost = np.full((joints, joints), np.inf)
    cost[pairs] = np.nan_to_num((usual + config.least_spread) * length, nan=np.inf)
    bones = np.unique(np.sort(spanning_tree(cost), axis=1), axis=0)
    spread = np.zeros((joints, joints))
    spread[pairs] = np.nan_to_num(usual) + config.least_spread
    return bones, spread[tuple(bones.T)]


def _length_changes(
    points: Floats, pieces: Pieces, joints: tuple[Ints, Ints]
) -> tuple[Floats, Floats]:
    """Return how much log-lengths change from a frame to the next, and these, `[N, pair]`.

    Of groups that are each other's nearest, most of which are one individual also where that is
    not certain.
    """
    frame, i, j = np.nonzero(pieces.nearest)
    chosen = evenly_spaced(np.arange(len(frame)), _SAMPLE)
    frame, i, j = frame[chosen], i[chosen], j[chosen]
    before, after = (
        _log_lengths(bodies, joints) for bodies in (points[frame, i], points[frame + 1, j])
    )
    return after - before, before


def _length_residuals(
    points: Floats, pieces: Pieces, joints: tuple[Ints, Ints], config: MatchingConfig
) -> tuple[Floats, Floats]:
    """Return how much log-lengths differ from the medians of pieces of some length, and these."""
    long = np.isin(pieces.number, np.flatnonzero(pieces.lengths >= config.least_evidence))
    where = np.argwhere(long & (pieces.number >= 0))
    where = where[evenly_spaced(np.arange(len(where)), _SAMPLE)]
    bodies = points[tuple(where.T)]
    lengths = _log_lengths(bodies, joints)
    piece = pieces.number[tuple(where.T)]
    residual = lengths.copy()
    for number in np.unique(piece):
        residual[piece == number] -= _medians(lengths[piece == number])
    return residual, lengths


def _variance_apart(mean: Floats, precision: Floats, pieces: Pieces) -> Floats:
    """Return the variance of each bone `[bone]` between individuals that are seen together."""
    longest = np.sort(np.argsort(-pieces.lengths, kind="stable")[:_LONGEST])
    first, last = pieces.first[longest, 0], pieces.last[longest, 0]
    together = (first[:, None] <= last[None]) & (first[None] <= last[:, None])
    i, j = np.nonzero(np.triu(together, 1))
    i, j = longest[i], longest[j]
    known = (precision[i] > 0) & (precision[j] > 0)
    own = sum(1 / np.where(known, precision[k], 1.0) for k in (i, j))
    square = np.where(known, (mean[i] - mean[j]) ** 2, np.nan)
    excess = 0.5 * (_medians(square) / _NORMAL_SQUARE - _medians(np.where(known, own, np.nan)))
    return np.asarray(np.maximum(np.nan_to_num(excess), 0.0))
