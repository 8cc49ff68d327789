"""Search, score and refine the relative poses of two views.

Two lifted bodies give a rotation in closed form; five-point RANSAC gives more where it is known
which detections belong to one individual. All are scored on all frames, and refined on their
matches.
"""

from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from mocap_calib.config import PairwiseConfig
from mocap_calib.geometry.epipolar import five_point
from mocap_calib.geometry.rotation import nearest_rotation
from mocap_calib.kernels import pair_refinement
from mocap_calib.kernels.association import share_in_front
from mocap_calib.kernels.jit import contiguous
from mocap_calib.pairs.affinity import (
    body_agreement,
    match_affinity,
    mutual_best,
    nearest_reading,
    pose_variance,
)
from mocap_calib.pairs.view_pair import (
    ViewPair,
    body_sizes_per_radian,
    in_blocks,
    matched_rays,
)
from mocap_calib.types import Bools, Floats, Ints

_CELLS = 2_000_000  # hypotheses x possible matches scored at a time, for memory


@dataclass(frozen=True)
class Hypotheses:
    """M hypotheses of the relative pose b_from_a of one pair of views, with matches and scores.

    rotation: `[M, 3, 3]`.
    translation: `[M, 3]` in body sizes.
    source: `[M]` method that found each ("lifted", "five-point", ...).
    matched: `[M, frame, I, J]` matches under each hypothesis.
    score: `[M]` in 0..1, see `score_hypotheses`.
    in_front: `[M]` in 0..1, share of the matched joints in front of both cameras.
    """

    rotation: Floats
    translation: Floats
    source: NDArray[np.str_]
    matched: Bools
    score: Floats
    in_front: Floats

    def __getitem__(self, index: Ints) -> "Hypotheses":
        return Hypotheses(*(each[index] for each in vars(self).values()))


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
    size = max(1, _CELLS // pair.lifted.size)  # one crowded frame has many possible matches
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


def score_hypotheses(
    pair: ViewPair,
    rotation: Floats,
    translation: Floats,
    source: NDArray[np.str_],
    config: PairwiseConfig,
) -> Hypotheses:
    """Match the detections under each hypothesis, and score it by its matches.

    The pair score is the share of the possible matches that are made, each weighted by the share
    of its joints that fit the epipolar geometry, x the share of joints in front of both cameras
    x the square root of the mean agreement of the lifted poses, by which bodies count as much as
    in the affinity of a match: rays are measured, bodies are predicted from the same keypoints.
    """
    affinity, fit, pose = match_affinity(pair, rotation, translation, config)
    matched = mutual_best(affinity)
    in_front = np.zeros(len(rotation))
    of_views = (pair.a.rays, pair.b.rays, pair.a.weight, pair.b.weight)
    share_in_front(*contiguous(rotation, translation, *of_views, matched), in_front)
    possible = np.minimum(pair.a.present.sum(-1), pair.b.present.sum(-1)).sum()
    explained = (matched * fit).sum((1, 2, 3)) / max(possible, 1)
    agreement = (matched * pose).sum((1, 2, 3)) / np.maximum(matched.sum((1, 2, 3)), 1)
    score = explained * in_front * np.sqrt(agreement)
    return Hypotheses(rotation, translation, source, matched, score, in_front)


def refine_hypotheses(pair: ViewPair, found: Hypotheses, config: PairwiseConfig) -> Hypotheses:
    """Refine each hypothesis on its matches; keep the step where the score does not fall."""
    rays = [matched_rays(pair, matched) for matched in found.matched]
    size = max(map(len, rays))
    if size == 0:
        return found
    sums = [
        _body_sums(pair, *each, config) for each in zip(found.rotation, found.matched, strict=True)
    ]
    rotation, translation = refine_poses(
        found.rotation,
        found.translation,
        config,
        rays=np.stack([in_blocks(of_one, size) for of_one in rays]),
        cross=np.stack([cross for cross, _ in sums]),
        inertia=np.array([inertia for _, inertia in sums]),
    )
    refined = score_hypotheses(pair, rotation, translation, found.source, config)
    both = zip(vars(found).values(), vars(refined).values(), strict=True)
    joined = Hypotheses(*(np.concatenate(each) for each in both))
    each = np.arange(len(rays))
    return joined[each + len(rays) * (refined.score >= found.score)]


def _body_sums(
    pair: ViewPair, rotation: Floats, matched: Bools, config: PairwiseConfig
) -> tuple[Floats, float]:
    """Return sum w X_a X_b' `[3, 3]` and sum w (|X_a|^2 + |X_b|^2) / 2 over lifted matches.

    They weigh the distance of a body, of three coordinates, against the error of a ray. The errors
    of lifted bodies are alike: n of them have the information of n / (1 + n / 2).
    rotation: `[3, 3]`; matched: `[frame, I, J]`.
    """
    lifted = matched & (pair.lifted > 0)
    if not lifted.any():
        return np.zeros((3, 3)), 0.0
    share = 3 / (1 + lifted.sum() / 2)
    weight = share * config.inlier**2 / pose_variance(pair, config)[lifted]
    cross = np.einsum("n,nij->ij", weight, nearest_reading(pair, rotation, lifted))
    return cross, float(weight @ pair.norm[lifted] / 2)


def refine_poses(
    rotation: Floats,
    translation: Floats,
    config: PairwiseConfig,
    *,
    rays: Floats,
    cross: Floats,
    inertia: Floats,
) -> tuple[Floats, Floats]:
    """Minimise Sampson's error at the body, and the distance of bodies, over R and direction of t.

    Gauss-Newton under a Geman-McClure loss that tightens in the first steps, as graduated
    non-convexity does (Black and Rangarajan 1996). The length of t stays.

    rotation: `[M, 3, 3]`; translation: `[M, 3]`; rays: `[M, block, 8, LANES]`; cross: `[M, 3, 3]`
    and inertia: `[M]` of the bodies. Returns R `[M, 3, 3]` and t `[M, 3]`.
    """
    length = np.linalg.norm(translation, axis=-1, keepdims=True)
    direction = translation / np.maximum(length, 1e-12)
    widths = config.inlier * np.array(config.loss_widths)
    rotation = rotation.copy()
    pair_refinement.refine(rotation, direction, *contiguous(rays, cross, inertia, widths))
    return rotation, direction * length
