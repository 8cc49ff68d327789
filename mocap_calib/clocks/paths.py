"""When each camera saw what, from the agreement of all pairs in any two frames.

A camera's *map* says which of its own frames it shows at each frame of a clock that is common to
all; given the maps of the others, the agreement of a camera with them is a table over its own
frames, whose ridge is its map. Constant offsets are joined over all pairs by coordinate ascent
from every camera as root; lost frames and other rates are steps of the ridge, found by dynamic
programming with a price for each step.

Agreement is counted in standard deviations over all pairs of frames of two views, from their
median: what is not known counts as nothing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_calib.clocks.timing import FrameAgreement, Singles, diagonals
from mocap_calib.config import LARGEST_STEP, SyncConfig
from mocap_calib.kernels import clocks as kernels
from mocap_calib.kernels.loading import contiguous
from mocap_calib.types import Floats, Ints

Pair = tuple[int, int]


@dataclass(frozen=True)
class Ridge:
    """The map of one camera, and how well it agrees with the others there.

    frames: `[stretch, frame]` own frames, -1 = none. steps: how often the offset changes.
    agreement: `[stretch, frame]` with all others together, 0 where nothing is known; total: its
        sum. cost: the price of the steps.
    held_out: `[stretch, frame]` the agreement with each half of the others of the map that follows
        from the other half: steps that fit noise agree with nobody else.
    """

    frames: Ints
    steps: int
    agreement: Floats
    total: float
    cost: float
    held_out: Floats


@dataclass(frozen=True)
class Agreements:
    """The agreement of the pairs of so many views in all frames.

    found: (a, b) -> what was found of the pair.
    values: (a, b) -> `[stretch, frame of a, frame of b]`, 0 where nothing is known.
    """

    views: int
    found: Mapping[Pair, FrameAgreement]
    values: Mapping[Pair, Singles]
    window: int

    @property
    def shape(self) -> tuple[int, int]:
        """Number of stretches, and of the frames of each."""
        stretches, frames, _ = next(iter(self.values.values())).shape
        return stretches, frames

    def between(self, view: int, other: int) -> Singles | None:
        """Return `[stretch, frame of other, frame of view]`, None where nothing is known."""
        if (other, view) in self.values:
            return self.values[other, view]
        found = self.values.get((view, other))
        return None if found is None else found.swapaxes(1, 2)

    def partners(self, view: int) -> list[int]:
        """Return the views that this one is compared with."""
        return [other for other in range(self.views) if self.between(view, other) is not None]


def standardise(found: FrameAgreement, values: Singles | None = None) -> Singles:
    """Return agreement in standard deviations from its median, 0 where it is not known.

    values: `[...]` to standardise by what was found; None: those that were found.
    """
    known = found.values[np.isfinite(found.values)]
    spread = max(float(known.std()), 1e-3)
    values = found.values if values is None else values
    return np.where(np.isfinite(values), (values - np.median(known)) / spread, np.float32(0.0))


def constant_offsets(agreements: Agreements, least_frames: int) -> Ints:
    """Return the offset `[view]` of each camera's frames, 0 of the first, that agrees best."""
    curves = {}
    for pair, values in agreements.values.items():
        table = diagonals(values, agreements.window)
        known = np.isfinite(table).sum((0, 1))
        total = np.where(np.isfinite(table), table, 0.0).sum((0, 1))
        curves[pair] = np.where(known >= least_frames, total, 0.0)
    best, found = -np.inf, np.zeros(agreements.views, dtype=np.int64)
    with_partners = [_curves_of(curves, view, agreements) for view in range(agreements.views)]
    for root in range(agreements.views):
        start = _offsets_from(curves, root, agreements)
        offsets = _ascend(with_partners, start, agreements.window)
        total = sum(_at(curves[a, b], offsets[b] - offsets[a]) for a, b in sorted(curves))
        if total > best + 1e-9:
            best, found = total, offsets
    return found - found[0]


def _offsets_from(curves: Mapping[Pair, Floats], root: int, agreements: Agreements) -> Ints:
    """Return the offsets `[view]` at which each camera agrees best with one of them."""
    offsets = np.zeros(agreements.views, dtype=np.int64)
    for view in range(agreements.views):
        if (root, view) in curves:
            offsets[view] = curves[root, view].argmax() - agreements.window
        elif (view, root) in curves:
            offsets[view] = agreements.window - curves[view, root].argmax()
    return offsets


def _curves_of(
    curves: Mapping[Pair, Floats], view: int, agreements: Agreements
) -> tuple[Ints, Floats]:
    """Return the partners of a view, and how well it agrees with each, `[partner, offset]`.

    Offsets are those of the view's frames from the partner's, over all that `_ascend` asks for.
    """
    partners = [k for k in range(agreements.views) if (k, view) in curves or (view, k) in curves]
    reach = 4 * agreements.window
    table = np.zeros((len(partners), 2 * reach + 1))
    inside = slice(reach - agreements.window, reach + agreements.window + 1)
    for row, other in zip(table, partners, strict=True):
        known = (other, view) in curves
        row[inside] = curves[other, view] if known else curves[view, other][::-1]
    return np.array(partners, dtype=np.int64), table


def _ascend(with_partners: Sequence[tuple[Ints, Floats]], offsets: Ints, window: int) -> Ints:
    """Return offsets `[view]` of which none can be changed alone for the better.

    with_partners: of each view, see `_curves_of`.
    """
    candidates = np.arange(-2 * window, 2 * window + 1)
    for _ in range(10):
        before = offsets.copy()
        for view, (partners, table) in enumerate(with_partners):
            apart = candidates - offsets[partners, None]
            total = np.take_along_axis(table, apart + table.shape[1] // 2, axis=1).sum(0)
            offsets[view] = candidates[total.argmax()]
        if np.array_equal(before, offsets):
            break
    return offsets


def _at(curve: Floats, offset: Ints) -> Floats:
    """Return a curve `[offset]` over -window to window at offsets `[...]`, 0 beyond them."""
    index = np.asarray(offset) + len(curve) // 2
    inside = (index >= 0) & (index < len(curve))
    return np.where(inside, curve[np.where(inside, index, 0)], 0.0)


def agreement_table(
    agreements: Agreements,
    view: int,
    maps: Ints,
    rate: float,
    *,
    window: int | None = None,
    partners: Sequence[int] | None = None,
) -> Floats:
    """Return how well each frame of a camera agrees with the others, `[stretch, frame, offset]`.

    At frame t of the common clock its own frame is rate t + offset, offsets from -window to window;
    None: the window in which clocks may differ.

    maps: `[view, stretch, frame]` own frames of all cameras, -1 = none; that of the camera itself
        is not looked at. partners: the other cameras, None: all that it is compared with.
    """
    time = np.arange(maps.shape[2])
    exact = np.isclose(rate * time % 1, 0)
    reach = agreements.window if window is None else window
    first = np.round(rate * time).astype(np.int64) - reach
    table = np.zeros((agreements.shape[0], len(time), 2 * reach + 1))
    for other in agreements.partners(view) if partners is None else partners:
        values = agreements.between(view, other)
        if values is not None:
            _add_windows(values, np.where(exact, maps[other], -1), first, table)
    return table


def _add_windows(values: Singles, row: Ints, first: Ints, table: Floats) -> None:
    """Add windows of rows of agreement to a table `[stretch, time, offset]`.

    values: `[stretch, row, frame]`. row: `[stretch, time]` which one, -1 = none. first: `[time]`
    the frame at the first offset; frames that are not there add nothing.
    """
    kernels.add_windows(*contiguous(values, row, first), table)


def best_constant(table: Floats) -> int:
    """Return the index of the offset that agrees best in all frames, `[stretch, frame, offset]`."""
    return int(table.sum((0, 1)).argmax())


def follow_ridge(table: Floats, price: float) -> Ints:
    """Return the index of an offset `[stretch, frame]` for each frame, which seldom changes.

    It maximises the agreement less a price for each step (Viterbi's algorithm). A camera that lost
    frames falls behind by one of its frames at a time, as it never shows an earlier one again;
    where the others lost some, it is ahead by several at once.

    table: `[stretch, frame, offset]`.
    """
    paths = np.empty(table.shape[:2], dtype=np.int64)
    for part, path in zip(contiguous(*table), paths, strict=True):
        kernels.follow(part, price, LARGEST_STEP, path)
    return paths


def ridge_of(table: Floats, path: Ints, rate: float, price: float, frames: int) -> Ridge:
    """Return the map that a path `[stretch, frame]` through a table stands for.

    frames: of the camera.
    """
    time = np.arange(table.shape[1])
    own = np.round(rate * time).astype(np.int64) + path - table.shape[2] // 2
    shown = (own >= 0) & (own < frames) & np.isclose(rate * time % 1, 0)
    agreement = np.take_along_axis(table, path[..., None], 2)[..., 0]
    steps = int((np.diff(path, axis=1) != 0).sum())
    cost = price * steps
    own = np.where(shown, own, -1)
    return Ridge(own, steps, agreement, float(agreement.sum()), cost, agreement)


def step_price(partners: int, config: SyncConfig) -> float:
    """Return the price of a step of a camera with so many partners, with which it errs alike."""
    return float(config.step_price * np.sqrt(partners))
