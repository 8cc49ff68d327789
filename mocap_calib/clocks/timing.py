"""Compare the bodies of two views in all pairs of frames, before it is known how the clocks differ.

Lifted bodies of unit size differ by the rotation between the views alone. For one rotation R the
agreement of all bodies of one view with all of the other is a single matrix product, tr(R' b a')
of `[body, 3 J]` and `[3 J, body]`; that gives the scores of all offsets of the clocks at once, as
the diagonals of the agreement `[frame, frame]`, and its ridge shows lost frames and other rates.

The rotation is searched for like that of a pair in step (`pairs.search`), but with matches
of any two frames as candidates, and a score that leaves the time open: in each block of time, the
best diagonal.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_calib.config import CLOCK_RATES, SyncConfig
from mocap_calib.geometry.rotation import nearest_rotation
from mocap_calib.kernels import timing as kernels
from mocap_calib.kernels.loading import contiguous
from mocap_calib.pairs.search import well_separated
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import Bools, Floats, Ints

Singles = NDArray[np.float32]

_CELLS = 500_000  # pairs of bodies compared at a time: what a processor has at hand
_NOBODY = np.float32(-1e6)  # how alike a body is to one that is not there


@dataclass(frozen=True)
class ViewInTime:
    """The bodies of one view in stretches of consecutive frames.

    body: `[stretch, frame, instance, axis, 3]` unit bodies, of whose joints the main axes alone are
        kept; 0 where there is none.
    seen: `[stretch, frame, instance]` where there is one.
    """

    body: Singles
    seen: Bools


@dataclass(frozen=True)
class FrameAgreement:
    """How well two views agree in any two frames.

    rotation: `[3, 3]` of b_from_a.
    values: `[stretch, frame of a, frame of b]` 0..1, NaN where a view sees nobody.
    rate: of the frames of b, for one frame of a.
    score: 0..1, mean agreement at the best times.
    """

    rotation: Floats
    values: Singles
    rate: float
    score: float


def compare_in_time(
    a: ViewInTime, b: ViewInTime, config: SyncConfig, rng: np.random.Generator
) -> FrameAgreement | None:
    """Find the rotation under which two views agree best, at whatever times.

    Returns None where a view sees too little.
    """
    if min(a.seen.any(-1).sum(), b.seen.any(-1).sum()) < config.least_frames:
        return None
    rotation = _candidates(a, b, config, rng)
    rows = _some_frames(a, config.searched_bodies)
    score = _score_at_any_time(a, b, rotation, rows, config)
    best = _prefer_equal_rates(score, config).max(1)
    kept = well_separated(
        rotation, best, count=config.hypotheses_refined, separation_deg=config.separation_deg
    )
    rows = _some_frames(a, config.refined_bodies)
    found = []
    for k in kept:
        rate = CLOCK_RATES[int(_prefer_equal_rates(score[k], config).argmax())]
        turned = rotation[k]
        for _ in range(config.refinements):
            turned = _align(a, b, turned, rate=rate, rows=rows, config=config)
        found.append((turned, rate))
    score = _score_at_any_time(a, b, np.stack([turned for turned, _ in found]), rows, config)
    judged = _prefer_equal_rates(score, config)
    k, r = np.unravel_index(int(judged.argmax()), score.shape)
    turned = found[k][0]
    values = agree_in_all_frames(a, b, turned)
    return FrameAgreement(turned, values, CLOCK_RATES[r], float(score[k, r]))


def agree_in_all_frames(a: ViewInTime, b: ViewInTime, rotation: Floats) -> Singles:
    """Return the agreement `[stretch, frame of a, frame of b]` under one rotation b_from_a."""
    return _agreement(a, b, rotation[None], np.arange(a.seen.shape[1]))[0]


def diagonals(values: Singles, window: int, rate: float = 1.0, rows: Ints | None = None) -> Singles:
    """Return the agreement `[..., frame of a, offset]` of frames t and round(rate t) + offset.

    values: `[..., frame of a, frame of b]`. Offsets go from -window to window; NaN where the other
    view has no such frame. rows: the frames of a, where they are not all.
    """
    frames = np.arange(values.shape[-2]) if rows is None else rows
    column = np.round(frames * rate).astype(np.int64)[:, None] + np.arange(-window, window + 1)
    inside = (column >= 0) & (column < values.shape[-1])
    index = np.where(inside, column, 0)
    index = np.broadcast_to(index, (*values.shape[:-2], *column.shape))
    return np.where(inside, np.take_along_axis(values, index, -1), np.float32(np.nan))


def _agreement(a: ViewInTime, b: ViewInTime, rotation: Floats, rows: Ints) -> Singles:
    """Return how well the bodies of two frames match, `[hypothesis, stretch, row, frame]`.

    Each body counts with the other view's most alike; NaN where a view sees nobody. The instances
    of a frame are few: those of a are taken one by one, which keeps the arrays small.

    rotation: `[hypothesis, 3, 3]` b_from_a. rows: `[row]` frames of a.
    """
    seen_a = a.seen[:, rows]
    turned = _mark(_turn(a.body[:, rows], rotation), seen_a.swapaxes(1, 2), first=True)
    other = _mark(_flatten(b.body).swapaxes(1, 2), b.seen.swapaxes(1, 2), first=False)
    other = np.ascontiguousarray(other.swapaxes(2, 3))  # [stretch, instance, number, frame]
    other = np.moveaxis(other, 1, 0)[:, None]
    best_of_b: Singles = turned[:, :, 0] @ other  # [instance of b, hypothesis, stretch, row, frame]
    total = _alike(best_of_b.max(0))
    for i in range(1, turned.shape[2]):
        cosine = turned[:, :, i] @ other
        total += _alike(cosine.max(0))
        np.maximum(best_of_b, cosine, out=best_of_b)
    if len(best_of_b) == turned.shape[2] == 1:
        total *= np.float32(2.0)
    else:
        for best in best_of_b:
            total += _alike(best)
    count_a, count_b = seen_a.sum(-1)[..., None], b.seen.sum(-1)[:, None]
    total /= np.maximum(count_a + count_b, 1).astype(np.float32)
    return np.where((count_a > 0) & (count_b > 0), total, np.float32(np.nan))


def _mark(body: Singles, seen: Bools, *, first: bool) -> Singles:
    """Return bodies `[..., instance, frame, 3 axis]` with two more numbers each.

    The product of two of them is that of the bodies, and `_NOBODY` or less where one is missing.
    """
    here = np.broadcast_to(np.where(seen, np.float32(0.0), _NOBODY), body.shape[:-1])
    marks = (here, np.ones_like(here))
    return np.concatenate([body, np.stack(marks if first else marks[::-1], axis=-1)], axis=-1)


def _turn(body: Singles, rotation: Floats) -> Singles:
    """Return bodies `[stretch, row, instance, axis, 3]` turned by rotations, ready to be compared.

    `[hypothesis, stretch, instance, row, 3 axis]`.
    """
    turned = body.reshape(1, -1, 3) @ rotation.astype(np.float32).swapaxes(1, 2)
    return np.moveaxis(_flatten(turned.reshape(len(rotation), *body.shape)), 3, 2)


def _flatten(body: Singles) -> Singles:
    """Return bodies `[..., axis, 3]` as vectors `[..., 3 axis]`."""
    return body.reshape(*body.shape[:-2], -1)


def _alike(cosine: Singles) -> Singles:
    """Return 0..1 how alike two bodies are, given tr(R' b a') / J; 0 where one is not there."""
    square = np.float32(SyncConfig.pose_tolerance**2)
    found = (cosine - np.float32(1.0)) / square
    return np.exp(found, out=found)


def _some_frames(view: ViewInTime, bodies: int) -> Ints:
    """Return frames (indices within the stretches), evenly spread, with so many bodies in all."""
    per_frame = max(view.seen.sum() / view.seen.shape[1], 1.0)
    return evenly_spaced(np.arange(view.seen.shape[1]), max(int(bodies / per_frame), 8))


def _prefer_equal_rates(score: Floats, config: SyncConfig) -> Floats:
    """Return scores `[..., rate]` in which another rate must be clearly better than none."""
    return score - config.rate_gain * (np.array(CLOCK_RATES) != 1.0)


def _candidates(
    a: ViewInTime, b: ViewInTime, config: SyncConfig, rng: np.random.Generator
) -> Floats:
    """Return rotations b_from_a `[candidate, 3, 3]` of pairs of bodies of alike shape."""
    of_a = a.body[a.seen]
    of_b = b.body[b.seen]
    some_a = of_a[rng.permutation(len(of_a))[: config.shapes]].astype(np.float64)
    some_b = of_b[rng.permutation(len(of_b))[: config.shapes_compared]].astype(np.float64)
    # shapes are compared by their Gram matrices, which no rotation changes
    gram_a = (some_a @ some_a.swapaxes(1, 2)).reshape(len(some_a), -1)
    gram_b = (some_b @ some_b.swapaxes(1, 2)).reshape(len(some_b), -1)
    apart = (gram_b**2).sum(1) - 2 * gram_a @ gram_b.T
    nearest = np.argsort(apart, axis=1, kind="stable")[:, : config.alike]
    covariance = some_b[nearest].swapaxes(2, 3) @ some_a[:, None]
    return nearest_rotation(covariance.reshape(-1, 3, 3))


def _score_at_any_time(
    a: ViewInTime, b: ViewInTime, rotation: Floats, rows: Ints, config: SyncConfig
) -> Floats:
    """Return the mean agreement `[hypothesis, rate]` of blocks of time, each at its best offset."""
    cells = len(rows) * b.seen.size
    each = max(1, _CELLS // max(cells, 1))
    scores = []
    for start in range(0, len(rotation), each):
        values = _agreement(a, b, rotation[start : start + each], rows)
        by_rate = [_best_in_blocks(values, rate, rows, config)[0] for rate in CLOCK_RATES]
        scores.append(np.stack(by_rate, 1))
    return np.concatenate(scores)


def _best_in_blocks(
    values: Singles, rate: float, rows: Ints, config: SyncConfig
) -> tuple[Floats, Ints]:
    """Return the mean over the blocks of the best diagonal, and these diagonals.

    `[hypothesis]` and `[hypothesis, stretch, block]` index of the offset, -1 where nothing is seen.

    values: `[hypothesis, stretch, row, frame]`, rows: `[row]` frames of a.
    """
    blocks = count_blocks(values.shape[-1], config)
    each = len(rows) // blocks
    total, known = _sum_on_diagonals(values, rate, rows, blocks, config.window)
    mean = total / np.maximum(known, 1)
    mean = np.where(known >= config.block_share * each, mean, -1.0)
    best = mean.max(-1)
    used = best >= 0
    score = np.where(used, best, 0.0).sum((1, 2)) / np.maximum(used.sum((1, 2)), 1)
    # one block that agrees by chance is no evidence
    score = score * np.minimum(1.0, used.sum((1, 2)) / max(0.5 * blocks, 1.0))
    return score, np.where(used, mean.argmax(-1), -1)


def _sum_on_diagonals(
    values: Singles, rate: float, rows: Ints, blocks: int, window: int
) -> tuple[Singles, Ints]:
    """Return the sums of what is known on the diagonals, and how many they are, of each block.

    Both `[hypothesis, stretch, block, offset]`, the offsets as of `diagonals`.

    values: `[hypothesis, stretch, row, frame]`, rows: `[row]` frames of a, of which those beyond
        the blocks are left out.
    """
    each = len(rows) // blocks
    shape = (*values.shape[:2], blocks, 2 * window + 1)
    total, known = np.zeros(shape, np.float32), np.zeros(shape, np.int64)
    first = np.round(rows * rate).astype(np.int64) - window
    kernels.sum_on_diagonals(*contiguous(values, first), each, total, known)
    return total, known


def count_blocks(frames: int, config: SyncConfig) -> int:
    """Return into how many blocks of time a stretch of so many frames is cut."""
    return max(1, frames // config.block_frames)


def _align(
    a: ViewInTime,
    b: ViewInTime,
    rotation: Floats,
    *,
    rate: float,
    rows: Ints,
    config: SyncConfig,
) -> Floats:
    """Return the rotation that aligns the bodies best that match at the best offset of each block.

    rows: `[row]` frames of a.
    """
    values = _agreement(a, b, rotation[None], rows)
    _, offsets = _best_in_blocks(values, rate, rows, config)
    blocks = offsets.shape[-1]
    block = np.minimum(np.arange(len(rows)) // max(len(rows) // blocks, 1), blocks - 1)
    offset = offsets[0][:, block]
    column = np.round(rows * rate).astype(np.int64) + offset - config.window
    stretch, row = np.nonzero((offset >= 0) & (column >= 0) & (column < b.seen.shape[1]))
    if not len(stretch):
        return rotation
    of_a, of_b = (stretch, rows[row]), (stretch, column[stretch, row])
    body_a, body_b = a.body[of_a], b.body[of_b]  # [match, instance, axis, 3]
    both = a.seen[of_a][:, :, None] & b.seen[of_b][:, None]
    turned = _flatten(body_a @ rotation.T.astype(np.float32))
    cosine = np.where(both, turned @ _flatten(body_b).swapaxes(1, 2), np.float32(-1.0))
    mutual = (cosine >= cosine.max(2, keepdims=True)) & (cosine >= cosine.max(1, keepdims=True))
    frame, i, j = np.nonzero(mutual & both)
    if not len(frame):
        return rotation
    weighted = _alike(cosine[frame, i, j])[:, None, None] * body_b[frame, j]
    covariance = weighted.reshape(-1, 3).T @ body_a[frame, i].reshape(-1, 3)
    return nearest_rotation(covariance.astype(np.float64))
