"""Two views -> their relative pose and who is who.

Every possible match of two lifted bodies gives a rotation in closed form, and five-point RANSAC
gives more where identities are known. All are scored on all frames at once; the best hypotheses
are refined by turns of matching and robust least squares on rays. The one with the
best score is the answer, the others are its alternatives, which a third view may speak for.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np

from mocap_calib.compute.parallel import map_in_threads, single_threaded_libraries
from mocap_calib.config import PairwiseConfig
from mocap_calib.geometry.epipolar import sampson_angle
from mocap_calib.pairs.affinity import unit_essential_matrix
from mocap_calib.pairs.search import (
    Hypotheses,
    refine_hypotheses,
    score_hypotheses,
    search_hypotheses,
    well_separated,
)
from mocap_calib.pairs.view_pair import (
    ViewPair,
    distance_ratios,
    gather_view_pair,
    matched_rays,
)
from mocap_calib.results import LiftedPoses, PairwiseCalibration
from mocap_calib.types import Bools, Floats, Ints, Mapper, Progress, Sample

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
