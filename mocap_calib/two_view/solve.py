"""Two views -> their relative pose and who is who.

Every candidate match of two lifted bodies proposes a rotation in closed form, and five-point RANSAC proposes more where
identities are known; all are scored against all frames at once, the best modes are refined by turns of matching
(Sinkhorn) and robust least squares on rays. One yardstick for all: the one with the best evidence is the answer, the others its
rivals, which a third view may speak for.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_calib.compute.parallel import in_order, in_processes
from mocap_calib.config import PairwiseConfig
from mocap_calib.geometry.epipolar import depths
from mocap_calib.recording.sampling import evenly
from mocap_calib.two_view.affinity import (
    epipolar_error,
    epipolar_fit,
    match_affinity,
    steering_error,
    steering_variance,
)
from mocap_calib.two_view.assignment import mutual_best, sinkhorn
from mocap_calib.two_view.hypotheses import Hypotheses, generate_hypotheses, separated
from mocap_calib.two_view.posterior import most_probable
from mocap_calib.two_view.refine import refine_two_view
from mocap_calib.two_view.view_pair import ViewPair, distance_ratios, reach, view_pair
from mocap_calib.types import (
    Bools,
    Floats,
    Ints,
    LiftedPoses,
    Mapper,
    PairwiseCalibration,
    Progress,
    Recording,
    Sample,
)

_WORTH_A_THREAD = 50_000  # possible matches of joints in a pair,
_WORTH_PROCESSES = 800_000  # and in all of them: two seconds of work, where starting a process costs a third of one


@dataclass(frozen=True)
class Score:
    """Evidence for each mode. matched: `[M, frame, I, J]`; the rest `[M]`, in 0..1 but the residual (radians)."""

    matched: Bools
    total: Floats
    explained: Floats
    in_front: Floats
    residual: Floats


@dataclass(frozen=True)
class PairProblem:
    """All that is needed to calibrate the views a and b, and no more: it may travel to another machine.

    pair: their detections in the frames looked at; frames: how many they share; tracked: both know who is who; rng: of this pair alone, so
    that the order in which pairs are calibrated does not matter. It is consumed.
    """

    a: int
    b: int
    pair: ViewPair
    frames: int
    tracked: bool
    rng: np.random.Generator


PairSolver = Callable[[PairProblem], PairwiseCalibration | None]


def calibrate_pairs(
    recording: Sample,
    lifted: LiftedPoses,
    config: PairwiseConfig,
    *,
    rng: np.random.Generator,
    progress: Progress,
    mapper: Mapper | None = None,
    solve: PairSolver | None = None,
) -> tuple[PairwiseCalibration, ...]:
    """Calibrates all pairs of views that see something in the same frames; the others are left out.

    `mapper` may do so elsewhere; `solve` calibrates one, by default `calibrate_pair`.
    """
    pairs = list(combinations(range(len(recording.cameras)), 2))
    mapper = mapper or pair_mapper(recording, config)
    config = replace(config, frames=_frames_each(len(pairs), config))
    problems = (
        pair_problem(recording, lifted, a, b, config, own)
        for (a, b), own in zip(pairs, rng.spawn(len(pairs)), strict=True)
    )
    found = []
    for done, result in enumerate(
        mapper(solve or partial(calibrate_pair, config=config), problems)
    ):
        found += [] if result is None else [result]
        progress("pairwise", done + 1, len(pairs))
    return tuple(sorted(found, key=lambda each: (each.a, each.b)))


def pair_mapper(recording: Recording, config: PairwiseConfig) -> Mapper:
    """Threads where a pair keeps one busy; on small arrays they wait for the interpreter: processes where there are many pairs, else neither."""
    views, frames, instances, keypoints = recording.positions.shape[:4]
    pairs = views * (views - 1) // 2
    work = min(frames, _frames_each(pairs, config)) * instances**2 * keypoints
    if work >= _WORTH_A_THREAD:
        return in_order
    return in_processes if pairs * work >= _WORTH_PROCESSES else map


def _frames_each(pairs: int, config: PairwiseConfig) -> int:
    """How many frames of a pair are looked at, where there are so many pairs."""
    return min(config.frames, max(config.least_frames, config.all_frames // max(pairs, 1)))


def in_recording(
    pairs: tuple[PairwiseCalibration, ...], chosen: Ints
) -> tuple[PairwiseCalibration, ...]:
    """Pairs found in a sample, their matches by the frames of the recording that it was chosen from."""
    return tuple(
        replace(
            p,
            matches=np.column_stack([chosen[p.matches[:, 0]], p.matches[:, 1:]]),
            alternatives=in_recording(p.alternatives, chosen),
        )
        for p in pairs
    )


def pair_problem(
    recording: Sample,
    lifted: LiftedPoses,
    a: int,
    b: int,
    config: PairwiseConfig,
    rng: np.random.Generator,
) -> PairProblem:
    """Gathers what the views a and b show in an even sample of the frames they share."""
    frames = _shared_frames(recording, a, b)
    chosen = evenly(
        frames, min(config.frames, max(20, config.candidates // recording.positions.shape[2] ** 2))
    )
    tracked = bool(recording.tracked[a] and recording.tracked[b])
    return PairProblem(a, b, view_pair(recording, lifted, a, b, chosen), len(frames), tracked, rng)


def calibrate_pair(problem: PairProblem, config: PairwiseConfig) -> PairwiseCalibration | None:
    """The best supported relative pose of the two views, with its rivals, or None where they share nothing to go by."""
    pair, rng = problem.pair, problem.rng
    if problem.frames == 0:
        return None
    modes = generate_hypotheses(pair, problem.tracked, config, rng)
    if len(modes.rotation) == 0:
        return None
    modes, score = _weigh_all(pair, *_refine_modes(pair, modes, config, rng), config, rng)
    apart = separated(
        modes.rotation, score.total, config.finalists, np.deg2rad(config.mode_separation_deg)
    )
    best, *alternatives = (_mode(problem, modes, score, int(k)) for k in apart)
    return replace(best, alternatives=tuple(alternatives))


def judge_pair(
    problem: PairProblem,
    rotation: Floats,
    translation: Floats,
    matched: Bools,
    source: str,
    config: PairwiseConfig,
) -> PairwiseCalibration:
    """A relative pose and matches `[frame, I, J]` that were found in another way, with a baseline in body sizes and judged by the same yardstick."""
    translation = _with_baseline(problem.pair, rotation, translation, matched)
    score = _score(problem.pair, Hypotheses(rotation[None], translation[None], (source,)), config)
    return _calibration(problem, rotation, translation, matched, score, source)


def _mode(problem: PairProblem, modes: Hypotheses, score: Score, k: int) -> PairwiseCalibration:
    """One of the modes, with a baseline in body sizes."""
    rotation, matched = modes.rotation[k], score.matched[k]
    translation = _with_baseline(problem.pair, rotation, modes.translation[k], matched)
    return _calibration(
        problem, rotation, translation, matched, _take(score, np.array([k])), modes.source[k]
    )


def _calibration(
    problem: PairProblem,
    rotation: Floats,
    translation: Floats,
    matched: Bools,
    score: Score,
    source: str,
) -> PairwiseCalibration:
    """The record of one mode, the only one of `score`."""
    frame, i, j = np.nonzero(matched)
    return PairwiseCalibration(
        problem.a,
        problem.b,
        rotation,
        translation,
        np.stack([problem.pair.frames[frame], i, j], 1),
        problem.frames,
        float(score.total[0]),
        float(score.residual[0]),
        float(score.in_front[0]),
        source,
    )


def _shared_frames(recording: Sample, a: int, b: int) -> Ints:
    """Frames in which both views show a body with enough joints."""
    return np.flatnonzero((recording.seen[[a, b]].sum(-1) >= 4).any(-1).all(0))


def _refine_modes(
    pair: ViewPair, modes: Hypotheses, config: PairwiseConfig, rng: np.random.Generator
) -> tuple[Hypotheses, Score]:
    """Turns of matching and robust refinement; a mode keeps its last state that its own evidence did not contradict."""
    score = _score(pair, modes, config)
    for turn in range(config.rounds):
        refined = _on_rays(pair, modes, score.matched, config, rng)
        modes, score = _better(pair, refined, modes, score, config)
        if turn == 0:
            keep = separated(modes.rotation, score.total, config.finalists, np.deg2rad(2.0))
            modes, score = modes[keep], _take(score, keep)
    return modes, score


def _weigh_all(
    pair: ViewPair,
    modes: Hypotheses,
    score: Score,
    config: PairwiseConfig,
    rng: np.random.Generator,
) -> tuple[Hypotheses, Score]:
    """The modes where rays and lifted bodies together put them."""
    rotation, translation = modes.rotation.copy(), modes.translation.copy()
    for m, matched in enumerate(score.matched):
        rays = _matched_rays(pair, matched)
        pick = rng.permutation(len(rays[0]))[: config.points]
        rotation[m], translation[m] = most_probable(
            pair, rotation[m], translation[m], matched, [part[pick] for part in rays], config
        )
    return _better(
        pair, replace(modes, rotation=rotation, translation=translation), modes, score, config
    )


def _better(
    pair: ViewPair, after: Hypotheses, before: Hypotheses, score: Score, config: PairwiseConfig
) -> tuple[Hypotheses, Score]:
    """Each mode as it is after a step, or as it was before where the step lowers its score."""
    scored = _score(pair, after, config)
    better = scored.total >= score.total
    rotation = np.where(better[:, None, None], after.rotation, before.rotation)
    translation = np.where(better[:, None], after.translation, before.translation)
    return replace(before, rotation=rotation, translation=translation), _choose(
        better, scored, score
    )


def _map(function: Callable[..., NDArray[Any]], *scores: Score) -> Score:
    """Applies a function to each field of one or more scores."""
    return Score(
        *(function(*(getattr(score, field.name) for score in scores)) for field in fields(Score))
    )


def _take(score: Score, index: Ints) -> Score:
    return _map(lambda x: x[index], score)


def _choose(better: Bools, after: Score, before: Score) -> Score:
    def pick(x: NDArray[Any], y: NDArray[Any]) -> NDArray[Any]:
        return np.where(better.reshape(-1, *[1] * (x.ndim - 1)), x, y)

    return _map(pick, after, before)


def _score(pair: ViewPair, modes: Hypotheses, config: PairwiseConfig) -> Score:
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
    possible = np.minimum(
        (pair.a.weight > 0).any(-1).sum(-1), (pair.b.weight > 0).any(-1).sum(-1)
    ).sum()
    explained = (matched * epipolar).sum((1, 2, 3)) / max(possible, 1)
    steered = (
        matched
        * np.exp(-0.5 * steering_error(pair, modes.rotation) / steering_variance(pair, config))
    ).sum((1, 2, 3)) / count
    used = matched[..., None] & (weight > 0)[None]
    residual = np.array(
        [
            np.median(e[u]) if u.any() else np.inf
            for e, u in zip(error / reach(pair)[None, ..., None], used, strict=True)
        ]
    )
    lifted = steered if pair.overlap.lifted.any() else 1.0
    return Score(matched, explained * ahead * lifted, explained, ahead, residual)


def _in_front(pair: ViewPair, modes: Hypotheses, matched: Bools) -> Floats:
    """`[M]` share of the matched joints that lie in front of both cameras."""
    share = np.zeros(len(matched))
    for m, (rotation, translation) in enumerate(
        zip(modes.rotation, modes.translation, strict=True)
    ):
        rays_a, rays_b, _, _ = _matched_rays(pair, matched[m])
        if len(rays_a):
            ahead_a, ahead_b = depths(rotation, translation, rays_a, rays_b)
            share[m] = ((ahead_a > 0) & (ahead_b > 0)).mean()
    return share


def _matched_rays(pair: ViewPair, matched: Bools) -> tuple[Floats, Floats, Floats, Floats]:
    """Rays `[N, 3]` of all joints of one mode's matches, their weight and their reach `[N]`."""
    frame, i, j = np.nonzero(matched)
    weight = pair.a.weight[frame, i] * pair.b.weight[frame, j]
    use = weight > 0
    far = np.broadcast_to(reach(pair)[frame, i, j][:, None], use.shape)
    return pair.a.rays[frame, i][use], pair.b.rays[frame, j][use], weight[use], far[use]


def _on_rays(
    pair: ViewPair,
    modes: Hypotheses,
    matched: Bools,
    config: PairwiseConfig,
    rng: np.random.Generator,
) -> Hypotheses:
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
    rotation, translation = refine_two_view(
        modes.rotation, modes.translation, rays_a, rays_b, weight, far, scale=config.inlier
    )
    return replace(modes, rotation=rotation, translation=translation)


def _with_baseline(pair: ViewPair, rotation: Floats, translation: Floats, matched: Bools) -> Floats:
    """Return the translation at the length that makes bodies as far away as they were lifted."""
    direction = translation / np.linalg.norm(translation)
    ratios = distance_ratios(pair, rotation, direction, matched)
    return direction * float(np.median(ratios)) if len(ratios) else direction
