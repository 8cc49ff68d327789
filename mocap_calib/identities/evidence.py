"""Which pieces of tracks are one individual: by motion and by what single views follow.

Evidence is in nats, the logarithm of how much likelier what is seen is if two pieces are one
individual than if they are two. Its scales are measured in the recording itself: how far bodies go
in so many frames within the pieces, and how far individuals are from each other.
"""

import numpy as np

from mocap_calib import mapped
from mocap_calib.config import MatchingConfig
from mocap_calib.geometry.alignment import mean_of_known
from mocap_calib.identities.pieces import Pieces, rms_distance, surprise
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import Floats, Ints

_SAMPLE = 2000  # groups that a scale is measured on
_LAGS = (1, 2, 4, 8, 16, 32, 64)  # frames after which it is measured how far bodies go
_STEPS = 3  # that a velocity is a mean of
_ROUGH = 0.05  # share of bodies at the ends of pieces that are triangulated badly


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
    nats -= _mixed_surprise(distance, scale, np.maximum(scale, apart / 5))
    nats /= 1 + _pieces_between(first, last, (earlier, later))
    evidence[earlier, later] = evidence[later, earlier] = nats
    return evidence


def _mixed_surprise(distance: Floats, scale: Floats, rough: Floats) -> Floats:
    """Return how unlikely distances are where some bodies are triangulated badly, in nats.

    These are off by `rough`.
    """
    usual = np.log1p(-_ROUGH) - surprise(distance, scale) - 3 * np.log(scale)
    wrong = np.log(_ROUGH) - surprise(distance, rough) - 3 * np.log(rough)
    return -np.logaddexp(usual, wrong)


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
    sampled = mapped.take(points, evenly_spaced(np.arange(len(points)), _SAMPLE))
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
        chosen = evenly_spaced(np.arange(len(start)), _SAMPLE)
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
