"""Estimate the clock of each camera: constant offsets, frame rates, and lost frames.

Constant offsets maximise the agreement of all pairs. Then each camera is tried at other frame
rates, and at last with lost frames: steps of the ridge of its agreement with the others, found by
Viterbi's algorithm with a penalty for each step.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from mocap_calib.clocks.compare import (
    LEAST_FRAMES,
    Pair,
    Singles,
    ViewInTime,
    agreement,
    align_at,
)
from mocap_calib.clocks.evidence import (
    LEAST_BLOCK,
    Agreements,
    Timing,
    along_map,
    camera_table,
    evidence,
    standardise,
)
from mocap_calib.config import CLOCK_RATES, DECISIVE_NATS
from mocap_calib.kernels import clocks as kernels
from mocap_calib.kernels.loading import contiguous
from mocap_calib.types import Floats, Ints

_STEP_PENALTY = 3.0  # of a step of a map, in standard deviations of the agreement of a pair
LARGEST_STEP = 4  # frames that a camera may be ahead by at once, where the others lost so many


def find_timing(agreements: Agreements, *, constant: bool = False) -> Timing:
    """Return the maps of all cameras that agree best with each other.

    constant: offsets alone, no rates and no lost frames.
    """
    timing = _refit_constants(agreements, _constant_timing(agreements))
    if constant:
        return _on_common_clock(timing)
    timing = _improve(agreements, timing, _with_other_rate)
    timing = _improve(agreements, timing, _with_steps)
    return _on_common_clock(timing)


# Constant offsets


def constant_offsets(curves: Floats) -> Ints:
    """Return the offset `[view]` of each camera's frames, 0 of the first, that agrees best.

    The agreement of all pairs is maximised by coordinate ascent from every camera as root.

    curves: `[view, view, offset]` agreement of frames t of the first and t + offset of the second
        view; 0 where nothing is known, and in the outer thirds, so that any two offsets from one
        root can be compared.
    """
    middle = curves.shape[2] // 2
    starts = np.where(curves.any(2), curves.argmax(2) - middle, 0)
    found = [_ascend(curves, start) for start in starts]
    best = max(found, key=lambda offsets: _total(curves, offsets))
    return best - best[0]


def _ascend(curves: Floats, offsets: Ints) -> Ints:
    """Return offsets `[view]` of which none can be changed alone for the better."""
    offsets, middle = offsets.copy(), curves.shape[2] // 2
    candidates = np.arange(-(middle // 3 * 2), middle // 3 * 2 + 1)
    for _ in range(10):
        before = offsets.copy()
        for view in range(len(offsets)):
            place = (candidates - offsets[:, None] + middle).clip(0, 2 * middle)
            total = np.take_along_axis(curves[:, view], place, axis=1).sum(0)
            offsets[view] = candidates[total.argmax()]
        if np.array_equal(before, offsets):
            break
    return offsets


def _total(curves: Floats, offsets: Ints) -> float:
    """Return the agreement of all pairs at offsets `[view]`, rounded so that equal ones tie."""
    middle = curves.shape[2] // 2
    place = (offsets - offsets[:, None] + middle).clip(0, 2 * middle)
    return round(float(np.take_along_axis(curves, place[..., None], axis=2).sum()), 6)


def _curves(agreements: Agreements) -> Floats:
    """Return the agreement `[view, view, offset]` of pairs of views, as of `constant_offsets`."""
    views, (stretches, frames) = agreements.views, agreements.shape
    reach = max(0, min(2 * agreements.window, frames - LEAST_FRAMES))
    curves = np.zeros((views, views, 6 * reach + 1))
    time = np.arange(frames)
    row = np.tile(time, (stretches, 1))
    for (a, b), values in agreements.values.items():
        table = np.zeros((stretches, frames, 2 * reach + 1))
        kernels.add_windows(*contiguous(values, row, time - reach), table)
        curves[a, b, 2 * reach : 4 * reach + 1] = table.sum((0, 1))
        curves[b, a] = curves[a, b, ::-1]
    return curves


def _constant_timing(agreements: Agreements) -> Timing:
    """Return the timing of the constant offsets that agree best."""
    timing = Timing.synchronous(agreements)
    own = timing.maps + constant_offsets(_curves(agreements))[:, None, None]
    own = np.where((own >= 0) & (own < agreements.shape[1]), own, -1)
    return replace(timing, maps=own)


def _refit_constants(agreements: Agreements, timing: Timing) -> Timing:
    """Return the timing with the constant offsets that agree best with the maps of the others."""
    for view in range(agreements.views):
        if timing.is_constant(view):
            timing = _at_best_constant(agreements, timing, view, float(timing.rates[view]))
    return timing


def _at_best_constant(agreements: Agreements, timing: Timing, view: int, rate: float) -> Timing:
    """Return the timing with one camera at a rate and at its best constant offset."""
    partners, window = agreements.partners(view), 2 * agreements.window
    table = camera_table(agreements, timing.maps, view, rate, partners, window=window)
    path = np.full(table.shape[:2], table.sum((0, 1)).argmax())
    return _with_path(agreements, timing, view, table, path, rate=rate)


def _with_path(
    agreements: Agreements, timing: Timing, view: int, table: Floats, path: Ints, *, rate: float
) -> Timing:
    """Return the timing with one camera on a path `[stretch, frame]` of offsets of its table."""
    time = np.arange(table.shape[1])
    own = np.round(rate * time).astype(np.int64) + path - table.shape[2] // 2
    shown = (own >= 0) & (own < agreements.shape[1]) & np.isclose(rate * time % 1, 0)
    own = np.where(shown, own, -1)
    return timing.change(view, own, rate, along_map(table, own, rate)[0])


# Rates and lost frames

Change = Callable[[Agreements, Timing, int], Timing]


def _improve(agreements: Agreements, timing: Timing, change: Change) -> Timing:
    """Return the timing with a change of those cameras of which it is decisively better.

    One camera after the other, the one that gains most first: what is wrong with one camera shows
    in the tables of all.
    """
    left = [view for view in range(agreements.views) if agreements.partners(view)]
    while left:
        gains = []
        for view in left:
            changed = change(agreements, timing, view)
            shown = (changed.maps[view] >= 0) & (timing.maps[view] >= 0)
            difference = changed.agreement[view] - timing.agreement[view]
            if evidence(difference, shown) >= DECISIVE_NATS:
                gains.append((float(difference[shown].sum()), view, changed))
        if not gains:
            break
        _, view, timing = max(gains, key=lambda each: each[0])
        left.remove(view)
        timing = _refit_constants(agreements, timing)
    return timing


def _with_other_rate(agreements: Agreements, timing: Timing, view: int) -> Timing:
    """Return the timing with one camera at the rate, other than 1, at which it agrees best."""
    found = [
        _at_best_constant(agreements, timing, view, rate) for rate in CLOCK_RATES if rate != 1.0
    ]
    return max(found, key=lambda each: _mean_agreement(each, view))


def _mean_agreement(timing: Timing, view: int) -> float:
    """Return the mean agreement of one camera where its map is known."""
    shown = timing.maps[view] >= 0
    return float(timing.agreement[view][shown].mean()) if shown.any() else -np.inf


def _with_steps(agreements: Agreements, timing: Timing, view: int) -> Timing:
    """Return the timing with the map of one camera that may have steps."""
    rate, partners = float(timing.rates[view]), agreements.partners(view)
    # lost frames add up: in the end a clock may be off by more than at the beginning
    reach = min(2 * agreements.window, agreements.shape[1] // 2)
    table = camera_table(agreements, timing.maps, view, rate, partners, window=reach)
    found = _with_path(
        agreements, timing, view, table, follow_ridge(table, len(partners)), rate=rate
    )
    # a path bends to the noise of single frames: it counts where it predicts frames left out
    held_out = np.zeros(table.shape[:2])
    block = np.arange(table.shape[1]) // LEAST_BLOCK % 2
    for part in (0, 1):
        seen = np.where((block == part)[:, None], 0.0, table)
        path = follow_ridge(seen, len(partners))
        predicted = _with_path(agreements, timing, view, table, path, rate=rate)
        held_out[:, block == part] = predicted.agreement[view][:, block == part]
    return found.change(view, found.maps[view], rate, held_out)


def follow_ridge(table: Floats, partners: int) -> Ints:
    """Return the index of an offset `[stretch, frame]` for each frame, which seldom changes.

    It maximises the agreement less a penalty for each step (Viterbi's algorithm). A camera that
    lost frames falls behind by one of its frames at a time, as it never shows an earlier one again;
    where the others lost some, it is ahead by several at once.

    table: `[stretch, frame, offset]`, the sum over so many partners, which err alike.
    """
    paths = np.empty(table.shape[:2], dtype=np.int64)
    price = _STEP_PENALTY * np.sqrt(partners)
    for part, path in zip(contiguous(*table), paths, strict=True):
        kernels.follow(part, price, LARGEST_STEP, path)
    return paths


def _on_common_clock(timing: Timing) -> Timing:
    """Return the timing by the clock that most cameras share; among equals, the first camera's."""
    constant = [
        int(timing.offsets(view)[0])
        for view, rate in enumerate(timing.rates)
        if rate == 1.0 and timing.is_constant(view) and len(timing.offsets(view))
    ]
    if not constant:
        return timing
    common = max(constant, key=lambda each: (constant.count(each), -constant.index(each)))
    # at time t of the common clock, what was shown at time t - common so far
    index = np.arange(timing.maps.shape[2]) - common
    inside = (index >= 0) & (index < len(index))
    index = np.where(inside, index, 0)
    return Timing(
        np.where(inside, timing.maps[..., index], -1),
        timing.rates,
        np.where(inside, timing.agreement[..., index], 0.0),
    )


# Maps and rotations of pairs, from bodies

Solution = tuple[dict[Pair, Singles], Timing]


def solve_maps(
    views: Sequence[ViewInTime], rotations: Mapping[Pair, Floats], window: int
) -> Solution:
    """Return the agreement of pairs and the maps, both fitted in turn from given rotations on."""
    for _ in range(2):
        values = agreement_values(views, rotations)
        timing = find_timing(scaled_agreements(values, values, len(views), window))
        rotations = _align_at_maps(views, rotations, timing)
    values = agreement_values(views, rotations)
    return values, find_timing(scaled_agreements(values, values, len(views), window))


def is_better(found: Solution, than: Solution) -> bool:
    """Return whether bodies agree decisively better in one solution than in another one."""
    first, second = (_along_maps(each, found[0].keys() & than[0].keys()) for each in (found, than))
    shown = np.isfinite(first) & np.isfinite(second)
    return evidence(first - second, shown) >= DECISIVE_NATS


def _along_maps(solution: Solution, pairs: Iterable[Pair]) -> Floats:
    """Return the mean agreement `[stretch, frame]` of pairs at the times of the maps."""
    values, timing = solution
    total, count = np.zeros(timing.maps.shape[1:]), np.zeros(timing.maps.shape[1:])
    for a, b in pairs:
        own_a, own_b = timing.maps[a], timing.maps[b]
        stretch = np.arange(len(own_a))[:, None]
        agreement = values[a, b][stretch, np.maximum(own_a, 0), np.maximum(own_b, 0)]
        known = (own_a >= 0) & (own_b >= 0) & np.isfinite(agreement)
        total += np.where(known, agreement, 0.0)
        count += known
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def agreement_values(
    views: Sequence[ViewInTime], rotations: Mapping[Pair, Floats]
) -> dict[Pair, Singles]:
    """Return the agreement of pairs of views under rotations b_from_a."""
    return {(a, b): agreement(views[a], views[b], turn) for (a, b), turn in rotations.items()}


def scaled_agreements(
    values: Mapping[Pair, Singles], like: Mapping[Pair, Singles], views: int, window: int
) -> Agreements:
    """Return agreement in standard deviations of that of the same pairs in `like`."""
    scaled = {pair: standardise(each, like[pair]) for pair, each in values.items()}
    return Agreements(views, scaled, window)


def _align_at_maps(
    views: Sequence[ViewInTime], rotations: Mapping[Pair, Floats], timing: Timing
) -> dict[Pair, Floats]:
    """Return the rotations of pairs that align their bodies at the times of the maps."""
    return {
        (a, b): align_at(views[a], views[b], turn, timing.maps[a], timing.maps[b])
        for (a, b), turn in rotations.items()
    }
