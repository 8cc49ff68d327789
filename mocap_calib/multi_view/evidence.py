"""Which pieces of tracks are one individual: by motion, by pose, and by the body's proportions.

Evidence is in nats, the logarithm of how much likelier what is seen is if two pieces are one
individual than if they are two. Its scales are measured in the recording itself: how far bodies go
in so many frames within the pieces, and how different individuals are that are seen together.
Where these have the same bones, or are all over the place at once, that says nothing of others.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import minimum_spanning_tree

from mocap_calib.config import MatchingConfig
from mocap_calib.multi_view.pieces import Pieces, mean_of_known, rms_distance, surprise
from mocap_calib.multi_view.tracklets import tracklets
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import Floats, Ints, Recording

_SAMPLE = 2000  # groups that a scale is measured on
_LONGEST = 500  # pieces that are compared with those seen at the same time
_ROUGH = 0.05  # share of bodies at the ends of pieces that are triangulated badly
_STEPS = 3  # that a velocity is a mean of
_NORMAL = 1.48  # standard deviations that are the median distance of a normal error from 0


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

    def evidence_of(self, individual: Ints) -> Floats:
        """Return `[piece, individual]` the evidence that a piece is of each individual.

        individual: `[piece]` who is thought to be who. A piece does not speak for itself.
        """
        names = int(individual.max(initial=-1)) + 1
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


def motion_evidence(
    points: Floats, frames: Ints, pieces: Pieces, config: MatchingConfig
) -> Floats:
    """Return `[piece, piece]` the evidence of places and poses, symmetric, 0 = none.

    Of pieces of which one begins at most `config.memory` frames after the other has ended.
    """
    evidence = np.zeros((pieces.count, pieces.count))
    apart = usual_distance_apart(points, config)
    gap = frames[pieces.first[:, 0]][None] - frames[pieces.last[:, 0]][:, None]
    earlier, later = np.nonzero((gap > 0) & (gap <= config.memory))
    if not np.isfinite(apart) or not len(earlier):
        return evidence
    gaps = gap[earlier, later]
    course = _distances_on_course(
        points, frames, pieces, (pieces.last[earlier], pieces.first[later]), config
    )
    lags, scales = _usual_distances(points, frames, pieces, config)
    at = np.clip(np.searchsorted(lags, gaps), 0, len(lags) - 1)
    distance = course[np.arange(len(gaps)), scales.argmin(1)[at]]
    scale = np.minimum(scales.min(1)[at] * np.maximum(gaps / lags[at], 1.0), apart)
    without = ~np.isfinite(distance)  # too few joints in common: by the middles of the bodies
    middles = [mean_of_known(points[tuple(at[k].T)]) for at, k in ((pieces.last, earlier), (pieces.first, later))]
    distance[without] = np.linalg.norm(middles[1] - middles[0], axis=-1)[without]
    scale[without] = np.minimum(scale[without] + apart / 4, apart)
    usual = 3 * np.log(apart / scale) - surprise(distance, scale) + np.log1p(-_ROUGH)
    wrong = 3 * np.log(apart / np.maximum(scale, apart / 5)) - surprise(distance, np.maximum(scale, apart / 5)) + np.log(_ROUGH)
    nats = surprise(distance, apart) + np.logaddexp(usual, wrong)
    nats /= 1 + _pieces_between(pieces, earlier, later)
    evidence[earlier, later] = evidence[later, earlier] = nats
    return evidence


def _pieces_between(pieces: Pieces, earlier: Ints, later: Ints) -> Ints:
    """Return `[pair]` how many pieces are between others, from beginning to end.

    Where there are some, these may tell the same as the pair.
    """
    begins, ends = pieces.first[:, 0], np.sort(pieces.last[:, 0])
    begun = np.searchsorted(np.sort(begins), pieces.last[earlier, 0], side="right")
    ended = np.searchsorted(ends, pieces.first[later, 0], side="left")
    return np.maximum(ended - begun, 0)


def usual_distance_apart(points: Floats, config: MatchingConfig) -> float:
    """Return the median distance between groups of one frame; NaN where there is one at most."""
    sampled = points[evenly_spaced(np.arange(len(points)), _SAMPLE)]
    distance = rms_distance(sampled[:, :, None], sampled[:, None], config.tracklet_joints)
    first, second = np.triu_indices(points.shape[1], 1)
    found = distance[:, first, second]
    found = found[np.isfinite(found)]
    return float(np.median(found)) if len(found) else np.nan


def _usual_distances(
    points: Floats, frames: Ints, pieces: Pieces, config: MatchingConfig
) -> tuple[Ints, Floats]:
    """Return numbers of frames `[lag]`, and how far from expected bodies are after so many.

    Medians `[lag, course]` within pieces, see `_distances_on_course`; at least for one frame.
    """
    lags: list[int] = []
    scales: list[Floats] = []
    number = pieces.number
    for lag in (1, 2, 4, 8, 16, 32, 64):
        same = (number[:-lag, :, None] == number[lag:, None]) & (number[:-lag, :, None] >= 0)
        start, i, j = np.nonzero(same)
        chosen = evenly_spaced(np.arange(len(start)), _SAMPLE)
        if lag > 1 and (lag > config.memory or len(chosen) < config.least_evidence):
            break
        ends = np.stack([start, i], -1)[chosen], np.stack([start + lag, j], -1)[chosen]
        distance = _distances_on_course(points, frames, pieces, ends, config)
        finite = distance[np.isfinite(distance).all(-1)]
        scales.append(np.median(finite, axis=0) if len(finite) else np.full(2, np.inf))
        lags.append(lag)
    # what is certain moves less than others: never less than the nearest of the next frame
    return np.array(lags), np.fmax(np.stack(scales), pieces.step)


def _distances_on_course(
    points: Floats,
    frames: Ints,
    pieces: Pieces,
    ends: tuple[Ints, Ints],
    config: MatchingConfig,
) -> Floats:
    """Return `[pair, 2]` how far two groups are from being one body that stands or moves on.

    ends: `[pair, 2]` frame and group of the earlier and of the later one. A body moves on with the
    mean of the velocities that it had before and has after, and keeps its pose.
    """
    earlier, later = ends
    elapsed = (frames[later[:, 0]] - frames[earlier[:, 0]])[:, None]
    velocity = 0.5 * (
        _velocities(points, frames, pieces.before, earlier)
        + _velocities(points, frames, pieces.after, later)
    )
    start, end = points[tuple(earlier.T)], points[tuple(later.T)]
    moved = start + (velocity * elapsed)[:, None]
    distances = [rms_distance(body, end, config.tracklet_joints) for body in (start, moved)]
    return np.stack(distances, axis=-1)


def _velocities(points: Floats, frames: Ints, way: Ints, at: Ints) -> Floats:
    """Return `[N, 3]` how groups move at the end or the beginning of their pieces, 0 = not known.

    way: `[frame, group]` the group of the piece in the neighbouring frame, -1 = none. A mean over
    up to three steps. at: `[N, 2]` frame and group.
    """
    direction = -1 if way[0].max(initial=-1) < 0 else 1  # nothing is before the first frame
    index, group = at.T.copy()
    for _ in range(_STEPS):
        onward = way[index, group]
        index = np.where(onward >= 0, index + direction, index)
        group = np.where(onward >= 0, onward, group)
    elapsed = frames[at[:, 0]] - frames[index]
    moved = mean_of_known(points[tuple(at.T)] - points[index, group])
    return np.where(elapsed[:, None] != 0, moved / np.where(elapsed, elapsed, 1)[:, None], 0.0)


def image_evidence(
    recording: Recording, groups: Ints, pieces: Pieces, config: MatchingConfig
) -> Floats:
    """Return `[piece, piece]` the evidence of views that follow a body from one to the other.

    groups: `[view, frame, instance]` labels within each frame, -1 = nobody. A tracklet of one view
    tells of pieces also where no second view sees the body in between.
    """
    evidence = np.zeros((pieces.count, pieces.count))
    numbers = np.append(pieces.number, np.full((len(pieces.number), 1), -1), axis=1)
    frames = np.arange(len(numbers))[:, None]
    for view, labels in enumerate(groups):
        track = tracklets(recording, view, config)
        piece = numbers[frames, labels]
        known = np.nonzero((track >= 0) & (piece >= 0))
        order = np.lexsort((known[0], track[known]))
        track, piece = track[known][order], piece[known][order]
        onward = (track[1:] == track[:-1]) & (piece[1:] != piece[:-1])
        np.add.at(evidence, (piece[:-1][onward], piece[1:][onward]), config.followed)
    return evidence + evidence.T


def measure_proportions(points: Floats, pieces: Pieces, config: MatchingConfig) -> Proportions:
    """Return the lengths of the bodies of all pieces, between the joints that are most rigid.

    points: `[frame, group, joint, 3]`.
    """
    bones, spread = _find_bones(points, pieces, config)
    if not len(bones):
        nothing = np.zeros((pieces.count, 0))
        return Proportions(mean=nothing, precision=nothing.copy(), apart=np.zeros(0))
    a, b = bones.T
    frame, group = np.nonzero(pieces.number >= 0)
    bodies = points[frame, group]
    lengths = _log_lengths(bodies[:, a], bodies[:, b])
    piece = pieces.number[frame, group]
    order = np.argsort(piece, kind="stable")
    cuts = np.flatnonzero(np.diff(piece[order])) + 1
    mean = np.stack([_medians(part) for part in np.split(lengths[order], cuts)])
    seen = np.zeros(mean.shape)
    np.add.at(seen, piece, np.isfinite(lengths))
    # neighbouring frames err together, and each pose in its own way
    independent = np.where(seen > 0, 1 + (seen - 1) / config.bone_memory, np.inf)
    variance = spread**2 * (1 / independent + config.bone_doubt**2)
    precision = np.where(seen > 0, 1 / variance, 0.0)
    mean = np.nan_to_num(mean)
    return Proportions(mean, precision, apart=_variance_apart(mean, precision, pieces))


def _log_lengths(a: Floats, b: Floats) -> Floats:
    """Return the logarithm of the distances of points, NaN where one is missing."""
    return np.log(np.maximum(np.linalg.norm(a - b, axis=-1), 1e-12))


def _medians(values: Floats) -> Floats:
    """Return the medians of columns without NaN; NaN of nothing."""
    if not len(values):
        return np.full(values.shape[1], np.nan)
    known = np.isfinite(values)
    ordered = np.sort(values, axis=0)  # NaN last
    count = known.sum(0)
    middle = np.maximum(count - 1, 0) // 2
    return np.asarray(ordered[middle, np.arange(values.shape[1])])


def _find_bones(
    points: Floats, pieces: Pieces, config: MatchingConfig
) -> tuple[Ints, Floats]:
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
    weight = np.zeros((joints, joints))
    weight[pairs] = np.nan_to_num((usual + config.least_spread) * length)  # 0: no edge
    tree = minimum_spanning_tree(weight).tocoo()
    spread = np.zeros((joints, joints))
    spread[pairs] = np.nan_to_num(usual) + config.least_spread
    return np.stack([tree.row, tree.col], axis=-1).astype(np.int64), spread[tree.row, tree.col]


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
        _log_lengths(bodies[:, joints[0]], bodies[:, joints[1]])
        for bodies in (points[frame, i], points[frame + 1, j])
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
    lengths = _log_lengths(bodies[:, joints[0]], bodies[:, joints[1]])
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
    # the median square of a normal error is 0.455 of its variance
    excess = 0.5 * (_medians(square) / 0.455 - _medians(np.where(known, own, np.nan)))
    return np.asarray(np.maximum(np.nan_to_num(excess), 0.0))
