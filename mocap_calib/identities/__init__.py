"""Identities through the whole recording: pieces of tracks that are one individual are joined.

The groups of all frames are followed as far as that is certain (`pieces`). Pieces are joined by
agglomerative clustering, the likeliest first, by the sum of the evidence of all pairs of pieces and
that of the bone lengths of what is joined. What is seen in the same frames is two individuals.

Evidence is in nats, the logarithm of how much likelier what is seen is if two pieces are one
individual than if they are two. That of motion has scales that are measured in the recording
itself: how far bodies go in so many frames within the pieces, and how far individuals are from each
other.
"""

from dataclasses import replace

import numpy as np

from mocap_calib import mapped
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
from mocap_calib.rig import Tracks, name_groups, per_frame_labels, replace_labels, view_noise
from mocap_calib.rig.triangulate import triangulate_blocks
from mocap_calib.types import Bools, CameraRig, Floats, Ints, Recording

_LAGS = (1, 4, 16, 64)  # frames after which it is measured how far bodies go


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
    labels = name_groups(groups.labels, replace_labels(pieces.number, individual))
    views = _views_of_individuals(labels, int(individual.max(initial=-1)) + 1)
    real = _last_long(individual, pieces, views, len(labels))
    if not real.any():
        raise DegenerateError(
            "",
            "bodies that two views agree on",
            "none for more than a moment",
            "record longer, or with more overlap",
        )
    order = np.argsort(-(views > 0).sum(0) * real, kind="stable")  # most seen first
    names = np.full(len(order), -1)
    kept = order[: min(real.sum(), matching.individuals or len(order))]
    names[kept] = np.arange(len(kept))
    return Matches(replace_labels(labels, names))


def _triangulate_groups(
    recording: Recording, rig: CameraRig, groups: Matches, config: Config
) -> Floats:
    """Return the joints of all groups of all frames, `[frame, group, joint, 3]`, NaN = missing."""
    noise = view_noise(recording, rig, groups, config.triangulate)
    joints = len(recording.keypoints)
    # not a list of parts that is joined in the end: that would be twice the memory; components
    # lie apart, as the parts have them
    points = mapped.empty((3, len(recording.frames), groups.individuals, joints))

    def keep(frames: Ints, _: Tracks, found: Floats, __: Bools) -> None:
        points[:, mapped.as_slice(frames)] = found.reshape(3, len(frames), -1, joints)

    settings = config.triangulate
    for _ in triangulate_blocks(recording, rig, groups, keep, noise=noise, config=settings):
        mapped.let_go()
    return np.moveaxis(points, 0, -1)


def _join_pieces(frames: Ints, points: Floats, pieces: Pieces, config: MatchingConfig) -> Ints:
    """Return the individual `[piece]` that each piece is of.

    Of a long recording, those of its parts are joined, and then these individuals.

    frames: `[frame]` numbers; points: `[frame, group, joint, 3]`.
    """
    bodies = measure_bones(points, pieces, config.most_pieces)
    individual = np.arange(len(pieces.first))
    while True:
        count = len(pieces.first)
        final = count <= config.most_pieces
        joined = np.zeros(count, dtype=np.int64)
        for start in range(0, count, config.most_pieces):
            among = np.arange(start, min(start + config.most_pieces, count))
            found = join_pieces(
                pieces.first[among, 0],
                pieces.last[among, 0],
                motion_evidence(points, frames, pieces, among),
                bodies.select(among),
                config if final else replace(config, individuals=None),
            )
            joined[among] = found + joined.max(initial=-1) + 1 if start else found
        individual = joined[individual]
        if final or joined.max() + 1 == count:
            return individual
        pieces, bodies = pieces.join(joined), bodies.join(joined)


def _last_long(individual: Ints, pieces: Pieces, views: Ints, all_views: int) -> Bools:
    """Return which individuals are followed for long, or seen for long by most views.

    individual: `[piece]`. views: `[frame, individual]` how many see each. False detections that
    meet by chance jump about, and are mostly of two views. Measured: in recordings with a false
    detection in a fifth of the images they meet in 8 to 15 frames, never in two that follow each
    other.
    """
    followed = np.bincount(individual, np.where(pieces.lengths > 1, pieces.lengths, 0))
    return np.maximum(followed, (2 * views > all_views).sum(0)) > longest_chance_run(len(views))


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


def join_pieces(
    first: Ints, last: Ints, pairs: Floats, bodies: BoneLengths, config: MatchingConfig
) -> Ints:
    """Return the individual `[piece]` that each piece is of.

    Where individuals certainly arrive from outside what the cameras see, at some rate, one who was
    not seen for some frames returns, or another one arrives, whichever is likelier. Elsewhere a
    recording has as few individuals as it needs: two are one unless evidence is decisive against
    it. Where `config.individuals` says how many there are at most, more are joined.

    first, last: `[piece]` frames. pairs: `[piece, piece]` evidence of motion, in nats.
    """
    after = first - last[:, None]
    gap = np.maximum(after, after.T)  # frames between two pieces; none where both are seen
    certain = _cluster(gap, pairs, bodies, least=0.0)
    arrivals = _count_arrivals(certain, first, last)
    rate, least = arrivals / (last.max(initial=0) + 1), 0.0 if arrivals else -2 * config.decisive
    return _cluster(gap, pairs, bodies, rate=rate, least=least, most=config.individuals)


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


def _cluster(
    gap: Ints,
    pairs: Floats,
    bodies: BoneLengths,
    *,
    least: float,
    rate: float = 0.0,
    most: int | None = None,
) -> Ints:
    """Return the individual `[piece]` that each piece is of; the likeliest are joined first.

    gap: `[piece, piece]` number of frames from the end of one to the beginning of the other, 0 and
    less where some frame shows both. rate: of individuals who come from outside, a frame. least:
    the evidence down to which they are joined; further as long as they are more than `most`.
    """
    pieces = np.arange(len(gap))
    individual, alive = pieces.copy(), np.ones(len(gap), dtype=bool)
    gap, pairs, bodies = gap.copy(), pairs.copy(), bodies.select(pieces)

    def evidence(piece: int) -> Floats:
        """Return `[piece]` the evidence that each is the same as this one; -inf = cannot be."""
        found = pairs[piece] + bodies.evidence(piece)
        if rate:
            # odds that one who was not seen for so long returns in a frame, to that of an arrival:
            # gaps follow a power law, most are short and some are long
            found -= np.log(rate * np.maximum(gap[piece], 1.0) ** 2)
        return np.where(alive & (gap[piece] > 0), found, -np.inf)

    total = np.array([evidence(piece) for piece in pieces.tolist()]).reshape(2 * (len(pieces),))
    while len(pieces):
        kept, merged = sorted(map(int, np.unravel_index(total.argmax(), total.shape)))
        enough = most is None or alive.sum() <= most
        if total[kept, merged] <= (least if enough else -np.inf):
            break
        individual[individual == merged] = kept
        pairs[kept] = pairs[:, kept] = pairs[kept] + pairs[merged]
        gap[kept] = gap[:, kept] = np.minimum(gap[kept], gap[merged])
        for array in (bodies.total, bodies.precision):
            array[kept] += array[merged]
        alive[merged] = False
        total[merged] = total[:, merged] = -np.inf
        total[kept] = total[:, kept] = evidence(kept)
    return np.unique(individual, return_inverse=True)[1]


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
    distance = _distances_on_course(points, frames, pieces, (last[earlier], first[later]))
    lags, scales = _usual_distances(points, frames, pieces)
    at = np.clip(np.searchsorted(lags, gaps), 0, len(lags) - 1)
    scale = np.minimum(scales[at] * np.maximum(gaps / lags[at], 1.0), apart)
    without = ~np.isfinite(distance)  # too few joints in common: by the middles of the bodies
    end = np.nan_to_num(mean_of_known(points[tuple(last[earlier].T)], axis=-2))
    begin = np.nan_to_num(mean_of_known(points[tuple(first[later].T)], axis=-2))
    distance[without] = np.linalg.norm(begin - end, axis=-1)[without]
    scale[without] = np.minimum(scale[without] + apart / 4, apart)
    nats = surprise(distance, apart) + 3 * np.log(apart)
    nats -= surprise(distance, scale) + 3 * np.log(scale)
    # pieces between two others, from beginning to end, may tell the same as these
    begun = np.searchsorted(np.sort(first[:, 0]), last[earlier, 0], side="right")
    ended = np.searchsorted(np.sort(last[:, 0]), first[later, 0], side="left")
    nats /= 1 + np.maximum(ended - begun, 0)
    evidence[earlier, later] = evidence[later, earlier] = nats
    return evidence


def usual_distance_apart(points: Floats) -> float:
    """Return the median distance between groups of one frame; NaN where there is one at most."""
    sampled = mapped.take(points, evenly_spaced(np.arange(len(points)), SAMPLE))
    first, second = np.triu_indices(points.shape[1], 1)
    found = rms_distance(sampled[:, first], sampled[:, second])
    found = found[np.isfinite(found)]
    return float(np.median(found)) if len(found) else np.nan


def _usual_distances(points: Floats, frames: Ints, pieces: Pieces) -> tuple[Ints, Floats]:
    """Return numbers of frames `[lag]`, and how far from expected bodies are after so many.

    Medians `[lag]` within pieces; at least for one frame.
    """
    lags: list[int] = []
    scales: list[float] = []
    number = pieces.number
    for lag in _LAGS:
        same = (number[:-lag, :, None] == number[lag:, None]) & (number[:-lag, :, None] >= 0)
        start, i, j = np.nonzero(same)
        chosen = evenly_spaced(np.arange(len(start)), SAMPLE)
        if lag > 1 and not len(chosen):
            break
        ends = np.stack([start, i], -1)[chosen], np.stack([start + lag, j], -1)[chosen]
        distance = _distances_on_course(points, frames, pieces, ends)
        finite = distance[np.isfinite(distance)]
        scales.append(float(np.median(finite)) if len(finite) else np.inf)
        lags.append(lag)
    # what is certain moves less than others: never less than the nearest of the next frame
    return np.array(lags), np.fmax(scales, pieces.step)


def _distances_on_course(
    points: Floats, frames: Ints, pieces: Pieces, ends: tuple[Ints, Ints]
) -> Floats:
    """Return `[pair]` how far two groups are from being one body that moves on.

    ends: `[pair, 2]` frame and group of the earlier and of the later one. A body moves on with the
    mean of the velocities that it had before and has after, and keeps its pose.
    """
    earlier, later = ends
    elapsed = (frames[later[:, 0]] - frames[earlier[:, 0]])[:, None]
    before = _velocities(points, frames, earlier, pieces.before, -1)
    after = _velocities(points, frames, later, pieces.after, 1)
    moved = points[tuple(earlier.T)] + ((before + after) / 2 * elapsed)[:, None]
    return rms_distance(moved, points[tuple(later.T)])


def _velocities(points: Floats, frames: Ints, at: Ints, onward: Ints, step: int) -> Floats:
    """Return `[N, 3]` how groups move at the end or the beginning of their pieces, 0 = not known.

    at: `[N, 2]` frame and group. onward: `[frame, group]` the group of the piece in the next frame
    (step 1) or in the one before (step -1), -1 = none.
    """
    frame, group = at.T
    known = onward[frame, group] >= 0
    beside = np.where(known, frame + step, frame)
    moved = points[frame, group] - points[beside, np.where(known, onward[frame, group], group)]
    elapsed = np.where(known, frames[frame] - frames[beside], 1)[:, None]
    return np.nan_to_num(mean_of_known(moved, axis=-2)) / elapsed
