"""Identities through the whole recording: pieces of tracks that are one individual are joined.

The groups of all frames are followed as far as that is certain (`pieces`). Pieces are joined by
agglomerative clustering, the likeliest first, by the sum of the evidence of all pairs of pieces and
that of the bone lengths of what is joined. What is seen in the same frames is two individuals.

Evidence is in nats, the logarithm of how much likelier what is seen is if two pieces are one
individual than if they are two. That of motion has scales that are measured in the recording
itself: how far bodies go in so many frames within the pieces, and how far individuals are from each
other.
"""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import Config, MatchingConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.rotation import mean_of_known
from mocap_calib.identities.pieces import (
    SAMPLE,
    BoneLengths,
    Pieces,
    cut_into_pieces,
    measure_bones,
    rms_distance,
    surprise,
)
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import Matches
from mocap_calib.rig.tracks import name_groups, per_frame_labels, replace_labels, view_noise
from mocap_calib.rig.triangulate import frame_blocks, triangulate_frames
from mocap_calib.types import Bools, CameraRig, Floats, Ints, Recording

_LAGS = (1, 2, 4, 8, 16, 32, 64)  # frames after which it is measured how far bodies go
_STEPS = 3  # that a velocity is a mean of


def finalise_identities(
    recording: Recording, rig: CameraRig, matches: Matches, config: Config
) -> Matches:
    """Return the groups of each frame as individuals of the recording, most seen first.

    Individuals keep their labels through occlusions, and when they meet, leave and come back. There
    are as few as the recording needs, and at most `config.matching.individuals` where that is
    known. Who is followed for a few frames alone is a false detection that happened to meet
    another: unassigned, unless most views agree on it.

    Returns labels `[view, frame, instance]`. Raises DegenerateError where no individual is left.
    """
    matching = config.matching
    groups = per_frame_labels(matches)
    points = _triangulate_groups(recording, rig, groups, config)
    pieces = cut_into_pieces(points, recording.frames, matching)
    individual = _join_pieces(recording.frames, points, pieces, matching)
    labels = name_groups(groups.labels, np.append(individual, -1)[pieces.number])
    real = _lasting_individuals(individual, pieces, labels)
    labels = replace_labels(labels, np.where(real, np.arange(len(real)), -1))
    if not (labels >= 0).any():
        raise DegenerateError(
            "expected bodies that two views agree on, found none for more than a moment; "
            "record longer, or with more overlap"
        )
    labels = _sort_by_presence(labels)
    if matching.individuals is not None:
        labels = np.where(labels < matching.individuals, labels, -1)
    return Matches(labels)


def _triangulate_groups(
    recording: Recording, rig: CameraRig, groups: Matches, config: Config
) -> Floats:
    """Return the joints of all groups of all frames, `[frame, group, joint, 3]`, NaN = missing."""
    noise = view_noise(recording, rig, groups, config.triangulate)
    joints = len(recording.keypoints)
    # not a list of parts that is joined in the end: that would be twice the memory; components
    # lie apart, as the parts have them
    points = mapped.empty((3, len(recording.frames), groups.individuals, joints))

    def locate(frames: Ints) -> None:
        _, found, _ = triangulate_frames(
            frames,
            recording=recording,
            rig=rig,
            matches=groups,
            noise=noise,
            config=config.triangulate,
        )
        points[:, mapped.as_slice(frames)] = found.reshape(3, len(frames), -1, joints)

    blocks = frame_blocks(len(recording.frames), groups.individuals * joints)
    for _ in map_in_threads(locate, blocks):
        mapped.let_go()
    return np.moveaxis(points, 0, -1)


def _join_pieces(frames: Ints, points: Floats, pieces: Pieces, config: MatchingConfig) -> Ints:
    """Return the individual `[piece]` that each piece is of, -1 = unassigned.

    Of a long recording, those of its parts are joined, and then these individuals.

    frames: `[frame]` numbers; points: `[frame, group, joint, 3]`.
    """
    bodies = measure_bones(points, pieces, config.most_pieces)
    individual = np.arange(pieces.count)
    while True:
        final = pieces.count <= config.most_pieces
        wanted = config if final else replace(config, individuals=None)
        joined = np.full(pieces.count, -1, dtype=np.int64)
        for start in range(0, pieces.count, config.most_pieces):
            among = np.arange(start, min(start + config.most_pieces, pieces.count))
            first, last = pieces.first[among, 0], pieces.last[among, 0]
            pairs = motion_evidence(points, frames, pieces, among)
            found = join_pieces(first, last, pairs, bodies.select(among), wanted)
            joined[among] = np.where(found >= 0, found + joined.max(initial=-1) + 1, -1)
        individual = np.append(joined, -1)[individual]
        if final or joined.max() + 1 == pieces.count:
            return individual
        pieces, bodies = pieces.join(joined), bodies.join_all(joined)


def _lasting_individuals(individual: Ints, pieces: Pieces, labels: Ints) -> Bools:
    """Return `[individual]` which are followed for long, or seen for long by most views.

    individual: `[piece]`, -1 = unassigned. False detections that meet by chance jump about, and are
    mostly of two views. Measured: in recordings with a false detection in a fifth of the images
    they meet in 8 to 15 frames, never in two that follow each other.
    """
    names = int(labels.max(initial=-1)) + 1
    followed = (individual >= 0) & (pieces.lengths > 1)
    frames = np.bincount(individual[followed], pieces.lengths[followed], minlength=names)[:names]
    views = _views_of_individuals(labels, names)
    frames = np.maximum(frames, (2 * views > len(labels)).sum(0))
    return np.asarray(frames > longest_chance_run(labels.shape[1]))


def longest_chance_run(frames: int) -> int:
    """Return in how many of so many frames false detections may meet by chance.

    The longest run of heads when a fair coin is thrown so many times (Erdos and Renyi 1970):
    log2 of them.
    """
    return frames.bit_length() - 1


def _views_of_individuals(labels: Ints, names: int) -> Ints:
    """Return how many views see each individual in each frame, `[frame, individual]`."""
    views = np.zeros((labels.shape[1], names), dtype=np.int64)
    for of_view in labels:
        frame, instance = np.nonzero(of_view >= 0)
        np.add.at(views, (frame, of_view[frame, instance]), 1)
    return views


def _sort_by_presence(labels: Ints) -> Ints:
    """Renumber individuals by the number of frames they are seen in, most first."""
    views = _views_of_individuals(labels, int(labels.max()) + 1)
    order = np.argsort(-(views > 0).sum(0), kind="stable")
    names = np.empty(len(order), dtype=np.int64)
    names[order] = np.arange(len(order))
    return replace_labels(labels, names)


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
    clusters = _Clusters.of(first, last, pairs, bodies)
    clusters.join(0.0)
    arrivals = _count_arrivals(clusters.individual, first, last)
    clusters = _Clusters.of(first, last, pairs, bodies)
    clusters.rate = arrivals / (last.max(initial=0) + 1)
    least = 0.0 if arrivals else -2 * config.decisive
    clusters.join(least)
    clusters.alive |= last == first
    clusters.join(least)
    if config.individuals is not None:
        clusters.join(-np.inf, config.individuals)
    return _name(clusters.individual, clusters.lengths, config.individuals)


def _count_arrivals(individual: Ints, first: Ints, last: Ints) -> int:
    """Return how many individuals certainly come from outside what the cameras see.

    They appear while all those are seen who have been seen before. individual, first, last:
    `[piece]`. Who is seen for a few frames alone does not count.
    """
    count = 0
    lengths = np.bincount(individual, last - first + 1)
    lasting = np.flatnonzero(lengths > longest_chance_run(int(last.max(initial=0)) + 1))
    begin = {name: first[individual == name].min() for name in lasting.tolist()}
    for start in begin.values():
        there = (first <= start) & (last >= start)
        before = [name for name, earlier in begin.items() if earlier < start]
        count += bool(before) and all(there[individual == name].any() for name in before)
    return count


@dataclass
class _Clusters:
    """Individuals as far as pieces are joined, changed in place; each goes by one of its pieces.

    individual: `[piece]` the cluster of each piece; alive: `[piece]` which are to be joined. pairs:
    `[piece, piece]` evidence between clusters; together: whether some frame shows both.
    gap: `[piece, piece]` least number of frames from the end of a piece of one to the beginning of
    one of the other. lengths: `[piece]` frames; bodies: of the clusters. rate: of individuals who
    come from outside, a frame; 0 = none does.
    """

    individual: Ints
    alive: Bools
    pairs: Floats
    together: Bools
    gap: Ints
    lengths: Ints
    bodies: BoneLengths
    rate: float = 0.0

    @classmethod
    def of(cls, first: Ints, last: Ints, pairs: Floats, bodies: BoneLengths) -> "_Clusters":
        """Return each piece by itself, of which those of several frames are joined at first."""
        after = first - last[:, None]
        gap = np.maximum(after, after.T)
        return cls(
            individual=np.arange(len(first)),
            alive=last > first,
            pairs=pairs.copy(),
            together=gap <= 0,
            gap=np.maximum(gap, 1),
            lengths=last - first + 1,
            bodies=bodies.copy(),
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
        no = self.together[piece] | ~self.alive
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
        self.pairs[kept] = self.pairs[:, kept] = self.pairs[kept] + self.pairs[merged]
        self.together[kept] = self.together[:, kept] = self.together[kept] | self.together[merged]
        self.gap[kept] = self.gap[:, kept] = np.minimum(self.gap[kept], self.gap[merged])
        self.lengths[kept] += self.lengths[merged]
        self.alive[merged] = False
        self.bodies.join(kept, merged)


def _name(individual: Ints, lengths: Ints, most: int | None) -> Ints:
    """Return individuals `[piece]` numbered from 0, -1 for those beyond the longest `most`."""
    kept, number = np.unique(individual, return_inverse=True)
    rank = np.argsort(np.argsort(-lengths[kept], kind="stable"), kind="stable")
    names: Bools | Ints = np.arange(len(kept))
    if most is not None:
        names = np.where(rank < most, np.cumsum(rank < most) - 1, -1)
    return np.asarray(np.append(names, -1)[number])


def motion_evidence(points: Floats, frames: Ints, pieces: Pieces, among: Ints) -> Floats:
    """Return `[N, N]` the evidence of places and poses, symmetric, 0 = none.

    among: `[N]` the pieces. Of those of which one begins at most the longest of `_LAGS` after the
    other has ended.
    """
    evidence = np.zeros((len(among), len(among)))
    apart = usual_distance_apart(points)
    first, last = pieces.first[among], pieces.last[among]
    gap = frames[first[:, 0]] - frames[last[:, 0]][:, None]
    earlier, later = np.nonzero((gap > 0) & (gap <= _LAGS[-1]))
    if not np.isfinite(apart) or not len(earlier):
        return evidence
    gaps = gap[earlier, later]
    course = _distances_on_course(points, frames, pieces, (last[earlier], first[later]))
    lags, scales = _usual_distances(points, frames, pieces)
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


def _usual_distances(points: Floats, frames: Ints, pieces: Pieces) -> tuple[Ints, Floats]:
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
        if lag > 1 and not len(chosen):
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
