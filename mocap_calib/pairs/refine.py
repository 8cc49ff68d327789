"""Score hypotheses of a relative pose on all frames, and refine them on their matches."""

from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.config import PairwiseConfig
from mocap_calib.kernels import pair_refinement
from mocap_calib.kernels.affinity import share_in_front
from mocap_calib.kernels.loading import contiguous
from mocap_calib.pairs.affinity import match_affinity, mutual_best, nearest_reading, pose_variance
from mocap_calib.pairs.search import Hypotheses
from mocap_calib.pairs.view_pair import ViewPair, matched_rays
from mocap_calib.types import Bools, Floats, Ints


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
    explained = (matched * fit).sum((1, 2, 3)) / max(_possible_matches(pair), 1)
    agreement = (matched * pose).sum((1, 2, 3)) / np.maximum(matched.sum((1, 2, 3)), 1)
    return Scored(hypotheses, matched, explained * in_front * np.sqrt(agreement), in_front)


def _possible_matches(pair: ViewPair) -> int:
    """Return the largest number of matches: in each frame the lesser number of detections."""
    detections_a, detections_b = pair.a.present.sum(-1), pair.b.present.sum(-1)
    return int(np.minimum(detections_a, detections_b).sum())


def refine_scored(
    pair: ViewPair, scored: Scored, config: PairwiseConfig, rng: np.random.Generator
) -> Scored:
    """Refine each hypothesis on its matches; keep the step where the score does not fall."""
    hypotheses = scored.hypotheses
    count, points = len(hypotheses), config.points
    rays = []
    for matched in scored.matched:
        of_one = matched_rays(pair, matched)
        rays.append(of_one[rng.permutation(len(of_one))[:points]])
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
    each = np.arange(count)
    better = refined.score >= scored.score
    return (scored + refined)[np.where(better, count + each, each)]


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
