"""Two views -> their relative pose and who is who.

Every candidate match of two lifted bodies proposes a rotation in closed form, and five-point RANSAC proposes more where
identities are known; all are scored against all frames at once, the best modes are refined by turns of matching
(Sinkhorn) and robust least squares on rays, and the one with the best evidence is kept. One yardstick for all.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from itertools import combinations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_calib.assignment import mutual_best, sinkhorn
from mocap_calib.config import PairwiseConfig
from mocap_calib.evidence import ViewPair, agreement, epipolar_error, epipolar_fit, match_affinity, pose_variance, reach, steering_error, view_pair
from mocap_calib.frames import evenly
from mocap_calib.geometry.epipolar import depths, five_point
from mocap_calib.geometry.rotation import nearest_rotation
from mocap_calib.parallel import in_order
from mocap_calib.posterior import most_probable
from mocap_calib.two_view import refine_two_view
from mocap_calib.types import Bools, Floats, Ints, LiftedPoses, PairwiseCalibration, Progress, Sample

_TRACKS = 9  # pairs of tracks that are looked at
_CELLS = 2_000_000  # hypotheses x possible matches scored at a time


@dataclass(frozen=True)
class Modes:
    """Rival relative poses of one pair. rotation: `[M, 3, 3]`, translation: `[M, 3]` in body sizes, source: `[M]`."""

    rotation: Floats
    translation: Floats
    source: tuple[str, ...]

    def __getitem__(self, index: Ints) -> "Modes":
        return Modes(self.rotation[index], self.translation[index], tuple(self.source[k] for k in index))


@dataclass(frozen=True)
class Score:
    """Evidence for each mode. matched: `[M, frame, I, J]`; the rest `[M]`, in 0..1 but the residual (radians)."""

    matched: Bools
    total: Floats
    explained: Floats
    in_front: Floats
    residual: Floats


def calibrate_pairs(
    recording: Sample, lifted: LiftedPoses, config: PairwiseConfig, *, rng: np.random.Generator, progress: Progress
) -> tuple[PairwiseCalibration, ...]:
    """Calibrates all pairs of views that see something in the same frames; the others are left out."""
    pairs = list(combinations(range(len(recording.cameras)), 2))
    seeds = rng.spawn(len(pairs))
    config = replace(config, frames=min(config.frames, max(config.least_frames, config.all_frames // max(len(pairs), 1))))

    def work(number: int) -> PairwiseCalibration | None:
        return calibrate_pair(recording, lifted, *pairs[number], config, seeds[number])

    found = []
    for done, result in enumerate(in_order(work, range(len(pairs)))):
        found += [] if result is None else [result]
        progress("pairwise", done + 1, len(pairs))
    return tuple(found)


def in_recording(pairs: tuple[PairwiseCalibration, ...], chosen: Ints) -> tuple[PairwiseCalibration, ...]:
    """Pairs found in a sample, their matches by the frames of the recording that it was chosen from."""
    return tuple(replace(p, matches=np.column_stack([chosen[p.matches[:, 0]], p.matches[:, 1:]])) for p in pairs)


def calibrate_pair(recording: Sample, lifted: LiftedPoses, a: int, b: int, config: PairwiseConfig, rng: np.random.Generator) -> PairwiseCalibration | None:
    """The best supported relative pose of views a and b, or None where they share nothing to go by."""
    frames = _shared_frames(recording, a, b)
    if len(frames) == 0:
        return None
    chosen = evenly(frames, min(config.frames, max(20, config.candidates // recording.positions.shape[2] ** 2)))
    pair = view_pair(recording, lifted, a, b, chosen)
    modes = _proposals(pair, bool(recording.tracked[a] and recording.tracked[b]), config, rng)
    if len(modes.rotation) == 0:
        return None
    modes, score = _weigh_all(pair, *_refine_modes(pair, modes, config, rng), config, rng)
    best = int(np.argmax(score.total))
    rotation, translation = modes.rotation[best], _with_baseline(pair, modes, score, best)
    frame, i, j = np.nonzero(score.matched[best])
    return PairwiseCalibration(
        a, b, rotation, translation, np.stack([chosen[frame], i, j], 1), len(frames),
        float(score.total[best]), float(score.residual[best]), float(score.in_front[best]), modes.source[best],
    )  # fmt: skip


def _shared_frames(recording: Sample, a: int, b: int) -> Ints:
    """Frames in which both views show a body with enough joints."""
    return np.flatnonzero((recording.seen[[a, b]].sum(-1) >= 4).any(-1).all(0))


def _proposals(pair: ViewPair, tracked: bool, config: PairwiseConfig, rng: np.random.Generator) -> Modes:
    """Modes of the search over lifted poses, and of five-point RANSAC where it is known who is who."""
    modes = _search(pair, config, rng)
    for frame, i, j in _known_identities(pair, tracked):
        modes = _join(modes, _from_five_points(pair, frame, i, j, rng))
    return modes


def _known_identities(pair: ViewPair, tracked: bool) -> list[tuple[Ints, Ints, Ints]]:
    """Sets of matches (frame, i, j) that hold one individual a view: the frames with one subject, or each pair of tracks."""
    there_a, there_b = (pair.weight_a > 0).sum(-1) > 0, (pair.weight_b > 0).sum(-1) > 0
    if tracked:
        tracks = product(range(there_a.shape[1]), range(there_b.shape[1]))
        sets = [(np.flatnonzero(there_a[:, i] & there_b[:, j]), i, j) for i, j in tracks]
        return [(f, np.full(len(f), i), np.full(len(f), j)) for f, i, j in sets if len(f)][:_TRACKS]
    single = np.flatnonzero((there_a.sum(1) == 1) & (there_b.sum(1) == 1))
    if 2 * len(single) < len(pair.frames):
        return []
    return [(single, there_a[single].argmax(1), there_b[single].argmax(1))]


def _search(pair: ViewPair, config: PairwiseConfig, rng: np.random.Generator) -> Modes:
    """Closed-form rotations of candidate matches, scored against all frames; the best well-separated modes.

    Half of the hypotheses are the candidates whose bodies agree best, half are drawn at random.
    """
    frame, i, j = np.nonzero(pair.lifted)
    if len(frame) == 0:
        return Modes(np.zeros((0, 3, 3)), np.zeros((0, 3)), ())
    rotation = nearest_rotation(np.swapaxes(pair.cross[frame, i, j], -1, -2))
    own = pair.norm[frame, i, j] - 2 * np.einsum("nij,nji->n", rotation, pair.cross[frame, i, j])
    half = config.hypotheses // 2
    order = np.argsort(own, kind="stable")
    index = np.concatenate([order[:half], rng.permutation(order[half:])[:half]])
    rotation = rotation[index]
    translation = pair.place_b[frame, j][index] - np.einsum("nij,nj->ni", rotation, pair.place_a[frame, i][index])
    # in blocks: a single crowded frame multiplies the matches that each hypothesis is scored on
    block = max(1, _CELLS // pair.lifted.size)
    parts = [slice(k, k + block) for k in range(0, len(rotation), block)]
    support = np.concatenate([_support(agreement(pair, rotation[p], translation[p], config)) for p in parts])
    keep = _separated(rotation, support, config.modes, np.deg2rad(config.mode_separation_deg))
    modes = Modes(rotation[keep], translation[keep], ("lifted",) * len(keep))
    for _ in range(config.rounds):
        modes = _procrustes(pair, modes, config)
    return modes[_separated(modes.rotation, _support(agreement(pair, modes.rotation, modes.translation, config)), config.modes, np.deg2rad(2.0))]


def _support(agree: Floats) -> Floats:
    """`[M]` sum over all detections of their best agreement, both ways."""
    return agree.max(-1).sum((-1, -2)) + agree.max(-2).sum((-1, -2))


def _separated(rotation: Floats, support: Floats, count: int, gap: float) -> Ints:
    """Indices of the best supported rotations that are at least `gap` radians apart."""
    order = np.argsort(-support, kind="stable")
    flat = rotation[order].reshape(-1, 9)
    far = flat @ flat.T <= 1 + 2 * np.cos(gap)  # the trace of one turned back by the other
    keep: list[int] = []
    for k in range(len(order)):
        if len(keep) < count and far[k, keep].all():
            keep.append(k)
    return order[keep]


def _procrustes(pair: ViewPair, modes: Modes, config: PairwiseConfig) -> Modes:
    """One turn of matching and of weighted Procrustes on the matched bodies, all modes at once."""
    agree = agreement(pair, modes.rotation, modes.translation, config)
    weight = agree * mutual_best(sinkhorn(agree, dummy=0.1), least=0.05)
    rotation = nearest_rotation(np.einsum("mfab,fabij->mji", weight, pair.cross, optimize=True) + 1e-9 * modes.rotation)
    gap = pair.place_b[None, :, None] - np.einsum("mij,faj->mfai", rotation, pair.place_a)[:, :, :, None]
    near = weight / (pair.distance_a[:, :, None] ** 2 + pair.distance_b[:, None] ** 2)
    total = near.sum((1, 2, 3))[:, None]
    mean = (near[..., None] * gap).sum((1, 2, 3)) / np.maximum(total, 1e-12)
    return replace(modes, rotation=rotation, translation=np.where(total > 0, mean, modes.translation))


def _from_five_points(pair: ViewPair, frame: Ints, i: Ints, j: Ints, rng: np.random.Generator) -> Modes:
    """Five-point RANSAC (Nister 2004) on subsets of matches that are known to be right."""
    rotations, translations = [], []
    for _ in range(3):
        part = np.sort(rng.permutation(len(frame))[:40])
        f, m, n = frame[part], i[part], j[part]
        both = (pair.weight_a[f, m] > 0) & (pair.weight_b[f, n] > 0)
        threshold = 0.05 / float(np.median(reach(pair)[f, m, n]))
        for rotation, translation in five_point(pair.rays_a[f, m][both], pair.rays_b[f, n][both], threshold):
            rotations.append(rotation)
            translations.append(translation)
    return Modes(np.reshape(rotations, (-1, 3, 3)), np.reshape(translations, (-1, 3)), ("five-point",) * len(rotations))


def _join(first: Modes, second: Modes) -> Modes:
    return Modes(np.concatenate([first.rotation, second.rotation]), np.concatenate([first.translation, second.translation]), first.source + second.source)


def _refine_modes(pair: ViewPair, modes: Modes, config: PairwiseConfig, rng: np.random.Generator) -> tuple[Modes, Score]:
    """Turns of matching and robust refinement; a mode keeps its last state that its own evidence did not contradict."""
    score = _score(pair, modes, config)
    for turn in range(config.rounds):
        refined = _on_rays(pair, modes, score.matched, config, rng)
        modes, score = _better(pair, refined, modes, score, config)
        if turn == 0:
            keep = _separated(modes.rotation, score.total, config.finalists, np.deg2rad(2.0))
            modes, score = modes[keep], _take(score, keep)
    return modes, score


def _weigh_all(pair: ViewPair, modes: Modes, score: Score, config: PairwiseConfig, rng: np.random.Generator) -> tuple[Modes, Score]:
    """The modes where rays and lifted bodies together put them."""
    rotation, translation = modes.rotation.copy(), modes.translation.copy()
    for m, matched in enumerate(score.matched):
        rays = _matched_rays(pair, matched)
        pick = rng.permutation(len(rays[0]))[: config.points]
        rotation[m], translation[m] = most_probable(pair, rotation[m], translation[m], matched, [part[pick] for part in rays], config)
    return _better(pair, replace(modes, rotation=rotation, translation=translation), modes, score, config)


def _better(pair: ViewPair, after: Modes, before: Modes, score: Score, config: PairwiseConfig) -> tuple[Modes, Score]:
    """Each mode as it is after a step, or as it was before where the step lowers its score."""
    scored = _score(pair, after, config)
    better = scored.total >= score.total
    rotation = np.where(better[:, None, None], after.rotation, before.rotation)
    translation = np.where(better[:, None], after.translation, before.translation)
    return replace(before, rotation=rotation, translation=translation), _choose(better, scored, score)


def _map(function: Callable[..., NDArray[Any]], *scores: Score) -> Score:
    """Applies a function to each field of one or more scores."""
    return Score(*(function(*(getattr(score, field.name) for score in scores)) for field in fields(Score)))


def _take(score: Score, index: Ints) -> Score:
    return _map(lambda x: x[index], score)


def _choose(better: Bools, after: Score, before: Score) -> Score:
    def pick(x: NDArray[Any], y: NDArray[Any]) -> NDArray[Any]:
        return np.where(better.reshape(-1, *[1] * (x.ndim - 1)), x, y)

    return _map(pick, after, before)


def _score(pair: ViewPair, modes: Modes, config: PairwiseConfig) -> Score:
    """Matches each mode's detections by all the evidence, and says how much of what could be matched it explains.

    total = share of detections matched x share of joints that fit the epipolar geometry x share of joints in front of both cameras x
    agreement of the lifted bodies.
    """
    error, weight = epipolar_error(pair, modes.rotation, modes.translation)
    epipolar = epipolar_fit(error, weight, config)
    affinity = match_affinity(pair, modes.rotation, modes.translation, epipolar, config)
    matched = mutual_best(sinkhorn(affinity, dummy=0.15), least=0.1)
    ahead = _in_front(pair, modes, matched)
    count = np.maximum(matched.sum((1, 2, 3)), 1)
    possible = np.minimum((pair.weight_a > 0).any(-1).sum(-1), (pair.weight_b > 0).any(-1).sum(-1)).sum()
    explained = (matched * epipolar).sum((1, 2, 3)) / max(possible, 1)
    steered = (matched * np.exp(-0.5 * steering_error(pair, modes.rotation) / pose_variance(pair, config))).sum((1, 2, 3)) / count
    used = matched[..., None] & (weight > 0)[None]
    residual = np.array([np.median(e[u]) if u.any() else np.inf for e, u in zip(error / reach(pair)[None, ..., None], used, strict=True)])
    lifted = steered if pair.lifted.any() else 1.0
    return Score(matched, explained * ahead * lifted, explained, ahead, residual)


def _in_front(pair: ViewPair, modes: Modes, matched: Bools) -> Floats:
    """`[M]` share of the matched joints that lie in front of both cameras."""
    share = np.zeros(len(matched))
    for m, (rotation, translation) in enumerate(zip(modes.rotation, modes.translation, strict=True)):
        rays_a, rays_b, _, _ = _matched_rays(pair, matched[m])
        if len(rays_a):
            ahead_a, ahead_b = depths(rotation, translation, rays_a, rays_b)
            share[m] = ((ahead_a > 0) & (ahead_b > 0)).mean()
    return share


def _matched_rays(pair: ViewPair, matched: Bools) -> tuple[Floats, Floats, Floats, Floats]:
    """Rays `[N, 3]` of all joints of one mode's matches, their weight and their reach `[N]`."""
    frame, i, j = np.nonzero(matched)
    weight = pair.weight_a[frame, i] * pair.weight_b[frame, j]
    use = weight > 0
    far = np.broadcast_to(reach(pair)[frame, i, j][:, None], use.shape)
    return pair.rays_a[frame, i][use], pair.rays_b[frame, j][use], weight[use], far[use]


def _on_rays(pair: ViewPair, modes: Modes, matched: Bools, config: PairwiseConfig, rng: np.random.Generator) -> Modes:
    """Robust refinement of each mode on the rays of its own matches, all modes in one batch of equal size."""
    own = [_matched_rays(pair, one) for one in matched]
    count, size = len(own), min(config.points, max(len(rays[0]) for rays in own))
    rays_a, rays_b = np.zeros((count, size, 3)), np.zeros((count, size, 3))
    rays_a[..., 2] = rays_b[..., 2] = 1.0
    weight, far = np.zeros((count, size)), np.ones((count, size))
    for m, (own_a, own_b, own_weight, own_far) in enumerate(own):
        pick = rng.permutation(len(own_a))[:size]
        rays_a[m, : len(pick)], rays_b[m, : len(pick)] = own_a[pick], own_b[pick]
        weight[m, : len(pick)], far[m, : len(pick)] = own_weight[pick], own_far[pick]
    rotation, translation = refine_two_view(modes.rotation, modes.translation, rays_a, rays_b, weight, far, scale=config.inlier)
    return replace(modes, rotation=rotation, translation=translation)


def _with_baseline(pair: ViewPair, modes: Modes, score: Score, best: int) -> Floats:
    """The translation at the length that makes the triangulated bodies as far away as they were lifted."""
    frame, i, j = np.nonzero(score.matched[best])
    direction = modes.translation[best] / np.linalg.norm(modes.translation[best])
    weight = (pair.weight_a[frame, i] > 0) & (pair.weight_b[frame, j] > 0)
    if not weight.any():
        return direction
    near_a, near_b = depths(modes.rotation[best], direction, pair.rays_a[frame, i][weight], pair.rays_b[frame, j][weight])
    lifted = np.broadcast_to((pair.distance_a[frame, i] + pair.distance_b[frame, j])[:, None], weight.shape)[weight]
    total = near_a + near_b
    good = (near_a > 0) & (near_b > 0)
    return direction * float(np.median(lifted[good] / total[good])) if good.any() else direction
