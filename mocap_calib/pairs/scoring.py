"""One score for all relative poses of a pair of views, however they were found."""

from dataclasses import dataclass

import numpy as np

from mocap_calib.config import PairwiseConfig
from mocap_calib.kernels import affinity as kernels
from mocap_calib.kernels.loading import contiguous
from mocap_calib.pairs.affinity import (
    match_affinity,
    steering_error,
    steering_variance,
    unit_essential_matrix,
    weight_of_matches,
)
from mocap_calib.pairs.assignment import mutual_best, sinkhorn
from mocap_calib.pairs.hypotheses import Hypotheses
from mocap_calib.pairs.view_pair import ViewPair, body_sizes_per_radian
from mocap_calib.types import Bools, Floats, Ints


@dataclass(frozen=True)
class Scored:
    """Hypotheses, their matches, and how well they explain what was seen.

    matched: `[M, frame, I, J]` the matches under each hypothesis.
    score: `[M]` in 0..1, see `score_hypotheses`.
    in_front: `[M]` in 0..1, share of the matched joints in front of both cameras.
    residual: `[M]` median epipolar error in radians, infinite without a match.
    """

    hypotheses: Hypotheses
    matched: Bools
    score: Floats
    in_front: Floats
    residual: Floats

    def __getitem__(self, index: Ints) -> "Scored":
        return Scored(
            hypotheses=self.hypotheses[index],
            matched=self.matched[index],
            score=self.score[index],
            in_front=self.in_front[index],
            residual=self.residual[index],
        )


def score_hypotheses(pair: ViewPair, hypotheses: Hypotheses, config: PairwiseConfig) -> Scored:
    """Match the detections under each hypothesis, and score it by what its matches explain.

    The pair score is the share of the possible matches that are made, each weighted by the share
    of its joints that fit the epipolar geometry, x the share of joints in front of both cameras
    x the mean agreement of the lifted bodies.
    """
    rotation, translation = hypotheses.rotation, hypotheses.translation
    error, fit = fit_matches(pair, rotation, translation, config)
    affinity = match_affinity(pair, rotation, translation, config, epipolar=fit)
    matched = mutual_best(sinkhorn(affinity, dummy=config.dummy), least=config.least_match)
    explained = (matched * fit).sum((1, 2, 3)) / max(_possible_matches(pair), 1)
    in_front = share_in_front(pair, hypotheses, matched)
    agreement = _mean_agreement(pair, rotation, matched, config)
    return Scored(
        hypotheses=hypotheses,
        matched=matched,
        score=explained * in_front * agreement,
        in_front=in_front,
        residual=_residual(pair, error, matched),
    )


def fit_matches(
    pair: ViewPair, rotation: Floats, translation: Floats, config: PairwiseConfig
) -> tuple[Floats, Floats]:
    """Return Sampson's errors of the joints of all possible matches, and how well these fit.

    Hartley and Zisserman 2004, eq. 11.9, on unit rays as in `geometry.epipolar.sampson_angle`,
    and measured at the body. rotation: `[M, 3, 3]`; translation: `[M, 3]` of any length.

    Returns errors `[M, frame, I, J, keypoint]` in body sizes (unsigned), without meaning where two
    detections have too few joints in common, and `[M, frame, I, J]` in 0..1 the weighted share of
    joints that fit, 0 there.
    """
    fit = np.zeros((len(rotation), *pair.overlap.lifted.shape))
    error = np.zeros((*fit.shape, pair.a.weight.shape[-1]))
    kernels.fit_hypotheses(
        *contiguous(
            unit_essential_matrix(rotation, translation),
            np.swapaxes(pair.a.rays, 2, 3),
            np.swapaxes(pair.b.rays, 2, 3),
            pair.a.weight,
            pair.b.weight,
            body_sizes_per_radian(pair),
        ),
        config.inlier,
        config.least_common_joints,
        error,
        fit,
    )
    return error, fit


def keep_better(before: Scored, after: Scored) -> Scored:
    """Return each hypothesis as it is after a step, or before it where the step lowers its score.

    The source stays as it was.
    """
    better = after.score >= before.score
    of_matrix = better[:, None, None]
    of_vector = better[:, None]
    of_matches = better[:, None, None, None]
    hypotheses = Hypotheses(
        np.where(of_matrix, after.hypotheses.rotation, before.hypotheses.rotation),
        np.where(of_vector, after.hypotheses.translation, before.hypotheses.translation),
        before.hypotheses.source,
    )
    return Scored(
        hypotheses=hypotheses,
        matched=np.where(of_matches, after.matched, before.matched),
        score=np.where(better, after.score, before.score),
        in_front=np.where(better, after.in_front, before.in_front),
        residual=np.where(better, after.residual, before.residual),
    )


def _possible_matches(pair: ViewPair) -> int:
    """Return how many matches there can be: in each frame the lesser number of detections."""
    detections_a, detections_b = pair.a.present.sum(-1), pair.b.present.sum(-1)
    return int(np.minimum(detections_a, detections_b).sum())


def share_in_front(pair: ViewPair, hypotheses: Hypotheses, matched: Bools) -> Floats:
    """Return `[M]` the share of the matched joints that lie in front of both cameras.

    matched: `[M, frame, I, J]`.
    """
    share = np.zeros(len(matched))
    of_views = (pair.a.rays, pair.b.rays, pair.a.weight, pair.b.weight)
    poses = (hypotheses.rotation, hypotheses.translation)
    kernels.share_in_front(*contiguous(*poses, *of_views, matched), share)
    return share


def _mean_agreement(
    pair: ViewPair, rotation: Floats, matched: Bools, config: PairwiseConfig
) -> Floats | float:
    """Return `[M]` how well the matched bodies agree when turned, 1 where none is lifted."""
    if not pair.overlap.lifted.any():
        return 1.0
    error = steering_error(pair, rotation) / steering_variance(pair, config)
    count = np.maximum(matched.sum((1, 2, 3)), 1)
    total: Floats = (matched * np.exp(-0.5 * error)).sum((1, 2, 3))
    return total / count


def _residual(pair: ViewPair, error: Floats, matched: Bools) -> Floats:
    """Return `[M]` the median epipolar error of the matched joints in radians.

    error: `[M, frame, I, J, keypoint]` in body sizes.
    """
    seen = weight_of_matches(pair.a.weight, pair.b.weight) > 0
    body_sizes = body_sizes_per_radian(pair)
    residual = np.full(len(matched), np.inf)
    for m, of_one in enumerate(matched):
        angle = error[m][of_one] / body_sizes[of_one][:, None]
        used = seen[of_one]
        if used.any():
            residual[m] = np.median(angle[used])
    return residual
