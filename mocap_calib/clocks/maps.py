"""The clock of each camera: constant offset, frame rate, lost frames, and the evidence for it.

A camera's *map* is its own frame at each frame of a clock that is common to all. Given the maps of
the others, the agreement of a camera with them is a table over its own frames. Constant offsets
maximise it. Then each camera is tried at other frame rates, and at last with lost frames: steps of
the ridge of its table, found by Viterbi's algorithm with a penalty for each step. Lost frames make
a camera fall behind, never run ahead: that tells who lost them, also of two cameras.

Evidence is counted in nats: by how much it favours a map over the frame numbers as they are, given
the spread of the agreement over blocks of time.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.clocks.compare import LEAST_FRAMES, Agreements
from mocap_calib.config import CLOCK_RATES, DECISIVE_NATS, UncertaintyConfig
from mocap_calib.kernels import clocks as kernels
from mocap_calib.kernels.jit import contiguous
from mocap_calib.types import Bools, CameraClock, ClockKind, Floats, Ints

_LEAST_BLOCK = 5  # frames
_CLOSE = 0.25  # frames, within which frames of other rates count as of one time
_STEP_PENALTY = 3.0  # of a step of a map, in standard deviations of the agreement of a pair


@dataclass(frozen=True)
class Timing:
    """The maps of all cameras.

    maps: `[view, stretch, frame]` own frames, -1 = none. rates: `[view]` own frames for one of the
    common clock. start: `[stretch]` frames of the common clock before each stretch.
    """

    maps: Ints
    rates: Floats
    start: Ints

    @classmethod
    def synchronous(cls, views: int, start: Ints, frames: int) -> "Timing":
        """Return the timing of frame numbers as they are. frames: of each stretch."""
        maps = np.broadcast_to(np.arange(frames), (views, len(start), frames))
        return cls(maps, np.ones(views), start)

    def at_rate(self, rate: float) -> tuple[Ints, Bools]:
        """Return the own frames `[stretch, frame]` at a rate, and where they are close in time."""
        exact = rate * (self.start[:, None] + np.arange(self.maps.shape[2])) - self.start[:, None]
        own = np.round(exact).astype(np.int64)
        return own, np.asarray(np.abs(exact - own) < _CLOSE)

    def change(self, view: int, own: Ints, rate: float) -> "Timing":
        """Return the timing with another map `[stretch, frame]` of one camera."""
        maps, rates = self.maps.copy(), self.rates.copy()
        maps[view], rates[view] = own, rate
        return replace(self, maps=maps, rates=rates)

    def offsets(self, view: int) -> Ints:
        """Return the offsets `[stretch, frame]` of one camera from its rate."""
        return self.maps[view] - self.at_rate(float(self.rates[view]))[0]


def evidence(difference: Floats, shown: Bools) -> float:
    """Return the evidence, in nats, that the mean of `[stretch, frame]` is not 0; < 0 where below.

    The log likelihood ratio of normal errors of unknown size, over blocks of time.
    """
    values = difference[shown]
    if len(values) < LEAST_FRAMES:
        return 0.0
    block = time_blocks(len(values))
    count = np.bincount(block)
    means = np.bincount(block, values) / count
    ratio = means.mean() ** 2 / max(means.var(), 1e-12)
    return float(np.sign(means.mean()) * len(count) / 2 * np.log1p(ratio))


def time_blocks(frames: int) -> Ints:
    """Return the block `[frame]` of each of so many frames: 20 at most, of 5 frames at least.

    Neighbouring frames err alike, blocks do not.
    """
    count = min(UncertaintyConfig.time_blocks, frames // _LEAST_BLOCK)
    return np.arange(frames) * count // max(frames, 1)


def _offset_table(
    agreements: Agreements,
    timing: Timing,
    view: int,
    rate: float,
    partners: Sequence[int],
    *,
    window: int,
) -> Floats:
    """Return how well each frame of a camera agrees with the others, `[stretch, frame, offset]`.

    At frame t of the common clock its own frame is rate t + offset, offsets from -window to window.
    """
    own, close = timing.at_rate(rate)
    first = own - window
    table = np.zeros((*own.shape, 2 * window + 1))
    for other in partners:
        row = np.where(close, timing.maps[other], -1)
        kernels.add_windows(*contiguous(agreements.values[other, view], row, first), table)
    return table


def agreement_along(
    agreements: Agreements, maps: Ints, view: int, partners: Sequence[int]
) -> Floats:
    """Return the sum `[stretch, frame]` of the agreement of a camera with others at its map.

    0 where its map has no frame. maps: `[view, stretch, frame]`, see `Timing`.
    """
    own, stretch = maps[view], np.arange(maps.shape[1])[:, None]
    total = np.zeros(own.shape)
    for other in partners:
        values = agreements.values[view, other][stretch, own, maps[other]]
        total += np.where((own >= 0) & (maps[other] >= 0), values, 0.0)
    return total


# The maps that agree best


def find_timing(agreements: Agreements, start: Ints, *, constant: bool = False) -> Timing:
    """Return the maps of all cameras that agree best, by the clock that most cameras share.

    start: `[stretch]` as of `Timing`. constant: offsets alone, no rates and no lost frames.
    """
    timing = _constant_timing(agreements, start)
    for change in () if constant else (_with_other_rate, _with_steps):
        timing = _improve(agreements, timing, change)
    return timing


def _constant_timing(agreements: Agreements, start: Ints) -> Timing:
    """Return the timing of the constant offsets of which none can be changed for the better.

    Each camera is placed beside those before it, then all are changed in turn.
    """
    timing = Timing.synchronous(agreements.views, start, agreements.shape[1])
    for view in range(agreements.views):
        placed = [other for other in agreements.partners(view) if other < view]
        timing = _at_best_constant(agreements, timing, view, 1.0, placed)
    for _ in range(10):
        before = timing
        for view in range(agreements.views):
            timing = _at_best_constant(agreements, timing, view, 1.0, agreements.partners(view))
        if np.array_equal(before.maps, timing.maps):
            break
    shown = timing.maps >= 0
    offsets = [int(timing.offsets(view)[shown[view]][0]) for view in range(agreements.views)]
    common = max(offsets, key=offsets.count)  # of equally many the first camera's
    for view, offset in enumerate(offsets):
        path = np.full(agreements.shape, offset - common)
        timing = _with_path(agreements, timing, view, path, 1.0)
    return timing


def _at_best_constant(
    agreements: Agreements, timing: Timing, view: int, rate: float, partners: Sequence[int]
) -> Timing:
    """Return the timing with one camera at a rate and at its best constant offset from partners."""
    window = max(0, min(2 * agreements.window, agreements.shape[1] - LEAST_FRAMES))
    table = _offset_table(agreements, timing, view, rate, partners, window=window)
    if not table.any():
        return timing
    path = np.full(table.shape[:2], table.sum((0, 1)).argmax())
    return _with_path(agreements, timing, view, path - window, rate)


def _with_path(
    agreements: Agreements, timing: Timing, view: int, path: Ints, rate: float
) -> Timing:
    """Return the timing with one camera on a path `[stretch, frame]` of offsets."""
    own, close = timing.at_rate(rate)
    own = own + path
    shown = (own >= 0) & (own < agreements.shape[1]) & close
    return timing.change(view, np.where(shown, own, -1), rate)


Change = Callable[[Agreements, Timing, int, Sequence[int]], tuple[Timing, Floats]]


def _improve(agreements: Agreements, timing: Timing, change: Change) -> Timing:
    """Return the timing with a change of those cameras of which it is decisively better.

    One camera after the other, the one that gains most first: what is wrong with one camera shows
    in the tables of all.

    change: returns a timing with another map of a camera, and its agreement `[stretch, frame]`.
    """
    left = [view for view in range(agreements.views) if agreements.partners(view)]
    if agreements.views == 2 and change is _with_other_rate:
        left = left[1:]  # either may be slow: the clock is that of the first one
    while left:
        gains = []
        for view in left:
            partners = agreements.partners(view)
            before = agreement_along(agreements, timing.maps, view, partners)
            changed, after = change(agreements, timing, view, partners)
            known = (timing.maps[view] >= 0) & (changed.maps[view] >= 0)
            if evidence(after - before, known) >= DECISIVE_NATS:
                gains.append((float((after - before)[known].sum()), view, changed))
        if not gains:
            break
        _, view, timing = max(gains, key=lambda each: each[0])
        left.remove(view)
    return timing


def _with_other_rate(
    agreements: Agreements, timing: Timing, view: int, partners: Sequence[int]
) -> tuple[Timing, Floats]:
    """Return the timing with one camera at the rate, other than 1, at which it agrees best."""
    found = []
    for rate in (*CLOCK_RATES[1:], _likeliest_drift(agreements, timing, view, partners)):
        changed = _at_best_constant(agreements, timing, view, rate, partners)
        agreement = agreement_along(agreements, changed.maps, view, partners)
        shown = np.count_nonzero(changed.maps[view] >= 0)
        found.append((agreement.sum() / max(shown, 1), changed, agreement))
    _, changed, agreement = max(found, key=lambda each: each[0])
    return changed, agreement


def _likeliest_drift(
    agreements: Agreements, timing: Timing, view: int, partners: Sequence[int]
) -> float:
    """Return the rate of a camera that runs ahead, or falls behind, by up to a window in the end.

    Of those that differ by a frame in the end, the one of most agreement at any offset.
    """
    window, last = agreements.window, timing.start[-1] + agreements.shape[1] - 1
    table = _offset_table(agreements, timing, view, 1.0, partners, window=2 * window)
    rates = 1 + np.arange(-window, window + 1) / max(last, 1)
    total = np.zeros((len(rates), 2 * window + 1))
    kernels.sum_on_lines(*contiguous(table, timing.start), rates - 1, total)
    total[window] = -np.inf  # no drift
    return float(rates[total.max(1).argmax()])


def _with_steps(
    agreements: Agreements, timing: Timing, view: int, partners: Sequence[int]
) -> tuple[Timing, Floats]:
    """Return the timing with the map of one camera that may have steps.

    A path bends to the noise of single frames: its agreement is that of paths found without the
    blocks of frames that they predict.
    """
    rate = min(CLOCK_RATES, key=lambda each: abs(each - timing.rates[view]))
    # lost frames add up: in the end a clock may be off by more than at the beginning
    reach = min(2 * agreements.window, agreements.shape[1] // 2)
    table = _offset_table(agreements, timing, view, rate, partners, window=reach)
    path = follow_ridge(table, len(partners))
    held_out = np.zeros(table.shape[:2])
    block = np.arange(table.shape[1]) // _LEAST_BLOCK % 2
    for part in (0, 1):
        other = follow_ridge(np.where((block == part)[:, None], 0.0, table), len(partners))
        predicted = np.take_along_axis(table, other[..., None], 2)[..., 0]
        held_out[:, block == part] = predicted[:, block == part]
    return _with_path(agreements, timing, view, path - reach, rate), held_out


def follow_ridge(table: Floats, partners: int) -> Ints:
    """Return the index of an offset `[stretch, frame]` for each frame, which seldom changes.

    It maximises the agreement less a penalty for each step (Viterbi's algorithm). The numbers of a
    camera that lost frames fall behind, by any number of frames at a time.

    table: `[stretch, frame, offset]`, the sum over so many partners, which err alike.
    """
    paths = np.empty(table.shape[:2], dtype=np.int64)
    price = _STEP_PENALTY * np.sqrt(partners)
    for part, path in zip(contiguous(*table), paths, strict=True):
        kernels.follow(part, price, path)
    return paths


# The evidence for a map


def _margin(table: Floats, agreement: Floats, shown: Bools) -> float:
    """Return by how many nats a map is better than any distant constant offset.

    Offsets are distant beyond the place where the curve about the best has fallen by half.
    """
    curve = np.where(shown[..., None], table, 0.0).sum((0, 1))
    best = int(curve.argmax())
    low = curve < 0.5 * curve[best]
    below, above = np.flatnonzero(low[:best]), np.flatnonzero(low[best:])
    left = below[-1] if len(below) else 0
    right = best + above[0] if len(above) else len(curve)
    distant = np.r_[0:left, right : len(curve)]
    if not len(distant):
        return 0.0
    rival = distant[curve[distant].argmax()]
    return evidence(agreement - table[..., rival], shown)


def weigh(agreements: Agreements, timing: Timing, view: int) -> dict[str, float]:
    """Return the evidence for the map of one camera.

    score: agreement with the other cameras, in standard deviations over all pairs of frames.
    gain: nats by which it is more than with its frame numbers as they are; 0 for these.
    margin: nats by which it is more than at any one offset that is no neighbour.

    Cameras that differ alike are no evidence: they would agree as well if all of them were in step.
    """
    witnesses = _witnesses(agreements, timing, view)
    own, rate = timing.maps[view], float(timing.rates[view])
    shown = own >= 0
    if not witnesses or not shown.any():
        return {"score": 0.0, "gain": 0.0, "margin": 0.0, "partners": 0.0}
    window = agreements.shape[1]
    table = _offset_table(agreements, timing, view, rate, witnesses, window=window)
    agreement = agreement_along(agreements, timing.maps, view, witnesses)
    as_numbered = timing.change(view, np.arange(window), 1.0)
    numbered = agreement_along(agreements, as_numbered.maps, view, witnesses)
    return {
        "score": float(agreement[shown].mean()) / len(witnesses),
        "gain": evidence(agreement - numbered, shown),
        "margin": _margin(table, agreement, shown),
        "partners": float(len(witnesses)),
    }


def _witnesses(agreements: Agreements, timing: Timing, view: int) -> list[int]:
    """Return the partners of a camera but those that differ alike, within a frame."""
    maps, time = timing.maps, np.arange(timing.maps.shape[2])
    found = []
    for other in agreements.partners(view):
        known = (maps[view] >= 0) & (maps[other] >= 0)
        apart = np.abs(maps[other] - maps[view])[known]
        late = np.abs(maps[other] - time)[known]
        if not (known.any() and apart.mean() <= 1 and apart.mean() < late.mean()):
            found.append(other)
    return found


def describe_clocks(
    names: Sequence[str], numbers: Ints, agreements: Agreements, timing: Timing
) -> tuple[CameraClock, ...]:
    """Return the clock of each camera.

    Cameras of which nothing decisive is found stay as they are. Then the others are judged again:
    each must also differ from the cameras that stay.

    numbers: `[stretch, frame]` of the frames, also of those that are not there.
    """
    stay = np.zeros(len(names), dtype=bool)
    while True:
        cameras = tuple(
            describe_clock(
                name,
                timing,
                view,
                numbers,
                weigh(agreements, timing, view),
                window=agreements.window,
            )
            for view, name in enumerate(names)
        )
        differ = np.array([camera.differs for camera in cameras])
        if (differ | stay).all() or not differ.any():
            return cameras
        stay = ~differ
        timing = replace(
            timing,
            maps=np.where(stay[:, None, None], np.arange(timing.maps.shape[2]), timing.maps),
            rates=np.where(stay, 1.0, timing.rates),
        )


def describe_clock(
    camera: str,
    timing: Timing,
    view: int,
    numbers: Ints,
    found: Mapping[str, float],
    *,
    window: int,
) -> CameraClock:
    """Return what kind of clock a camera has, given its map and the evidence for it.

    numbers: `[stretch, frame]` as of `frame_numbers`. found: as of `weigh`.
    window: frames by which it may be early or late at first.
    """
    own, rate = timing.maps[view], float(timing.rates[view])
    known, offset = own >= 0, timing.offsets(view)
    constant = not known.any() or np.ptp(offset[known]) == 0
    sure = found["margin"] >= DECISIVE_NATS
    within = known.any() and abs(offset[known][0]) <= window
    if rate == 1.0 and not offset[known].any() and known.any():
        return CameraClock(camera, "in step" if sure else "not known", evidence=found)
    table = _table(timing, view, numbers) if known.any() else ()
    # each further row gains by chance (Akaike 1974)
    enough = found["gain"] >= DECISIVE_NATS + max(0, len(table) - 2)
    if not (enough and (sure or not constant) and within):
        return CameraClock(camera, "not known", evidence=found)
    kind: ClockKind = "rate" if rate != 1.0 else "clock" if constant else "dropped"
    return CameraClock(camera, kind, table[0][1], rate, table, found)


def _table(timing: Timing, view: int, numbers: Ints) -> tuple[tuple[int, int], ...]:
    """Return (frame, offset): the frame of the common clock from which on each offset holds."""
    own, rate = timing.maps[view], timing.rates[view]
    stretch, _ = np.nonzero(own >= 0)
    changes = np.diff(stretch) | np.diff(timing.offsets(view)[own >= 0])
    begins = np.append(True, changes != 0)
    frame = numbers[own >= 0][begins]
    shown = (numbers[:, :1] + (numbers[0, 1] - numbers[0, 0]) * own)[own >= 0][begins]
    # the rate is counted from the first frame of the table
    late = shown - frame[0] - np.round((frame - frame[0]) * rate).astype(np.int64)
    kept = np.append(True, np.abs(np.diff(late)) > (rate not in CLOCK_RATES))  # of two roundings
    return tuple(zip(frame[kept].tolist(), late[kept].tolist(), strict=True))
