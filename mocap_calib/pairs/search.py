"""Search, score and refine the relative poses of two views.

Two lifted bodies give a rotation in closed form; five-point RANSAC gives more where it is known
which detections belong to one individual. All are scored on all frames, and refined on their
matches.
"""

from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

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
from mocap_calib.pairs.view_pair import ViewPair, body_sizes_per_radian, matched_rays
from mocap_calib.types import Bools, Floats, Ints

_CELLS = 2_000_000  # hypotheses x possible matches scored at a time, for memory


@dataclass(frozen=True)
class Hypotheses:
    """M hypotheses of the relative pose b_from_a of one pair of views.

    rotation: `[M, 3, 3]`.
    translation: `[M, 3]` in body sizes.
    source: `[M]` method that found each ("lifted", "five-point", ...).
    """

    rotation: Floats
    translation: Floats
    source: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.rotation)

    def __getitem__(self, index: Ints) -> "Hypotheses":
        source = tuple(self.source[k] for k in index)
        return Hypotheses(self.rotation[index], self.translation[index], source)

    def __add__(self, other: "Hypotheses") -> "Hypotheses":
        return Hypotheses(
            rotation=np.concatenate([self.rotation, other.rotation]),
            translation=np.concatenate([self.translation, other.translation]),
            source=self.source + other.source,
        )


def search_hypotheses(
    pair: ViewPair, tracked: bool, config: PairwiseConfig, rng: np.random.Generator
) -> Hypotheses:
    """Return relative poses from the lifted bodies, and those of five points.

    tracked: in both views the instance index identifies the same individual in all frames.
    """
    hypotheses = _search_bodies(pair, config, rng)
    for matches in _known_identities(pair, tracked, config):
        hypotheses += _from_five_points(pair, matches, config, rng)
    return hypotheses


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


def _search_bodies(pair: ViewPair, config: PairwiseConfig, rng: np.random.Generator) -> Hypotheses:
    """Return the relative poses of possible matches that agree best with all frames, aligned."""
    candidates = _candidates(pair, config, rng)
    if len(candidates) == 0:
        return candidates
    best = well_separated(
        candidates.rotation,
        _total_agreement(pair, candidates, config),
        count=config.hypotheses_searched,
        separation_deg=config.separation_deg,
    )
    aligned = candidates[best]
    for _ in range(config.rounds):
        aligned = _align_bodies(pair, aligned, config)
    return aligned


def _candidates(pair: ViewPair, config: PairwiseConfig, rng: np.random.Generator) -> Hypotheses:
    """Return relative poses that align two lifted bodies each (Kabsch).

    Half of them are those whose bodies agree best, half are drawn at random; each reading of the
    bodies gives its own.
    """
    frame, i, j = np.nonzero(pair.overlap.lifted)
    cross = pair.overlap.cross[:, frame, i, j].reshape(-1, 3, 3)
    frame, i, j = np.tile([frame, i, j], len(pair.overlap.cross))
    rotation = nearest_rotation(np.swapaxes(cross, -1, -2))
    error = pair.overlap.norm[frame, i, j] - 2 * np.einsum("nij,nji->n", rotation, cross)
    ranked = np.argsort(error, kind="stable")
    half = config.candidates_searched // 2
    picked = np.concatenate([ranked[:half], rng.permutation(ranked[half:])[:half]])
    rotation = rotation[picked]
    centre_a = pair.a.centre[frame, i][picked]
    centre_b = pair.b.centre[frame, j][picked]
    translation = centre_b - np.einsum("nij,nj->ni", rotation, centre_a)
    return Hypotheses(rotation, translation, ("lifted",) * len(picked))


def _total_agreement(pair: ViewPair, hypotheses: Hypotheses, config: PairwiseConfig) -> Floats:
    """Return `[M]` the best agreement of each detection with one of the other view, summed."""

    def total(k: Ints) -> Floats:
        """Return the totals of some hypotheses: one crowded frame has many possible matches."""
        some = hypotheses[k]
        agreement = body_agreement(pair, some.rotation, some.translation, config)
        # `max` over a few numbers that lie side by side takes several times as long
        of_a = reduce(np.maximum, np.moveaxis(agreement, -1, 0))
        of_b = reduce(np.maximum, np.moveaxis(agreement, -2, 0))
        return np.asarray(of_a.sum((-1, -2)) + of_b.sum((-1, -2)))

    count = len(hypotheses)
    size = max(1, _CELLS // pair.overlap.lifted.size)
    blocks = np.split(np.arange(count), range(size, count, size))
    return np.concatenate([total(k) for k in blocks])


def _align_bodies(pair: ViewPair, hypotheses: Hypotheses, config: PairwiseConfig) -> Hypotheses:
    """Match the bodies under each hypothesis, and align the matched ones (weighted Procrustes).

    Centres weigh less the farther they are: their error grows with the distance.
    """
    agreement = body_agreement(pair, hypotheses.rotation, hypotheses.translation, config)
    matched = mutual_best(agreement)
    rotation, translation = hypotheses.rotation.copy(), hypotheses.translation.copy()
    for m, of_one in enumerate(matched):
        if not of_one.any():
            continue
        frame, i, j = np.nonzero(of_one)
        weight = agreement[m, of_one]
        cross = np.einsum("n,nij->ji", weight, nearest_reading(pair, rotation[m], of_one))
        rotation[m] = nearest_rotation(cross + 1e-9 * rotation[m])
        weight = weight / (pair.a.distance[frame, i] ** 2 + pair.b.distance[frame, j] ** 2)
        gap = pair.b.centre[frame, j] - pair.a.centre[frame, i] @ rotation[m].T
        translation[m] = weight @ gap / weight.sum()
    return Hypotheses(rotation, translation, hypotheses.source)


def _known_identities(pair: ViewPair, tracked: bool, config: PairwiseConfig) -> list[Ints]:
    """Return sets of matches `[match, 3]` (frame, i, j) of one individual in each view.

    Each pair of tracks may be one; otherwise there is one set, of the frames with a single
    subject, where half of the frames or more are such.
    """
    if tracked:
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
    pair: ViewPair, matches: Ints, config: PairwiseConfig, rng: np.random.Generator
) -> Hypotheses:
    """Run five-point RANSAC (Nister 2004) on matches `[match, 3]` of one individual.

    Each of `config.five_point_draws` draws other matches, and halves the tolerance: a wide one
    finds the noisy pose, a narrow one is not content with outliers that fit by chance.
    """
    found: list[tuple[Floats, Floats]] = []
    for halvings in range(config.five_point_draws):
        drawn = np.sort(rng.permutation(len(matches))[: config.five_point_matches])
        frame, i, j = matches[drawn].T
        both = (pair.a.weight[frame, i] > 0) & (pair.b.weight[frame, j] > 0)
        tolerance = config.inlier / float(np.median(body_sizes_per_radian(pair)[frame, i, j]))
        rays_a, rays_b = pair.a.rays[frame, i][both], pair.b.rays[frame, j][both]
        found += five_point(rays_a, rays_b, tolerance / 2**halvings)
    return Hypotheses(
        rotation=np.reshape([rotation for rotation, _ in found], (-1, 3, 3)),
        translation=np.reshape([translation for _, translation in found], (-1, 3)),
        source=("five-point",) * len(found),
    )


@dataclass(frozen=True)
class Scored:
    """Hypotheses, their matches and their scores.

    matched: `[M, frame, I, J]` matches under each hypothesis.
    score: `[M]` in 0..1, see `score_hypotheses`.
    in_front: `[M]` in 0..1, share of the matched joints in front of both cameras.
    """

    hypotheses: Hypotheses
    matched: Bools
    score: Floats
    in_front: Floats

    def __getitem__(self, index: Ints) -> "Scored":
        return Scored(
            hypotheses=self.hypotheses[index],
            matched=self.matched[index],
            score=self.score[index],
            in_front=self.in_front[index],
        )

    def __add__(self, other: "Scored") -> "Scored":
        return Scored(
            hypotheses=self.hypotheses + other.hypotheses,
            matched=np.concatenate([self.matched, other.matched]),
            score=np.concatenate([self.score, other.score]),
            in_front=np.concatenate([self.in_front, other.in_front]),
        )


def score_hypotheses(pair: ViewPair, hypotheses: Hypotheses, config: PairwiseConfig) -> Scored:
    """Match the detections under each hypothesis, and score it by its matches.

    The pair score is the share of the possible matches that are made, each weighted by the share
    of its joints that fit the epipolar geometry, x the share of joints in front of both cameras
    x the square root of the mean agreement of the lifted poses, by which bodies count as much as
    in the affinity of a match: rays are measured, bodies are predicted from the same keypoints.
    """
    rotation, translation = hypotheses.rotation, hypotheses.translation
    affinity, fit, pose = match_affinity(pair, rotation, translation, config)
    matched = mutual_best(affinity)
    in_front = np.zeros(len(hypotheses))
    of_views = (pair.a.rays, pair.b.rays, pair.a.weight, pair.b.weight)
    share_in_front(*contiguous(rotation, translation, *of_views, matched), in_front)
    possible = np.minimum(pair.a.present.sum(-1), pair.b.present.sum(-1)).sum()
    explained = (matched * fit).sum((1, 2, 3)) / max(possible, 1)
    agreement = (matched * pose).sum((1, 2, 3)) / np.maximum(matched.sum((1, 2, 3)), 1)
    return Scored(hypotheses, matched, explained * in_front * np.sqrt(agreement), in_front)


def refine_scored(pair: ViewPair, scored: Scored, config: PairwiseConfig) -> Scored:
    """Refine each hypothesis on its matches; keep the step where the score does not fall."""
    hypotheses = scored.hypotheses
    rays = [matched_rays(pair, matched) for matched in scored.matched]
    size = max(map(len, rays))
    if size == 0:
        return scored
    sums = [
        _body_sums(pair, *each, config)
        for each in zip(hypotheses.rotation, scored.matched, strict=True)
    ]
    rotation, translation = refine_poses(
        hypotheses.rotation,
        hypotheses.translation,
        config,
        rays=np.stack([of_one.in_blocks(size) for of_one in rays]),
        cross=np.stack([cross for cross, _ in sums]),
        inertia=np.array([inertia for _, inertia in sums]),
    )
    moved = replace(hypotheses, rotation=rotation, translation=translation)
    refined = score_hypotheses(pair, moved, config)
    each = np.arange(len(hypotheses))
    better = refined.score >= scored.score
    return (scored + refined)[each + len(each) * better]


def _body_sums(
    pair: ViewPair, rotation: Floats, matched: Bools, config: PairwiseConfig
) -> tuple[Floats, float]:
    """Return sum w X_a X_b' `[3, 3]` and sum w (|X_a|^2 + |X_b|^2) / 2 over lifted matches.

    They weigh the distance of a body, of three coordinates, against the error of a ray. The errors
    of lifted bodies are alike: n of them have the information of n / (1 + n / 2).
    rotation: `[3, 3]`; matched: `[frame, I, J]`.
    """
    lifted = matched & (pair.overlap.lifted > 0)
    if not lifted.any():
        return np.zeros((3, 3)), 0.0
    share = 3 / (1 + lifted.sum() / 2)
    weight = share * config.inlier**2 / pose_variance(pair, config)[lifted]
    cross = np.einsum("n,nij->ij", weight, nearest_reading(pair, rotation, lifted))
    return cross, float(weight @ pair.overlap.norm[lifted] / 2)


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
