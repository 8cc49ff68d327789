"""Weigh whether a camera's clock differs from the common one, or only seems to."""

from dataclasses import replace

import numpy as np

from mocap_calib.clocks.paths import (
    Agreements,
    Pair,
    Ridge,
    agreement_table,
    standardise,
)
from mocap_calib.clocks.timing import Singles, ViewInTime, compare_in_time
from mocap_calib.config import VOTE_TOLERANCE, SyncConfig
from mocap_calib.types import Bools, Floats, Ints


def weigh_clock(
    agreements: Agreements,
    views: list[ViewInTime],
    view: int,
    ridge: Ridge,
    *,
    rate: float,
    maps: Ints,
    config: SyncConfig,
) -> dict[str, float]:
    """Return the evidence for the map of one camera, against that of a camera in step.

    score: agreement with the other cameras, in standard deviations over all pairs of frames.
    gain: by how much it is more than in step; sigma: that, in standard errors.
    margin: by how many standard errors it is more than at any one offset that is no neighbour.
    votes: the share of the other cameras that agree best at this offset, each by itself.

    Cameras that differ alike say nothing: they would agree as well if all of them were in step.

    maps: `[view, stretch, frame]` own frames of all cameras, -1 = none.
    """
    agreements = _with_witnesses(agreements, view, maps)
    partners = len(agreements.partners(view))
    reach = agreements.shape[1]
    table = agreement_table(agreements, view, maps, rate, window=reach)
    own = ridge.frames
    agreement, shown = along_map(table, own, rate)
    if ridge.steps:
        agreement = ridge.held_out
    if not partners or not shown.any():
        return dict.fromkeys(("score", "gain", "sigma", "margin", "votes", "partners"), 0.0)
    evidence = {"score": float(agreement[shown].mean()) / partners, "gain": 0.0, "sigma": 0.0}
    time = np.arange(own.shape[1])
    if (own != time)[own >= 0].any():
        same = agreement_table(agreements, view, maps, 1.0)[..., agreements.window]
        refitted = _refit_in_step(agreements, views, view, maps, config)
        other = agreement_table(refitted, view, maps, 1.0)[..., agreements.window]
        alternative = other if other.sum() > same.sum() else same
        difference = (agreement - alternative) / partners
        evidence["gain"] = float(difference[shown].mean())
        evidence["sigma"] = standard_errors(difference, config, shown)
    evidence["partners"] = partners
    evidence["votes"] = _votes(agreements, view, maps, rate)
    evidence["margin"] = _margin(table, agreement, shown, config)
    return evidence


def _with_witnesses(agreements: Agreements, view: int, maps: Ints) -> Agreements:
    """Return the agreements without the pairs of this camera and cameras that differ alike.

    The map of a camera that differs alike is at most `VOTE_TOLERANCE` frames from the map of this
    camera, and nearer to it than to the map of a camera in step.
    """
    time = np.arange(maps.shape[2])
    alike = set()
    for other in agreements.partners(view):
        known = (maps[view] >= 0) & (maps[other] >= 0)
        apart = np.abs(maps[other] - maps[view])[known]
        late = np.abs(maps[other] - time)[known]
        if known.any() and apart.mean() <= VOTE_TOLERANCE and apart.mean() < late.mean():
            alike.add(other)
    kept = {
        (a, b): values
        for (a, b), values in agreements.values.items()
        if not (view in (a, b) and alike & {a, b})
    }
    return replace(agreements, values=kept)


def standard_errors(difference: Floats, config: SyncConfig, shown: Bools | None = None) -> float:
    """Return the mean of `[stretch, frame]` in its standard errors, over blocks of time.

    Neighbouring frames err alike: blocks are what is independent. shown: `[stretch, frame]` the
    frames that count.
    """
    values = difference.ravel() if shown is None else difference[shown]
    each = max(-(-len(values) // config.evidence_blocks), 5)
    count = len(values) // each
    if count < config.least_blocks:
        return 0.0
    means = values[: count * each].reshape(count, each).mean(1)
    error = float(means.std(ddof=1)) / np.sqrt(count)
    return float(means.mean() / max(error, 1e-9))


def is_decisive(sigma: float, score: float, config: SyncConfig) -> bool:
    """Return whether so many standard errors decide, where cameras agree so well with each other.

    sigma, score: as of `weigh_clock`.
    """
    good = score >= config.good_score
    return sigma >= (config.decisive_of_good if good else config.decisive)


def along_map(table: Floats, own: Ints, rate: float) -> tuple[Floats, Bools]:
    """Return what a table `[stretch, frame, offset]` says of a map `[stretch, frame]`.

    The agreement `[stretch, frame]`, and where it is known.
    """
    time = np.arange(own.shape[1])
    place = own - np.round(rate * time).astype(np.int64) + table.shape[2] // 2
    shown = (own >= 0) & (place >= 0) & (place < table.shape[2])
    index = np.where(shown, place, 0)[..., None]
    return np.where(shown, np.take_along_axis(table, index, 2)[..., 0], 0.0), shown


def _refit_in_step(
    agreements: Agreements,
    views: list[ViewInTime],
    view: int,
    maps: Ints,
    config: SyncConfig,
) -> Agreements:
    """Return the agreements with the best rotations of a camera that were in step.

    Those with the cameras that are on the common clock: the best rotation at one offset would
    count against all others.
    """
    near = replace(config, window=1)
    time = np.arange(maps.shape[2])
    values: dict[Pair, Singles] = dict(agreements.values)
    for other in agreements.partners(view):
        if (maps[other] != time)[maps[other] >= 0].any():
            continue
        a, b = min(view, other), max(view, other)
        found = compare_in_time(views[a], views[b], near, np.random.default_rng(0))
        if found is not None:
            values[a, b] = standardise(agreements.found[a, b], found.values)
    return replace(agreements, values=values)


def _votes(agreements: Agreements, view: int, maps: Ints, rate: float) -> float:
    """Return the share of the other cameras that agree best near the map of a camera.

    0 where no other camera can be compared with it.
    """
    own, time = maps[view], np.arange(maps.shape[2])
    place = np.median((own - np.round(rate * time))[own >= 0]) + agreements.window
    votes = []
    for other in agreements.partners(view):
        table = agreement_table(agreements, view, maps, rate, partners=[other])
        curve = table.sum((0, 1))
        votes.append(abs(curve.argmax() - place) <= VOTE_TOLERANCE)
    return float(np.mean(votes)) if votes else 0.0


def _margin(table: Floats, agreement: Floats, shown: Bools, config: SyncConfig) -> float:
    """Return by how many standard errors a map is better than any distant constant offset.

    Offsets are distant beyond the place where the curve about the best has fallen by half.
    """
    curve = np.where(shown[..., None], table, 0.0).sum((0, 1))
    best = int(curve.argmax())
    low = curve < 0.5 * curve[best]
    below = np.flatnonzero(low[:best])
    above = np.flatnonzero(low[best:])
    left = below[-1] if len(below) else 0
    right = best + above[0] if len(above) else len(curve)
    distant = np.r_[0:left, right : len(curve)]
    if not len(distant):
        return 0.0
    rival = distant[curve[distant].argmax()]
    return standard_errors(agreement - table[..., rival], config, shown)
