"""Two views -> their relative pose and matches.

Every possible match of two lifted bodies gives a rotation in closed form, and five-point RANSAC
gives more where identities are known. All are scored on all frames at once; the best hypotheses
are refined by turns of matching and robust least squares on rays. The one with the
best score is the answer, the others are its alternatives.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial, reduce
from itertools import combinations

import numpy as np

from mocap_calib.compute.parallel import map_in_threads, single_threaded_libraries
from mocap_calib.config import PairwiseConfig
from mocap_calib.geometry.epipolar import five_point, sampson_angle
from mocap_calib.geometry.rotation import nearest_rotation
from mocap_calib.pairs.affinity import (
    Hypotheses,
    body_agreement,
    mutual_best,
    nearest_reading,
    refine_hypotheses,
    score_hypotheses,
    unit_essential_matrix,
)
from mocap_calib.pairs.view_pair import (
    ViewPair,
    body_sizes_per_radian,
    distance_ratios,
    gather_view_pair,
    matched_rays,
)
from mocap_calib.results import LiftedPoses, PairwiseCalibration
from mocap_calib.types import Bools, Floats, Ints, Mapper, Progress, Sample

CELLS = 500_000  # pairs of bodies compared at a time, as many as the cache of a processor holds

PairSolver = Callable[[ViewPair], PairwiseCalibration | None]


@single_threaded_libraries()
def calibrate_pairs(
    sample: Sample,
    lifted: LiftedPoses,
    config: PairwiseConfig,
    *,
    rng: np.random.Generator,
    progress: Progress,
    mapper: Mapper | None = None,
    solve: PairSolver | None = None,
    pairs: Sequence[tuple[int, int]] | None = None,
) -> tuple[PairwiseCalibration, ...]:
    """Calibrate the pairs of views that see something in the same frames; leave the others out.

    pairs: (a, b), a < b, by default all. What is found of one does not depend on the others.
    mapper: has it done elsewhere; by default on threads.
    solve: calibrates one pair, by default `calibrate_pair`.
    """
    pairs = all_pairs(len(sample.cameras)) if pairs is None else pairs
    mapper = mapper or map_in_threads
    solve = solve or partial(calibrate_pair, config=config)
    found: list[PairwiseCalibration] = []
    for done, result in enumerate(mapper(solve, _gather(sample, lifted, pairs, config, rng))):
        if result is not None:
            found.append(result)
        progress("pairwise", done + 1, len(pairs))
    return tuple(sorted(found, key=lambda pair: (pair.a, pair.b)))


def all_pairs(views: int) -> list[tuple[int, int]]:
    """Return the pairs (a, b), a < b, of so many views, in order."""
    return list(combinations(range(views), 2))


def in_recording(
    pairs: tuple[PairwiseCalibration, ...], sample_frames: Ints
) -> tuple[PairwiseCalibration, ...]:
    """Return the pairs with their matches by the frames of the recording, not of the sample.

    sample_frames: `[frame]` indices into the recording of the frames of the sample.
    """
    renumbered = []
    for pair in pairs:
        frame, instances = pair.matches[:, 0], pair.matches[:, 1:]
        matches = np.column_stack([sample_frames[frame], instances])
        alternatives = in_recording(pair.alternatives, sample_frames)
        renumbered.append(replace(pair, matches=matches, alternatives=alternatives))
    return tuple(renumbered)


def _gather(
    sample: Sample,
    lifted: LiftedPoses,
    pairs: Sequence[tuple[int, int]],
    config: PairwiseConfig,
    rng: np.random.Generator,
) -> Iterator[ViewPair]:
    """Gather what is known of each pair, with random numbers of its own, when it is asked for.

    Frames and random numbers of a pair are those that it has where all pairs are asked for.
    """
    every = all_pairs(len(sample.cameras))
    config = replace(config, frames=_frames_of_each(len(every), config))
    generators = dict(zip(every, rng.spawn(len(every)), strict=True))
    for a, b in pairs:
        yield gather_view_pair(sample, lifted, (a, b), config=config, rng=generators[a, b])


def _frames_of_each(pairs: int, config: PairwiseConfig) -> int:
    """Return how many frames of a pair are looked at where there are so many pairs."""
    share = config.all_frames // max(pairs, 1)
    return min(config.frames, max(config.least_frames, share))


def calibrate_pair(pair: ViewPair, config: PairwiseConfig) -> PairwiseCalibration | None:
    """Return the relative pose of the two views with the best score, and its alternatives.

    None if the views share no frame or nothing can be searched.
    """
    if pair.shared_frames == 0:
        return None
    found = search_hypotheses(pair, config)
    if len(found.score) == 0:
        return None
    for _ in range(config.rounds):
        found = refine_hypotheses(pair, found, config)
        distinct = well_separated(
            found.rotation,
            found.score,
            count=config.hypotheses_refined,
            separation_deg=config.separation_deg,
        )
        found = found[distinct]
    best, *alternatives = (_calibration(pair, found, k) for k in range(len(found.score)))
    return replace(best, alternatives=tuple(alternatives))


# The search


def search_hypotheses(pair: ViewPair, config: PairwiseConfig) -> Hypotheses:
    """Return relative poses from the lifted bodies, and those of five points; there may be none."""
    rotation, translation = _search_bodies(pair, config)
    lifted = len(rotation)
    for matches in _known_identities(pair, config):
        for turn, shift in _from_five_points(pair, matches, config):
            rotation = np.concatenate([rotation, turn[None]])
            translation = np.concatenate([translation, shift[None]])
    source = np.where(np.arange(len(rotation)) < lifted, "lifted", "five-point")
    return score_hypotheses(pair, rotation, translation, source, config)


def well_separated(rotation: Floats, score: Floats, *, count: int, separation_deg: float) -> Ints:
    """Return the indices of the best rotations that are so far apart, best first.

    rotation: `[M, 3, 3]`; score: `[M]`. Returns at most `count` indices.
    """
    ranked = np.argsort(-score, kind="stable")
    flat = rotation[ranked].reshape(-1, 9)
    # tr(R_1 R_2') = 1 + 2 cos(angle)
    apart = flat @ flat.T <= 1 + 2 * np.cos(np.deg2rad(separation_deg))
    kept: list[int] = []
    for k in range(len(ranked)):
        if len(kept) < count and apart[k, kept].all():
            kept.append(k)
    return ranked[kept]


def _search_bodies(pair: ViewPair, config: PairwiseConfig) -> tuple[Floats, Floats]:
    """Return the relative poses of possible matches that agree best with all frames, aligned."""
    rotation, translation = _candidates(pair, config)
    best = well_separated(
        rotation,
        _total_agreement(pair, rotation, translation, config),
        count=config.hypotheses_searched,
        separation_deg=config.separation_deg,
    )
    rotation, translation = rotation[best], translation[best]
    for _ in range(config.rounds):
        rotation, translation = _align_bodies(pair, rotation, translation, config)
    return rotation, translation


def _candidates(pair: ViewPair, config: PairwiseConfig) -> tuple[Floats, Floats]:
    """Return relative poses that align two lifted bodies each (Kabsch), none where none are.

    Half of them are those whose bodies agree best, half are drawn at random; each reading of the
    bodies gives its own.
    """
    frame, i, j = np.nonzero(pair.lifted)
    cross = pair.cross[:, frame, i, j].reshape(-1, 3, 3)
    frame, i, j = np.tile([frame, i, j], len(pair.cross))
    rotation = nearest_rotation(np.swapaxes(cross, -1, -2))
    error = pair.norm[frame, i, j] - 2 * np.einsum("nij,nji->n", rotation, cross)
    ranked = np.argsort(error, kind="stable")
    half = config.candidates_searched // 2
    picked = np.concatenate([ranked[:half], pair.rng.permutation(ranked[half:])[:half]])
    rotation = rotation[picked]
    centre_a = pair.a.centre[frame, i][picked]
    centre_b = pair.b.centre[frame, j][picked]
    return rotation, centre_b - np.einsum("nij,nj->ni", rotation, centre_a)


def _total_agreement(
    pair: ViewPair, rotation: Floats, translation: Floats, config: PairwiseConfig
) -> Floats:
    """Return `[M]` the best agreement of each detection with one of the other view, summed."""
    total = np.empty(len(rotation))
    size = max(1, CELLS // pair.lifted.size)  # one crowded frame has many possible matches
    for start in range(0, len(rotation), size):
        some = slice(start, start + size)
        agreement = body_agreement(pair, rotation[some], translation[some], config)
        # `max` over a few numbers that lie side by side takes several times as long
        of_a = reduce(np.maximum, np.moveaxis(agreement, -1, 0))
        of_b = reduce(np.maximum, np.moveaxis(agreement, -2, 0))
        total[some] = of_a.sum((-1, -2)) + of_b.sum((-1, -2))
    return total


def _align_bodies(
    pair: ViewPair, rotation: Floats, translation: Floats, config: PairwiseConfig
) -> tuple[Floats, Floats]:
    """Match the bodies under each hypothesis, and align the matched ones (weighted Procrustes).

    Centres weigh less the farther they are: their error grows with the distance.
    """
    agreement = body_agreement(pair, rotation, translation, config)
    rotation, translation = rotation.copy(), translation.copy()
    for m, matched in enumerate(mutual_best(agreement)):
        if not matched.any():
            continue
        frame, i, j = np.nonzero(matched)
        weight = agreement[m, matched]
        cross = np.einsum("n,nij->ji", weight, nearest_reading(pair, rotation[m], matched))
        rotation[m] = nearest_rotation(cross + 1e-9 * rotation[m])
        weight = weight / (pair.a.distance[frame, i] ** 2 + pair.b.distance[frame, j] ** 2)
        gap = pair.b.centre[frame, j] - pair.a.centre[frame, i] @ rotation[m].T
        translation[m] = weight @ gap / weight.sum()
    return rotation, translation


def _known_identities(pair: ViewPair, config: PairwiseConfig) -> list[Ints]:
    """Return sets of matches `[match, 3]` (frame, i, j) of one individual in each view.

    Each pair of tracks may be one; otherwise there is one set, of the frames with a single
    subject, where half of the frames or more are such.
    """
    if pair.tracked:
        together = pair.a.present[:, :, None] & pair.b.present[:, None]
        rows, tracks = np.argwhere(together), np.argwhere(together.any(0))
        return [rows[(rows[:, 1:] == each).all(1)] for each in tracks[: config.hypotheses_searched]]
    alone = (pair.a.present.sum(1) == 1) & (pair.b.present.sum(1) == 1)
    frames = np.flatnonzero(alone)
    if 2 * len(frames) < len(pair.frames):
        return []
    i = pair.a.present[frames].argmax(1)
    j = pair.b.present[frames].argmax(1)
    return [np.column_stack([frames, i, j])]


def _from_five_points(
    pair: ViewPair, matches: Ints, config: PairwiseConfig
) -> list[tuple[Floats, Floats]]:
    """Run five-point RANSAC (Nister 2004) on matches `[match, 3]` of one individual.

    Each of `config.five_point_draws` draws other matches, and halves the tolerance: a wide one
    finds the noisy pose, a narrow one is not content with outliers that fit by chance.
    """
    found: list[tuple[Floats, Floats]] = []
    for halvings in range(config.five_point_draws):
        drawn = np.sort(pair.rng.permutation(len(matches))[: config.five_point_matches])
        frame, i, j = matches[drawn].T
        both = (pair.a.weight[frame, i] > 0) & (pair.b.weight[frame, j] > 0)
        tolerance = config.inlier / float(np.median(body_sizes_per_radian(pair)[frame, i, j]))
        rays_a, rays_b = pair.a.rays[frame, i][both], pair.b.rays[frame, j][both]
        found += five_point(rays_a, rays_b, tolerance / 2**halvings)
    return found


# Answers


def mean_focal(pair: ViewPair, focal: Floats) -> float:
    """Return the mean focal length of the two views in pixels; focal: `[view]` of all views."""
    return float(focal[list(pair.views)].mean())


def judge_pair(
    pair: ViewPair,
    *,
    rotation: Floats,
    translation: Floats,
    matches: Ints,
    source: str,
    config: PairwiseConfig,
) -> PairwiseCalibration | None:
    """Score a relative pose and matches that were found in another way, as any other.

    rotation: `[3, 3]` and translation: `[3]` of b_from_a, of any length: its baseline in body
        sizes follows from the matches.
    matches: `[match, 3]` rows (index into the frames of the pair, instance in a, instance in b).
    source: what found it.

    Returns None where nothing is matched.
    """
    if not len(matches):
        return None
    matched = np.zeros(pair.lifted.shape, dtype=bool)
    frame, i, j = matches.T
    matched[frame, i, j] = True
    translation = _with_baseline(pair, rotation, translation, matched)
    found = score_hypotheses(pair, rotation[None], translation[None], np.array([source]), config)
    return _calibration(pair, replace(found, matched=matched[None]), 0)


def _with_baseline(pair: ViewPair, rotation: Floats, translation: Floats, matched: Bools) -> Floats:
    """Return the translation at the length that makes bodies as far away as they were lifted."""
    direction = translation / np.linalg.norm(translation)
    ratios = distance_ratios(pair.a, pair.b, rotation, direction, matched)
    return direction * float(np.median(ratios)) if len(ratios) else direction


def _calibration(pair: ViewPair, found: Hypotheses, k: int) -> PairwiseCalibration:
    """Return the record of one of the hypotheses, with a baseline in body sizes."""
    rotation, translation, matched = found.rotation[k], found.translation[k], found.matched[k]
    frame, i, j = np.nonzero(matched)
    rays = matched_rays(pair, matched)
    matrix = unit_essential_matrix(rotation, translation)
    error = np.abs(sampson_angle(matrix, rays[:, :3], rays[:, 3:6]))
    return PairwiseCalibration(
        a=pair.views[0],
        b=pair.views[1],
        rotation=rotation,
        translation=_with_baseline(pair, rotation, translation, matched),
        matches=np.stack([pair.frames[frame], i, j], 1),
        frames=pair.shared_frames,
        score=float(found.score[k]),
        residual=float(np.median(error)) if len(error) else np.inf,
        in_front=float(found.in_front[k]),
        source=str(found.source[k]),
    )
