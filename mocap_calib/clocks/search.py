"""Search for the times at which all cameras agree: offsets, rates, and frames that were lost."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mocap_calib.clocks.evidence import along_map, is_decisive, standard_errors
from mocap_calib.clocks.paths import (
    Agreements,
    Ridge,
    agreement_table,
    best_constant,
    constant_offsets,
    follow_ridge,
    ridge_of,
    step_price,
)
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import CLOCK_RATES, RATE_LEAST_SHARE, SyncConfig
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import Floats, Ints


@dataclass(frozen=True)
class Timing:
    """How the frames of all cameras go together, as found so far.

    ridges: `[view]`; rates: `[view]`.
    """

    ridges: tuple[Ridge, ...]
    rates: tuple[float, ...]

    @property
    def maps(self) -> Ints:
        """`[view, stretch, frame]` own frames of each camera, -1 = none."""
        return np.stack([ridge.frames for ridge in self.ridges])

    def with_ridge(self, view: int, ridge: Ridge, rate: float) -> "Timing":
        """Return the timing with another map of one camera."""
        ridges, rates = list(self.ridges), list(self.rates)
        ridges[view], rates[view] = ridge, rate
        return Timing(tuple(ridges), tuple(rates))

    def in_step_but(self, kept: Sequence[bool]) -> "Timing":
        """Return the timing in which all cameras are in step but those `[view]` that are kept."""
        timing, time = self, np.arange(self.maps.shape[2])
        for view in np.flatnonzero(~np.array(kept)).tolist():
            ridge = self.ridges[view]
            nothing = np.zeros(ridge.frames.shape)
            own = np.broadcast_to(time, ridge.frames.shape)
            timing = timing.with_ridge(view, Ridge(own, 0, nothing, 0.0, 0.0, nothing), 1.0)
        return timing


def find_timing(agreements: Agreements, rates: tuple[float, ...], config: SyncConfig) -> Timing:
    """Return the maps of all cameras that agree best with each other."""
    equal = [view for view, rate in enumerate(rates) if rate == 1.0]
    inside = {p: v for p, v in agreements.values.items() if p[0] in equal and p[1] in equal}
    offsets = np.zeros(agreements.views, dtype=np.int64)
    if inside:
        offsets = constant_offsets(replace(agreements, values=inside), config.least_frames)
    timing = _constant_timing(agreements, offsets, rates)
    timing = _try_rates(agreements, timing, config)
    timing, restless = _add_steps(agreements, timing, config)
    if restless >= config.least_restless_gain and equal:
        roots = evenly_spaced(np.array(equal), config.roots).tolist()
        follow = partial(_follow_one, agreements, rates, config=config)
        followed = map_in_threads(follow, roots)
        other = max(followed, key=lambda each: _total(agreements, each))
        good = _median_score(agreements, other) >= config.wandering_score
        gained = _total(agreements, other) - _total(agreements, timing)
        compared = len(agreements.values) * np.prod(agreements.shape)
        if good and gained >= config.least_step_gain * compared:
            return other
    return timing


def _median_score(agreements: Agreements, timing: Timing) -> float:
    """Return how well a usual camera agrees with the others, in standard deviations.

    A pair whose rotation is wrong, as of a gait seen from the other side, spoils two cameras.
    """
    scores = [
        float(ridge.held_out[ridge.frames >= 0].mean()) / len(agreements.partners(view))
        for view, ridge in enumerate(timing.ridges)
        if (ridge.frames >= 0).any() and agreements.partners(view)
    ]
    return float(np.median(scores))


def _total(agreements: Agreements, timing: Timing) -> float:
    """Return how well all cameras agree with each other, less the price of their steps."""
    total = 0.0
    for view, (ridge, rate) in enumerate(zip(timing.ridges, timing.rates, strict=True)):
        table = agreement_table(agreements, view, timing.maps, rate, window=agreements.shape[1])
        agreement, shown = along_map(table, ridge.frames, rate)
        total += 0.5 * float(agreement[shown].sum()) - ridge.cost
    return total


def _constant_timing(agreements: Agreements, offsets: Ints, rates: tuple[float, ...]) -> Timing:
    """Return the timing of constant offsets `[view]`; those of cameras of other rates are found."""
    stretches, frames = agreements.shape
    own = np.arange(frames) + offsets[:, None]
    own = np.where((own >= 0) & (own < frames), own, -1)
    maps = np.repeat(own[:, None], stretches, axis=1)
    other = np.array(rates) != 1.0
    maps[other] = -1
    nothing = np.zeros((stretches, frames))
    timing = Timing(tuple(Ridge(each, 0, nothing, 0.0, 0.0, nothing) for each in maps), rates)
    for view in [*np.flatnonzero(other), *np.flatnonzero(~other)]:
        table = agreement_table(agreements, view, timing.maps, rates[view])
        offset = offsets[view] + agreements.window
        if other[view] or not 0 <= offset < table.shape[2]:
            offset = best_constant(table)
        ridge = ridge_of(table, np.full(maps.shape[1:], offset), rates[view], 0.0, frames)
        timing = timing.with_ridge(view, ridge, rates[view])
    return timing


def _try_rates(agreements: Agreements, timing: Timing, config: SyncConfig) -> Timing:
    """Return the timing with the rate of the camera that agrees much better at another rate.

    Where bodies move slowly, no pair by itself tells rates apart.
    """
    best, found = config.least_rate_gain, timing
    for view, ridge in enumerate(timing.ridges):
        partners = max(len(agreements.partners(view)), 1)
        stepped, rate = _as_rate(agreements, timing, view, ridge)
        if rate == timing.rates[view]:
            continue
        shown = stepped.frames >= 0
        gain = float((stepped.agreement - ridge.agreement)[shown].mean()) / partners
        sigma = standard_errors(stepped.agreement - ridge.agreement, config, shown)
        if gain > best and sigma >= config.decisive_of_good:
            best, found = gain, timing.with_ridge(view, stepped, rate)
    return found if found is timing else _settle_constants(agreements, found)


def _add_steps(agreements: Agreements, timing: Timing, config: SyncConfig) -> tuple[Timing, float]:
    """Return the timing with steps in the maps that are decisively better for them.

    And by how much a camera would gain by steps, decisively or not, where several would have some.

    One camera after the other, the one that gains most first: the faults of one camera show in the
    tables of all.
    """
    steady = list(range(agreements.views))
    restless = -np.inf
    while steady:
        gains = []
        for view in steady:
            ridge, before = _with_steps(agreements, timing, view, config), timing.ridges[view]
            difference = ridge.held_out - before.agreement
            if ridge.steps:
                partners = len(agreements.partners(view))
                score = float(ridge.held_out[ridge.frames >= 0].mean()) / partners
                sigma = standard_errors(difference, config)
                gain = float(difference[ridge.frames >= 0].mean()) / partners
                sure = is_decisive(sigma, score, config) and _is_plausible(ridge, score, config)
                sure = sure and gain >= config.least_step_gain
                net = ridge.total - before.total - ridge.cost
                gains.append((gain, net, sure, view, ridge))
        if len(gains) > 1:
            restless = max(restless, *(each[0] for each in gains))
        sure_gains = [each[1:] for each in gains if each[2]]
        if not sure_gains:
            break
        _, _, view, ridge = max(sure_gains, key=lambda each: each[0])
        steady.remove(view)
        ridge, rate = _as_rate(agreements, timing, view, ridge)
        timing = timing.with_ridge(view, ridge, rate)
        timing = _settle_constants(agreements, timing)
    return timing, restless


def _is_plausible(ridge: Ridge, score: float, config: SyncConfig) -> bool:
    """Return whether a map looks like that of a camera that lost frames.

    It loses some of the frames, and falls back steadily; where the other cameras lost frames as
    well it wanders, which needs good agreement to be told from noise.

    score: agreement with each of the others, in standard deviations.
    """
    few = ridge.steps <= config.most_steps * ridge.frames.size
    net = 0
    for own in ridge.frames:
        offset = (own - np.arange(len(own)))[own >= 0]
        net += abs(int(offset[-1] - offset[0])) if len(offset) else 0
    return few and (net >= ridge.steps / 2 or score >= config.wandering_score)


def _with_steps(agreements: Agreements, timing: Timing, view: int, config: SyncConfig) -> Ridge:
    """Return the map of one camera with steps, where they pay."""
    rate = timing.rates[view]
    # lost frames add up: in the end a clock may be off by more than at the beginning
    reach = min(2 * agreements.window, agreements.shape[1] // 2)
    partners = agreements.partners(view)
    halves = [
        agreement_table(agreements, view, timing.maps, rate, window=reach, partners=half)
        for half in (partners[::2], partners[1::2])
    ]
    table, price = halves[0] + halves[1], step_price(len(partners), config)
    ridge = ridge_of(table, follow_ridge(table, price), rate, price, agreements.shape[1])
    if not ridge.steps or len(partners) < 2:
        return ridge
    return replace(ridge, held_out=_hold_out(halves, partners, rate, config))


def _hold_out(
    halves: Sequence[Floats], partners: Sequence[int], rate: float, config: SyncConfig
) -> Floats:
    """Return the agreement `[stretch, frame]` of maps from one half of the others with the other.

    halves: two tables `[stretch, frame, offset]`.
    """
    held_out = np.zeros(halves[0].shape[:2])
    for given, other, count in zip(
        halves, halves[::-1], (len(partners[::2]), len(partners[1::2])), strict=True
    ):
        path = follow_ridge(given, step_price(count, config))
        held_out += ridge_of(other, path, rate, 0.0, given.shape[1]).agreement
    return held_out


def _as_rate(
    agreements: Agreements, timing: Timing, view: int, stepped: Ridge
) -> tuple[Ridge, float]:
    """Return the map and the rate of a camera: without steps where another rate agrees as well."""
    frames = agreements.shape[1]
    best = float(stepped.agreement[stepped.frames >= 0].mean())
    found = stepped, timing.rates[view]
    for rate in CLOCK_RATES:
        table = agreement_table(agreements, view, timing.maps, rate)
        path = np.full(table.shape[:2], best_constant(table))
        ridge = ridge_of(table, path, rate, 0.0, frames)
        mean = float(ridge.agreement[ridge.frames >= 0].mean()) if ridge.total else -np.inf
        if mean > best and (ridge.frames >= 0).sum() > RATE_LEAST_SHARE * stepped.frames.size:
            best, found = mean, (ridge, rate)
    return found


def _settle_constants(agreements: Agreements, timing: Timing) -> Timing:
    """Return the timing with the constant offsets that agree best with the maps of the others."""
    frames = agreements.shape[1]
    for view, ridge in enumerate(timing.ridges):
        if not ridge.steps:
            table = agreement_table(agreements, view, timing.maps, timing.rates[view])
            path = np.full(table.shape[:2], best_constant(table))
            new = ridge_of(table, path, timing.rates[view], 0.0, frames)
            timing = timing.with_ridge(view, new, timing.rates[view])
    return timing


def _follow_one(
    agreements: Agreements, rates: tuple[float, ...], root: int, config: SyncConfig
) -> Timing:
    """Return the timing in which all cameras follow the clock of one, and then of each other."""
    stretches, frames = agreements.shape
    nothing = np.zeros((stretches, frames))
    missing = Ridge(np.full((stretches, frames), -1), 0, nothing, 0.0, 0.0, nothing)
    whole = replace(missing, frames=np.tile(np.arange(frames), (stretches, 1)))
    ridges = [missing] * agreements.views
    ridges[root] = whole
    timing = Timing(tuple(ridges), rates)
    others = [view for view in range(agreements.views) if view != root]
    for view in others * 3:
        ridge = _with_steps(agreements, timing, view, config)
        timing = timing.with_ridge(view, ridge, rates[view])
    table = agreement_table(agreements, root, timing.maps, 1.0)
    path = np.full((stretches, frames), agreements.window)
    return timing.with_ridge(root, ridge_of(table, path, 1.0, 0.0, frames), 1.0)


def on_common_clock(agreements: Agreements, timing: Timing) -> Timing:
    """Return the timing by the clock that most cameras share; among equals, the first camera's."""
    frames = agreements.shape[1]
    time = np.arange(frames)
    offsets = []
    for ridge, rate in zip(timing.ridges, timing.rates, strict=True):
        known = ridge.frames[0] >= 0
        if rate == 1.0 and not ridge.steps and known.any():
            offsets.append(int((ridge.frames[0] - time)[known][0]))
    if not offsets:
        return timing
    common = max(offsets, key=lambda each: (offsets.count(each), -offsets.index(each)))
    if common == 0:
        return timing
    moved = []
    for ridge in timing.ridges:
        # at time t of the common clock, what was shown at time t - common so far
        index = time - common
        inside = (index >= 0) & (index < frames)
        index = np.where(inside, index, 0)
        moved.append(
            replace(
                ridge,
                frames=np.where(inside, ridge.frames[:, index], -1),
                agreement=np.where(inside, ridge.agreement[:, index], 0.0),
                held_out=np.where(inside, ridge.held_out[:, index], 0.0),
            )
        )
    return Timing(tuple(moved), timing.rates)
