"""Affinity of the detections of two views under relative poses, matches, scores and refinement.

By lifted bodies, turned into the other view; by their centres; and by epipolar geometry. Lengths
are in body sizes and image errors are measured at the body (an angle times the distance of the
body), so that one tolerance serves scenes of any size.

M relative poses are evaluated at once; a frame holds I instances in view a and J in view b.
"""

from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from mocap_calib.config import PairwiseConfig
from mocap_calib.geometry.epipolar import essential_matrix
from mocap_calib.kernels import pair_refinement
from mocap_calib.kernels.association import fit_hypotheses, share_in_front
from mocap_calib.kernels.jit import contiguous
from mocap_calib.pairs.view_pair import (
    ViewPair,
    in_blocks,
    matched_rays,
)
from mocap_calib.types import Bools, CameraRig, Floats, Ints, Sample


def mutual_best(affinity: Floats) -> Bools:
    """Return where an affinity is the largest of its row and of its column, and above 0.

    Of equal ones the first counts: no detection is matched twice. affinity: `[..., I, J]`.
    """
    best_of_row = affinity == affinity.max(-1, keepdims=True)
    best_of_column = affinity == affinity.max(-2, keepdims=True)
    matched: Bools = (affinity > 0) & best_of_row & best_of_column
    for axis in (-1, -2):
        if (matched.sum(axis) > 1).any():
            matched &= matched.cumsum(axis) == 1
    return matched


def match_affinity(
    pair: ViewPair, rotation: Floats, translation: Floats, config: PairwiseConfig
) -> tuple[Floats, Floats, Floats]:
    """Return how well detections match: by all cues, by epipolar geometry, by lifted pose alone.

    The first is the epipolar fit times the root of the agreement of the lifted bodies. Each in
    0..1, `[M, frame, I, J]`; bodies that were not lifted agree by 1.

    rotation: `[M, 3, 3]`; translation: `[M, 3]` in body sizes.
    """
    fit = epipolar_fit(pair, rotation, translation, config)
    bodies, pose = (
        _in_frames(pair, of_cells, unknown=1.0)
        for of_cells in _agreement_of_cells(pair, rotation, translation, config)
    )
    return fit * np.sqrt(bodies), fit, pose


def body_agreement(
    pair: ViewPair, rotation: Floats, translation: Floats, config: PairwiseConfig
) -> Floats:
    """Return in 0..1 how well lifted bodies and their centres agree, 0 if one is not lifted.

    rotation: `[M, 3, 3]`; translation: `[M, 3]` in body sizes. Returns `[M, frame, I, J]`.
    """
    agreement, _ = _agreement_of_cells(pair, rotation, translation, config)
    return _in_frames(pair, agreement, unknown=0.0)


def _agreement_of_cells(
    pair: ViewPair, rotation: Floats, translation: Floats, config: PairwiseConfig
) -> tuple[Floats, Floats]:
    """Return how well pairs of lifted bodies agree with their centres, and without: `[M, N]`.

    exp(-p / 2) / (1 + c / 2) and exp(-p / 2) of the errors p of the pose and c of the centre.
    """
    cells = np.flatnonzero(pair.lifted)
    pose = pose_error(pair, rotation, cells, config)
    pose *= -0.5
    np.exp(pose, out=pose)
    centre = centre_error(pair, rotation, translation, cells, config)
    centre *= 0.5
    centre += 1
    return np.divide(pose, centre, out=centre), pose


def _in_frames(pair: ViewPair, of_cells: Floats, *, unknown: float) -> Floats:
    """Return values `[M, frame, I, J]` of pairs of lifted bodies `[M, N]`, and of the others."""
    found = np.full((len(of_cells), pair.lifted.size), unknown)
    found[:, np.flatnonzero(pair.lifted)] = of_cells
    return found.reshape(-1, *pair.lifted.shape)


def pose_variance(pair: ViewPair, config: PairwiseConfig) -> Floats:
    """Return the variance of the distance between two lifts of one body, `[frame, I, J]`.

    Of the tolerance, or what the network predicts where that is more.
    """
    predicted = config.pose_doubt**2 * pair.doubt
    return np.maximum(config.pose_tolerance**2, predicted)


def pose_error(pair: ViewPair, rotation: Floats, cells: Ints, config: PairwiseConfig) -> Floats:
    """Return the mean squared joint distance |R X_a - X_b|^2 of lifted bodies over its variance.

    A matrix product for all rotations, as the error is linear in R; the nearest reading counts.
    rotation: `[M, 3, 3]`; cells: `[N]` flat indices of `[frame, I, J]`. Returns `[M, N]`.
    """
    turns = np.column_stack([-2 * rotation.reshape(-1, 9), np.ones(len(rotation))])
    terms = np.empty((10, len(cells)))
    terms[9] = pair.norm.take(cells)
    variance = pose_variance(pair, config).take(cells)

    def error(cross: Floats) -> Floats:
        """Return the error for sums X_a X_b' `[frame, I, J, 3, 3]` of one reading."""
        of_cells = cross.reshape(-1, 3, 3).take(cells, axis=0)
        terms[:9] = of_cells.swapaxes(1, 2).reshape(-1, 9).T
        return np.asarray(turns @ (terms / variance))

    nearest = reduce(np.minimum, map(error, pair.cross))
    return np.maximum(nearest, 0.0, out=nearest)


def nearest_reading(pair: ViewPair, rotation: Floats, matched: Bools) -> Floats:
    """Return sum w X_a X_b' `[match, 3, 3]` of matches, of the reading nearest under R `[3, 3]`.

    matched: `[frame, I, J]`.
    """
    cross = pair.cross[:, matched]
    nearest = np.einsum("ij,rnji->rn", rotation, cross).argmax(0)
    return np.asarray(cross[nearest, np.arange(len(nearest))])


def centre_error(
    pair: ViewPair, rotation: Floats, translation: Floats, cells: Ints, config: PairwiseConfig
) -> Floats:
    """Return |R c_a + t - c_b|^2 of lifted centres, relative to their distances and the tolerance.

    As one matrix product: -2 b.R a + 2 t.R a - 2 t.b + |t|^2 + (|a|^2 + |b|^2).
    rotation: `[M, 3, 3]`; translation: `[M, 3]`; cells: `[N]` flat indices of `[frame, I, J]`.
    Returns `[M, N]`.
    """
    of_pose = np.ones((len(rotation), 17))
    of_pose[:, :9] = -2 * rotation.reshape(-1, 9)
    of_pose[:, 9:12] = 2 * np.einsum("mij,mi->mj", rotation, translation)
    of_pose[:, 12:15] = -2 * translation
    of_pose[:, 15] = (translation**2).sum(-1)
    of_a, of_j = np.divmod(cells, pair.b.centre.shape[1])
    of_b = of_a // pair.a.centre.shape[1] * pair.b.centre.shape[1] + of_j
    a = pair.a.centre.reshape(-1, 3).take(of_a, axis=0).T
    b = pair.b.centre.reshape(-1, 3).take(of_b, axis=0).T
    outer = (b[:, None] * a).reshape(9, -1)
    square = (a**2).sum(0) + (b**2).sum(0)
    terms = np.vstack([outer, a, b, np.ones(len(cells)), square])
    scale = pair.a.distance.take(of_a) ** 2 + pair.b.distance.take(of_b) ** 2
    error = of_pose @ (terms / (config.centre_tolerance**2 * scale))
    return np.maximum(error, 0.0, out=error)


def epipolar_fit(
    pair: ViewPair, rotation: Floats, translation: Floats, config: PairwiseConfig
) -> Floats:
    """Return in 0..1 the weighted share of joints that fit the epipolar geometry.

    By Sampson's errors (Hartley and Zisserman 2004, eq. 11.9) on unit rays, at the body.
    rotation: `[M, 3, 3]`; translation: `[M, 3]` of any length. Returns `[M, frame, I, J]`, 0 where
    detections have too few joints in common.
    """
    return _fit_joints(
        np.broadcast_to([0, 1], (len(rotation), 2)),
        unit_essential_matrix(rotation, translation),
        config,
        rays=np.stack([pair.a.rays, pair.b.rays]),
        weight=np.stack([pair.a.weight, pair.b.weight]),
        distance=np.stack([pair.a.distance, pair.b.distance]),
        otherwise=0.0,
    )


def _fit_joints(
    views: Ints,
    matrices: Floats,
    config: PairwiseConfig,
    *,
    rays: Floats,
    weight: Floats,
    distance: Floats,
    otherwise: float,
) -> Floats:
    """Return what `epipolar_fit` does, of essential matrices `[M, 3, 3]` of views `[M, 2]`.

    rays: `[view, frame, instance, keypoint, 3]`, and weight: `[view, frame, instance, keypoint]`,
    0 = missing. distance: `[view, frame, instance]`. otherwise: where joints in common are too few.
    """
    fit = np.full((len(views), *distance.shape[1:], distance.shape[2]), otherwise)
    rays = np.swapaxes(rays, 3, 4)
    arrays = contiguous(views, matrices, rays, weight, distance)
    fit_hypotheses(*arrays, config.inlier, config.least_joints, fit)
    return fit


def unit_essential_matrix(rotation: Floats, translation: Floats) -> Floats:
    """Return the essential matrices of relative poses `[M, ...]`, with a baseline of length 1."""
    return essential_matrix(
        rotation, translation / np.linalg.norm(translation, axis=-1, keepdims=True)
    )


def epipolar_affinity(
    sample: Sample, rig: CameraRig, distance: Floats, config: PairwiseConfig
) -> tuple[Floats, Floats]:
    """Return the affinity of all pairs of detections of each frame by the rig alone.

    distance: `[view, frame, instance]` of the bodies in body sizes (see `view_pair.distances`).
    Returns the affinity `[frame, N, N]` in 0..1, N = views x instances, and 1 where it means
    something, else 0.
    """
    views, frames, instances, _ = sample.confidence.shape
    a, b = np.triu_indices(views, 1)
    rotation = rig.rotation[b] @ np.swapaxes(rig.rotation[a], 1, 2)
    translation = rig.translation[b] - (rotation @ rig.translation[a][..., None])[..., 0]
    fit = _fit_joints(
        np.column_stack([a, b]),
        unit_essential_matrix(rotation, translation),
        config,
        rays=np.nan_to_num(sample.rays),
        weight=np.where(np.isfinite(sample.rays[..., 0]), sample.confidence, 0.0),
        distance=distance,
        otherwise=np.nan,
    )
    affinity = np.full((frames, views, instances, views, instances), np.nan)
    affinity[:, a, :, b], affinity[:, b, :, a] = fit, np.swapaxes(fit, 2, 3)
    affinity = affinity.reshape(frames, views * instances, -1)
    return np.nan_to_num(affinity), np.isfinite(affinity).astype(np.float64)


# Relative poses, scored and refined


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
