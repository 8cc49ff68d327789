"""Agreement of two views in any two frames: of their lifted bodies, and of the rays of a rig.

Lifted bodies of unit size differ by the rotation between the views alone. Under one rotation R the
agreement of all bodies of one view with all bodies of the other is a matrix product, tr(R' b a') of
`[body, 3 J]` and `[3 J, body]`. Each diagonal of the agreement `[frame, frame]` is one offset of
the clocks; its ridge shows lost frames and other frame rates.

Where the rotation is not known, it is searched for with the time left open: candidates are bodies
of alike shape at any two times, and a rotation scores by the best diagonal in each block of time.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mocap_calib.config import CLOCK_RATES, AdjustConfig, PairwiseConfig
from mocap_calib.geometry.rotation import nearest_rotation, skew
from mocap_calib.kernels import clocks as kernels
from mocap_calib.kernels.jit import contiguous
from mocap_calib.pairs.solve import CELLS, well_separated
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.results import LiftedPoses, Matches
from mocap_calib.rig import gather_tracks
from mocap_calib.types import Bools, CameraRig, Floats, Ints, Recording

Singles = NDArray[np.float32]
Pair = tuple[int, int]

LEAST_FRAMES = PairwiseConfig.least_frames  # that both views see: fewer agree by chance
POSE_TOLERANCE = PairwiseConfig.pose_tolerance
_AXES = 10  # of the bodies' joints that are compared: bodies differ in few ways
BLOCK_FRAMES = 30  # of a block of time, which has an offset of its own in the search


@dataclass(frozen=True)
class ViewInTime:
    """The bodies of one view in stretches of consecutive frames.

    body: `[stretch, frame, instance, axis, 3]` unit bodies, reduced to the main axes of their
        joints; 0 where there is none.
    seen: `[stretch, frame, instance]` where there is one.
    """

    body: Singles
    seen: Bools


@dataclass(frozen=True)
class Agreements:
    """The agreement of the pairs of so many views in any two frames.

    measured: (a, b) -> `[stretch, frame of a, frame of b]`, NaN where nothing is known.
    window: frames by which a camera may be early or late.
    """

    views: int
    measured: Mapping[Pair, Singles]
    window: int

    @cached_property
    def values(self) -> Mapping[Pair, Singles]:
        """Agreement in standard deviations from its median, 0 = not known; in both orders."""
        forth = {pair: _standardise(each) for pair, each in self.measured.items()}
        return forth | {(b, a): each.swapaxes(1, 2) for (a, b), each in forth.items()}

    @property
    def shape(self) -> tuple[int, int]:
        """Number of stretches, and of the frames of each."""
        stretches, frames, _ = next(iter(self.measured.values())).shape
        return stretches, frames

    def partners(self, view: int) -> list[int]:
        """Return the views that this one is compared with."""
        return sorted(a + b - view for a, b in self.measured if view in (a, b))


def _standardise(values: Singles) -> Singles:
    """Return agreement in standard deviations from its median, 0 = not known."""
    known = values[np.isfinite(values)]
    if not len(known):
        return np.zeros_like(values)
    scaled = (values - np.median(known)) / max(float(known.std()), 1e-3)
    return np.where(np.isfinite(values), scaled, np.float32(0.0))


def views_in_time(lifted: LiftedPoses, stretches: Ints) -> list[ViewInTime]:
    """Return the bodies of each view in stretches of consecutive frames.

    lifted: the bodies of all frames of the stretches, one stretch after the other.
    stretches: `[stretch, frame]` indices of the frames, -1 = not in the recording.
    """
    seen: Bools = np.asarray(np.isfinite(lifted.body).all((-2, -1)))
    body = np.where(seen[..., None, None], lifted.body, 0.0)
    covariance = np.einsum("vfijx,vfikx->jk", body, body, optimize=True)
    axes = np.linalg.eigh(covariance)[1][:, -_AXES:]
    compact = np.einsum("vfijx,jk->vfikx", body, axes, optimize=True) / np.sqrt(len(axes))
    missing: Bools = np.asarray(stretches < 0)
    row = np.cumsum(~missing).reshape(stretches.shape) - 1
    row = np.where(missing, 0, row)
    first = np.argsort(~seen, axis=2, kind="stable")
    seen_first: Bools = np.take_along_axis(seen, first, 2)
    compact = np.take_along_axis(compact, first[..., None, None], 2).astype(np.float32)
    return [
        _view_in_time(of_view[row], seen_by[row] & ~missing[..., None])
        for of_view, seen_by in zip(compact, seen_first, strict=True)
    ]


def _view_in_time(body: Singles, seen: Bools) -> ViewInTime:
    """Return the view with as many instances as 95 % of its frames have, the first ones."""
    several = seen.sum(-1)[seen.any(-1)]
    count = max(1, int(np.quantile(several, 0.95))) if len(several) else 1
    body = np.where(seen[..., None, None], body, np.float32(0.0))
    return ViewInTime(body[:, :, :count], seen[:, :, :count])


def compared_pairs(views: int) -> list[Pair]:
    """Return the pairs of so many views that are compared, in order.

    Up to seven views, all. Of more, each is compared with two on either side in a ring and with
    that across, so that the work grows as their number.
    """
    distances = np.unique([1, 2, views // 2])
    first = np.repeat(np.arange(views), len(distances))
    second = (first + np.tile(distances, views)) % views
    pairs = np.unique(np.sort(np.stack([first, second], 1), axis=1), axis=0).tolist()
    return [(a, b) for a, b in pairs if a < b]


def agreement(a: ViewInTime, b: ViewInTime, rotation: Floats) -> Singles:
    """Return the agreement `[stretch, frame of a, frame of b]` under the rotation b_from_a.

    0..1, NaN where a view sees no body.
    """
    return _agreement(a, b, rotation[None], np.arange(a.seen.shape[1]))[0]


def search_rotation(a: ViewInTime, b: ViewInTime, window: int, rng: np.random.Generator) -> Floats:
    """Return the rotation b_from_a `[3, 3]` under which two views agree best, at whatever times.

    window: frames by which the clock of b may be early or late.
    """
    rotation = _candidates(a, b, rng)
    rows = _some_frames(a, bodies=60)
    best = _score_at_any_time(a, b, rotation, rows, window).max(1)
    distinct = well_separated(
        rotation,
        best,
        count=PairwiseConfig.hypotheses_refined,
        separation_deg=PairwiseConfig.separation_deg,
    )
    refined = rotation[distinct]
    rows = _some_frames(a, bodies=200)
    for _ in range(3):
        rates = _score_at_any_time(a, b, refined, rows, window).argmax(1)
        refined = np.stack(
            [
                _align(a, b, each, rate=CLOCK_RATES[rate], rows=rows, window=window)
                for each, rate in zip(refined, rates, strict=True)
            ]
        )
    return refined[_score_at_any_time(a, b, refined, rows, window).max(1).argmax()]


def _agreement(a: ViewInTime, b: ViewInTime, rotation: Floats, rows: Ints) -> Singles:
    """Return how well the bodies of two frames match, `[hypothesis, stretch, row, frame]`.

    Each body counts with the other view's most alike; NaN where a view sees no body. The instances
    of a frame are few: those of a are taken one by one, which keeps the arrays small.

    rotation: `[hypothesis, 3, 3]` b_from_a. rows: `[row]` frames of a.
    """
    seen_a = a.seen[:, rows]
    turned = _turn(a.body[:, rows], rotation)
    other = np.moveaxis(_flatten(b.body), (2, 1), (0, 3))[:, None]  # absent bodies are like none
    other = np.ascontiguousarray(other)  # [instance, 1, stretch, number, frame]
    best_of_b: Singles = turned[:, :, 0] @ other  # [instance of b, hypothesis, stretch, row, frame]
    total = _likeness(best_of_b.max(0))
    for i in range(1, turned.shape[2]):
        cosine = turned[:, :, i] @ other
        total += _likeness(cosine.max(0))
        np.maximum(best_of_b, cosine, out=best_of_b)
    if len(best_of_b) == turned.shape[2] == 1:
        total *= np.float32(2.0)
    else:
        for best in best_of_b:
            total += _likeness(best)
    count_a, count_b = seen_a.sum(-1)[..., None], b.seen.sum(-1)[:, None]
    total /= np.maximum(count_a + count_b, 1).astype(np.float32)
    return np.where((count_a > 0) & (count_b > 0), total, np.float32(np.nan))


def _turn(body: Singles, rotation: Floats) -> Singles:
    """Return bodies `[stretch, row, instance, axis, 3]` turned by rotations, ready to be compared.

    `[hypothesis, stretch, instance, row, 3 axis]`.
    """
    turned = body.reshape(1, -1, 3) @ rotation.astype(np.float32).swapaxes(1, 2)
    return np.moveaxis(_flatten(turned.reshape(len(rotation), *body.shape)), 3, 2)


def _flatten(body: Singles) -> Singles:
    """Return bodies `[..., axis, 3]` as vectors `[..., 3 axis]`."""
    return body.reshape(*body.shape[:-2], -1)


def _likeness(cosine: Singles) -> Singles:
    """Return the likeness 0..1 of two bodies, given tr(R' b a') / J; 0 where one is absent."""
    found = (cosine - np.float32(1.0)) / np.float32(POSE_TOLERANCE**2)
    return np.exp(found, out=found)


def _some_frames(view: ViewInTime, bodies: int) -> Ints:
    """Return frames (indices within the stretches), evenly spread, with so many bodies in all."""
    per_frame = max(view.seen.sum() / view.seen.shape[1], 1.0)
    return evenly_spaced(np.arange(view.seen.shape[1]), max(int(bodies / per_frame), 8))


def _candidates(a: ViewInTime, b: ViewInTime, rng: np.random.Generator) -> Floats:
    """Return rotations b_from_a `[candidate, 3, 3]` of pairs of bodies of alike shape.

    60 bodies of a, each with the two most alike of 400 of b.
    """
    of_a, of_b = a.body[a.seen], b.body[b.seen]
    some_a = of_a[rng.permutation(len(of_a))[:60]].astype(np.float64)
    some_b = of_b[rng.permutation(len(of_b))[:400]].astype(np.float64)
    # shapes are compared by their Gram matrices, which no rotation changes
    gram_a = (some_a @ some_a.swapaxes(1, 2)).reshape(len(some_a), -1)
    gram_b = (some_b @ some_b.swapaxes(1, 2)).reshape(len(some_b), -1)
    apart = (gram_b**2).sum(1) - 2 * gram_a @ gram_b.T
    nearest = np.argsort(apart, axis=1, kind="stable")[:, :2]
    covariance = some_b[nearest].swapaxes(2, 3) @ some_a[:, None]
    return nearest_rotation(covariance.reshape(-1, 3, 3))


def _score_at_any_time(
    a: ViewInTime, b: ViewInTime, rotation: Floats, rows: Ints, window: int
) -> Floats:
    """Return the mean agreement `[hypothesis, rate]` of blocks of time, each at its best offset."""
    each = max(1, CELLS // max(len(rows) * b.seen.size, 1))
    scores = []
    for start in range(0, len(rotation), each):
        values = _agreement(a, b, rotation[start : start + each], rows)
        by_rate = [_best_in_blocks(values, rate, rows, window)[0] for rate in CLOCK_RATES]
        scores.append(np.stack(by_rate, 1))
    return np.concatenate(scores)


def _best_in_blocks(values: Singles, rate: float, rows: Ints, window: int) -> tuple[Floats, Ints]:
    """Return the mean over the blocks of the best diagonal, and these diagonals.

    `[hypothesis]` and `[hypothesis, stretch, block]` index of the offset, -1 where nothing is seen.

    values: `[hypothesis, stretch, row, frame]`, rows: `[row]` frames of a.
    """
    blocks = max(1, values.shape[-1] // BLOCK_FRAMES)
    each = len(rows) // blocks
    shape = (*values.shape[:2], blocks, 2 * window + 1)
    total, known = np.zeros(shape, np.float32), np.zeros(shape, np.int64)
    first = np.round(rows * rate).astype(np.int64) - window
    kernels.sum_on_diagonals(*contiguous(values, first), each, total, known)
    mean = np.where(known >= 0.6 * each, total / np.maximum(known, 1), -1.0)
    best = mean.max(-1)
    used = best >= 0
    score = np.where(used, best, 0.0).sum((1, 2)) / np.maximum(used.sum((1, 2)), 1)
    # one block that agrees by chance is no evidence
    score = score * np.minimum(1.0, used.sum((1, 2)) / max(0.5 * blocks, 1.0))
    return score, np.where(used, mean.argmax(-1), -1)


def _align(
    a: ViewInTime, b: ViewInTime, rotation: Floats, *, rate: float, rows: Ints, window: int
) -> Floats:
    """Return the rotation that aligns the bodies best that match at the best offset of each block.

    rows: `[row]` frames of a.
    """
    values = _agreement(a, b, rotation[None], rows)
    _, offsets = _best_in_blocks(values, rate, rows, window)
    blocks = offsets.shape[-1]
    block = np.minimum(np.arange(len(rows)) // max(len(rows) // blocks, 1), blocks - 1)
    offset = offsets[0][:, block]
    column = np.round(rows * rate).astype(np.int64) + offset - window
    column = np.where(offset >= 0, column, -1)
    return align_at(a, b, rotation, np.broadcast_to(rows, column.shape), column)


def align_at(
    a: ViewInTime, b: ViewInTime, rotation: Floats, frame_a: Ints, frame_b: Ints
) -> Floats:
    """Return the rotation b_from_a that aligns the mutually most alike bodies of pairs of frames.

    rotation: `[3, 3]` under which bodies are matched; it is returned where none are.
    frame_a, frame_b: `[stretch, pair]` frames of the two views, -1 = none.
    """
    inside = (frame_a >= 0) & (frame_b >= 0) & (frame_b < b.seen.shape[1])
    stretch, pair = np.nonzero(inside)
    if not len(pair):
        return rotation
    of_a, of_b = (stretch, frame_a[stretch, pair]), (stretch, frame_b[stretch, pair])
    body_a, body_b = a.body[of_a], b.body[of_b]  # [match, instance, axis, 3]
    both = a.seen[of_a][:, :, None] & b.seen[of_b][:, None]
    turned = _flatten(body_a @ rotation.T.astype(np.float32))
    cosine = np.where(both, turned @ _flatten(body_b).swapaxes(1, 2), np.float32(-1.0))
    mutual = (cosine >= cosine.max(2, keepdims=True)) & (cosine >= cosine.max(1, keepdims=True))
    frame, i, j = np.nonzero(mutual & both)
    if not len(frame):
        return rotation
    weighted = _likeness(cosine[frame, i, j])[:, None, None] * body_b[frame, j]
    covariance = weighted.reshape(-1, 3).T @ body_a[frame, i].reshape(-1, 3)
    return nearest_rotation(covariance.astype(np.float64))


# Rays of a rig


def agreement_of_rays(
    recording: Recording, rig: CameraRig, matches: Matches, stretches: Ints, window: int
) -> dict[Pair, Singles]:
    """Return how nearly the rays of pairs of views meet in any two frames up to a window apart.

    The mean log likelihood of the keypoints; pairs that share none are left out. How nearly rays of
    two cameras meet at other offsets of the clocks shows whole frames, as far as bodies move.

    matches: labels in all frames. stretches: `[stretch, frame]` indices, -1 = no frame.
    """
    rays = _rays(recording, matches, stretches)
    planes = {
        (a, b): _epipolar_planes(rays[a], rays[b], *rig.relative(a, b))
        for a, b in compared_pairs(len(rig))
    }
    angles = {pair: _synchronous_angles(*each) for pair, each in planes.items()}
    known = [pair for pair, each in angles.items() if len(each)]
    usual = float(np.median([np.median(angles[pair]) for pair in known] or 1.0))
    scale = AdjustConfig.loss_scales[-1] * usual
    time = np.arange(stretches.shape[1])[:, None]
    column = time + np.arange(-window, window + 1)
    row, offset = np.nonzero((column >= 0) & (column < len(time)))
    values = {}
    for pair in known:
        table = np.empty((*stretches.shape, 2 * window + 1))
        kernels.mean_epipolar_likelihood(*contiguous(*planes[pair]), scale, table)
        whole = np.full((len(table), len(time), len(time)), np.nan, np.float32)
        whole[:, row, column[row, offset]] = table[:, row, offset]
        values[pair] = whole
    return values


def _rays(recording: Recording, matches: Matches, stretches: Ints) -> Floats:
    """Return the unit rays `[view, stretch, frame, point, 3]` of all labelled keypoints."""
    frames = np.unique(stretches[stretches >= 0])
    rays = gather_tracks(recording, matches, frames).rays
    rays = np.moveaxis(rays.reshape(len(rays), 3, len(frames), -1), 1, -1)
    place = np.searchsorted(frames, np.maximum(stretches, frames[0]))
    return np.where((stretches >= 0)[..., None, None], rays[:, place], np.nan)


def _epipolar_planes(
    a: Floats, b: Floats, rotation: Floats, translation: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the normals of the epipolar planes of rays of a, rays of b, and squares of both.

    Two rays miss each other by the angle normal . ray / sqrt(square of a + square of b).

    a, b: `[stretch, frame, point, 3]` rays. rotation, translation: of b_from_a.
    """
    essential = skew(translation) @ rotation
    normal = a @ essential.T
    return normal, b, (normal**2).sum(-1), ((b @ essential) ** 2).sum(-1)


def _synchronous_angles(normal: Floats, ray: Floats, square_a: Floats, square_b: Floats) -> Floats:
    """Return the angles `[N]` by which rays of equal frame numbers miss each other."""
    angle = np.abs((normal * ray).sum(-1)) / np.sqrt(square_a + square_b)
    return angle[np.isfinite(angle)]
