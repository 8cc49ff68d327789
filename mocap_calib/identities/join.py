"""Join the pieces of tracks that are one individual: the likeliest first.

Agglomerative clustering by the sum of the evidence of all pairs of pieces, and that of the bone
lengths of what is joined. What is seen in the same frames is two individuals, but for a few frames
in which one is a false group.

Evidence is in nats, the logarithm of how much likelier what is seen is if two pieces are one
individual than if they are two. That of motion has scales that are measured in the recording
itself: how far bodies go in so many frames within the pieces, and how far individuals are from each
other.
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib import mapped
from mocap_calib.config import MatchingConfig
from mocap_calib.geometry.alignment import mean_of_known
from mocap_calib.identities.bones import BoneLengths
from mocap_calib.identities.pieces import SAMPLE, Pieces, rms_distance, surprise
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import Bools, Floats, Ints

_LAGS = (1, 2, 4, 8, 16, 32, 64)  # frames after which it is measured how far bodies go
_STEPS = 3  # that a velocity is a mean of


def join_pieces(
    first: Ints, last: Ints, pairs: Floats, bodies: BoneLengths, config: MatchingConfig
) -> Ints:
    """Return the individual `[piece]` that each piece is of, -1 = unassigned.

    Where individuals certainly arrive from outside what the cameras see, at some rate, one who was
    not seen for some frames returns, or another one arrives, whichever is likelier. Elsewhere a
    recording has as few individuals as it needs: two are one unless evidence is decisive against
    it. Where `config.individuals` says how many there are at most, more are joined, and those seen
    least are unassigned that cannot be.

    What is followed through several frames is joined first: the place of a single one is uncertain,
    and it must not keep others apart.

    first, last: `[piece]` frames. pairs: `[piece, piece]` evidence of motion, in nats.
    """
    clusters = _Clusters.of(first, last, pairs, bodies, config)
    clusters.join(0.0)
    arrivals = _count_arrivals(clusters.individual, first, last, config)
    clusters = _Clusters.of(first, last, pairs, bodies, config)
    clusters.rate = arrivals / (last.max(initial=0) + 1)
    least = 0.0 if arrivals else -2 * config.decisive
    clusters.join(least)
    clusters.alive |= last == first
    clusters.join(least)
    if config.individuals is not None:
        clusters.join(-np.inf, config.individuals)
    return _name(clusters.individual, clusters.lengths, config.individuals)


def _count_arrivals(individual: Ints, first: Ints, last: Ints, config: MatchingConfig) -> int:
    """Return how many individuals certainly come from outside what the cameras see.

    They appear while all those are seen who have been seen before. individual, first, last:
    `[piece]`. Who is seen for a few frames alone does not count.
    """
    count = 0
    lengths = np.bincount(individual, last - first + 1)
    lasting = np.flatnonzero(lengths > config.fleeting(int(last.max(initial=0)) + 1))
    begin = {name: first[individual == name].min() for name in lasting.tolist()}
    for start in begin.values():
        there = (first <= start) & (last >= start)
        before = [name for name, earlier in begin.items() if earlier < start]
        count += bool(before) and all(there[individual == name].any() for name in before)
    return count


@dataclass
class _Clusters:
    """Individuals as far as pieces are joined, changed in place; each goes by one of its pieces.

    individual: `[piece]` the cluster of each piece; alive: `[piece]` which are to be joined. pairs,
    together: `[piece, piece]` evidence between clusters, and frames in which both are seen.
    gap: `[piece, piece]` least number of frames from the end of a piece of one to the beginning of
    one of the other. lengths: `[piece]` frames; bodies: of the clusters. rate: of individuals who
    come from outside, a frame; 0 = none does.
    """

    individual: Ints
    alive: Bools
    pairs: Floats
    together: Ints
    gap: Ints
    lengths: Ints
    bodies: BoneLengths
    false_share: float
    rate: float = 0.0

    @classmethod
    def of(
        cls, first: Ints, last: Ints, pairs: Floats, bodies: BoneLengths, config: MatchingConfig
    ) -> "_Clusters":
        """Return each piece by itself, of which those of several frames are joined at first."""
        together = _frames_together(first, last)
        after = first - last[:, None]
        return cls(
            individual=np.arange(len(first)),
            alive=last > first,
            pairs=pairs - config.decisive * together,
            together=together,
            gap=np.maximum(np.maximum(after, after.T), 1),
            lengths=last - first + 1,
            bodies=bodies.copy(),
            false_share=config.false_share,
        )

    def join(self, least: float, most: int = 0) -> None:
        """Join clusters, the likeliest first, down to this evidence or to so many clusters."""
        pieces = range(len(self.lengths))
        total = np.array([self._evidence(piece) for piece in pieces]).reshape(2 * (len(pieces),))
        best = total.max(1, initial=-np.inf)
        while self.alive.sum() > most and best.max() > least:
            ends = int(best.argmax()), int(total[best.argmax()].argmax())
            kept, merged = min(ends), max(ends)
            self._merge(kept, merged)
            stale = (total[:, kept] == best) | (total[:, merged] == best)
            total[merged] = total[:, merged] = -np.inf
            total[kept] = total[:, kept] = row = self._evidence(kept)
            best = np.maximum(best, row)
            stale[[kept, merged]] = True
            best[stale] = total[stale].max(1)

    def _evidence(self, piece: int) -> Floats:
        """Return `[piece]` the evidence that each is the same as this one; -inf = cannot be."""
        shorter = np.minimum(self.lengths, self.lengths[piece])
        no = (self.together[piece] > self.false_share * shorter) | ~self.alive
        no[piece] = True
        if not self.alive[piece]:
            no[:] = True
        evidence = self.pairs[piece] + self.bodies.evidence(piece)
        if self.rate:
            # odds that one who was not seen for so long returns in a frame, to that of an arrival:
            # gaps follow a power law, most are short and some are long
            evidence -= np.log(self.rate * self.gap[piece].astype(np.float64) ** 2)
        return np.where(no, -np.inf, evidence)

    def _merge(self, kept: int, merged: int) -> None:
        """Make two clusters one."""
        self.individual[self.individual == merged] = kept
        for sums in (self.pairs, self.together):
            sums[kept] += sums[merged]
            sums[:, kept] = sums[kept]
        self.gap[kept] = self.gap[:, kept] = np.minimum(self.gap[kept], self.gap[merged])
        self.lengths[kept] += self.lengths[merged]
        self.alive[merged] = False
        self.bodies.join(kept, merged)


def _frames_together(first: Ints, last: Ints) -> Ints:
    """Return `[piece, piece]` in how many frames both are seen; 0 on the diagonal."""
    common = np.minimum(last[:, None], last) - np.maximum(first[:, None], first) + 1
    common = np.maximum(common, 0)
    np.fill_diagonal(common, 0)
    return np.asarray(common)


def _name(individual: Ints, lengths: Ints, most: int | None) -> Ints:
    """Return individuals `[piece]` numbered from 0, -1 for those beyond the longest `most`."""
    kept, number = np.unique(individual, return_inverse=True)
    rank = np.argsort(np.argsort(-lengths[kept], kind="stable"), kind="stable")
    names: Bools | Ints = np.arange(len(kept))
    if most is not None:
        names = np.where(rank < most, np.cumsum(rank < most) - 1, -1)
    return np.asarray(np.append(names, -1)[number])


def motion_evidence(
    points: Floats, frames: Ints, pieces: Pieces, among: Ints, config: MatchingConfig
) -> Floats:
    """Return `[N, N]` the evidence of places and poses, symmetric, 0 = none.

    among: `[N]` the pieces. Of those of which one begins at most `config.memory` frames after the
    other has ended.
    """
    evidence = np.zeros((len(among), len(among)))
    apart = usual_distance_apart(points)
    first, last = pieces.first[among], pieces.last[among]
    gap = frames[first[:, 0]] - frames[last[:, 0]][:, None]
    earlier, later = np.nonzero((gap > 0) & (gap <= config.memory))
    if not np.isfinite(apart) or not len(earlier):
        return evidence
    gaps = gap[earlier, later]
    course = _distances_on_course(points, frames, pieces, (last[earlier], first[later]))
    lags, scales = _usual_distances(points, frames, pieces, config)
    at = np.clip(np.searchsorted(lags, gaps), 0, len(lags) - 1)
    distance = course[np.arange(len(gaps)), scales.argmin(1)[at]]
    scale = np.minimum(scales.min(1)[at] * np.maximum(gaps / lags[at], 1.0), apart)
    without = ~np.isfinite(distance)  # too few joints in common: by the middles of the bodies
    end = np.nan_to_num(mean_of_known(points[tuple(last[earlier].T)], axis=-2))
    begin = np.nan_to_num(mean_of_known(points[tuple(first[later].T)], axis=-2))
    distance[without] = np.linalg.norm(begin - end, axis=-1)[without]
    scale[without] = np.minimum(scale[without] + apart / 4, apart)
    nats = surprise(distance, apart) + 3 * np.log(apart)
    nats -= surprise(distance, scale) + 3 * np.log(scale)
    nats /= 1 + _pieces_between(first, last, (earlier, later))
    evidence[earlier, later] = evidence[later, earlier] = nats
    return evidence


def _pieces_between(first: Ints, last: Ints, pairs: tuple[Ints, Ints]) -> Ints:
    """Return `[pair]` how many pieces are between others, from beginning to end.

    Where there are some, these may tell the same as the pair. first, last: `[piece, 2]`.
    """
    earlier, later = pairs
    begun = np.searchsorted(np.sort(first[:, 0]), last[earlier, 0], side="right")
    ended = np.searchsorted(np.sort(last[:, 0]), first[later, 0], side="left")
    return np.maximum(ended - begun, 0)


def usual_distance_apart(points: Floats) -> float:
    """Return the median distance between groups of one frame; NaN where there is one at most."""
    sampled = mapped.take(points, evenly_spaced(np.arange(len(points)), SAMPLE))
    distance = rms_distance(sampled[:, :, None], sampled[:, None])
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
    for lag in _LAGS:
        same = (number[:-lag, :, None] == number[lag:, None]) & (number[:-lag, :, None] >= 0)
        start, i, j = np.nonzero(same)
        chosen = evenly_spaced(np.arange(len(start)), SAMPLE)
        if lag > 1 and (lag > config.memory or not len(chosen)):
            break
        ends = np.stack([start, i], -1)[chosen], np.stack([start + lag, j], -1)[chosen]
        distance = _distances_on_course(points, frames, pieces, ends)
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
    distances = [rms_distance(body, end) for body in (start, moved)]
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
    moved = np.nan_to_num(mean_of_known(points[tuple(at.T)] - points[index, group], axis=-2))
    return np.where(elapsed[:, None] != 0, moved / np.where(elapsed, elapsed, 1)[:, None], 0.0)
