"""Training-free baselines for two views in which nobody knows who is who.

Both take rays `[frame, I, keypoint, 3]` and `[frame, J, keypoint, 3]` (unit, NaN = missing) of
the views a and b, and a threshold in radians.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import cv2
import numpy as np

from mocap_calib.config import (
    FIVE_POINT_CONFIDENCE,
    FIVE_POINT_LEAST_FORWARD,
    FIVE_POINT_LEAST_JOINTS,
    FivePointConfig,
)
from mocap_calib.geometry.epipolar import (
    depths,
    essential_matrix,
    pose_from_essential,
    sampson_angle,
)
from mocap_calib.two_view.assignment import mutual_best
from mocap_calib.types import Bools, Floats, Ints

RelativePose = tuple[Floats, Floats]  # R [3, 3] and t [3] of b_from_a


class Found(NamedTuple):
    """A relative pose b_from_a and who is who.

    rotation: `[3, 3]`; translation: `[3]` of length 1.
    matches: `[match, 3]` rows (frame, instance in a, instance in b).
    """

    rotation: Floats
    translation: Floats
    matches: Ints


@dataclass(frozen=True)
class _Problem:
    """The rays of two views, and when a joint is an inlier (radians)."""

    rays_a: Floats
    rays_b: Floats
    threshold: float
    config: FivePointConfig

    @property
    def pairs_of_detections(self) -> tuple[int, int, int]:
        """Number of frames, I and J."""
        frames, rows = self.rays_a.shape[:2]
        return frames, rows, self.rays_b.shape[1]


def all_pairs_magsac(
    rays_a: Floats, rays_b: Floats, threshold: float, *, config: FivePointConfig | None = None
) -> Found | None:
    """Run MAGSAC (Barath 2019, as in OpenCV) on the joints of all pairs of detections of a frame.

    rays_a, rays_b: unit rays `[frame, I | J, keypoint, 3]` of both views, NaN = missing.
    threshold: Sampson's angle in radians. Returns None where no model is found.
    """
    problem = _Problem(rays_a, rays_b, threshold, config or FivePointConfig())
    everything = np.ones(problem.pairs_of_detections, dtype=bool)
    pose = _essential_pose(problem, everything, cv2.USAC_MAGSAC)
    return None if pose is None else Found(*pose, _list_matches(problem, pose))


def five_point_over_matches(
    rays_a: Floats,
    rays_b: Floats,
    threshold: float,
    rng: np.random.Generator,
    *,
    config: FivePointConfig | None = None,
) -> Found | None:
    """Run RANSAC over matches of detections, five-point (Nister 2004) on their joints.

    The paper's baseline. A candidate is two matches of one frame, or one where a frame has but
    one subject; the relative pose that explains most joints of the matches it implies is
    estimated again from all of them.

    rays_a, rays_b: unit rays `[frame, I | J, keypoint, 3]` of both views, NaN = missing.
    threshold: Sampson's angle in radians. Returns None where no model is found.
    """
    problem = _Problem(rays_a, rays_b, threshold, config or FivePointConfig())
    best, most = None, 0.0
    for matched in _candidates(problem, rng):
        pose = _essential_pose(problem, matched, cv2.RANSAC)
        if pose is None:
            continue
        inliers = _count_inliers(problem, pose)
        if best is None or inliers > most:
            best, most = pose, inliers
    if best is None:
        return None
    again = _essential_pose(problem, _best_matches_mask(problem, best), cv2.RANSAC)
    if again is not None and _count_inliers(problem, again) >= most:
        best = again
    return Found(*best, _list_matches(problem, best))


def _candidates(problem: _Problem, rng: np.random.Generator) -> Iterator[Bools]:
    """Draw masks `[frame, I, J]` of one or two matches of one frame."""
    present_a = np.isfinite(problem.rays_a[..., 0]).sum(-1) >= FIVE_POINT_LEAST_JOINTS
    present_b = np.isfinite(problem.rays_b[..., 0]).sum(-1) >= FIVE_POINT_LEAST_JOINTS
    possible = [
        (frame, matches)
        for frame in range(len(present_a))
        for matches in _possible_matches(present_a[frame], present_b[frame])
    ]
    for k in rng.permutation(len(possible))[: problem.config.candidates]:
        frame, matches = possible[k]
        mask = np.zeros(problem.pairs_of_detections, dtype=bool)
        for i, j in matches:
            mask[frame, i, j] = True
        yield mask


def _possible_matches(present_a: Bools, present_b: Bools) -> list[list[tuple[int, int]]]:
    """Return all sets of two matches (i, j) of a frame, or of one where there are not two.

    present: `[instance]` where there is a detection with enough joints.
    """
    single = [
        (int(i), int(j)) for i, j in product(np.flatnonzero(present_a), np.flatnonzero(present_b))
    ]
    double = [
        [first, second]
        for first, second in product(single, single)
        if first[0] < second[0] and first[1] != second[1]
    ]
    return double or [[match] for match in single]


def _essential_pose(problem: _Problem, matched: Bools, method: int) -> RelativePose | None:
    """Return R and unit t by OpenCV's robust estimation from the joints of matches.

    Of the four decompositions of E the one with most inliers in front of both cameras.
    matched: `[frame, I, J]`. None where no model is found.
    """
    rays_a, rays_b = _correspondences(problem, matched)
    if len(rays_a) < FIVE_POINT_LEAST_JOINTS:
        return None
    model, mask = cv2.findEssentialMat(
        rays_a[:, :2] / rays_a[:, 2:],
        rays_b[:, :2] / rays_b[:, 2:],
        np.eye(3),
        method=method,
        prob=FIVE_POINT_CONFIDENCE,
        threshold=problem.threshold,
        maxIters=problem.config.ransac_iterations,
    )
    if model is None or model.shape != (3, 3) or not np.any(mask):
        return None
    inlier = mask.ravel() > 0
    matrix = np.asarray(model, dtype=np.float64)
    return pose_from_essential(matrix, rays_a[inlier], rays_b[inlier])


def _correspondences(problem: _Problem, matched: Bools) -> tuple[Floats, Floats]:
    """Return rays `[N, 3]` of the joints of matches, in front of both image planes."""
    frame, i, j = np.nonzero(matched)
    rays_a = problem.rays_a[frame, i].reshape(-1, 3)
    rays_b = problem.rays_b[frame, j].reshape(-1, 3)
    forward_a = np.nan_to_num(rays_a[:, 2]) > FIVE_POINT_LEAST_FORWARD
    forward_b = np.nan_to_num(rays_b[:, 2]) > FIVE_POINT_LEAST_FORWARD
    both = forward_a & forward_b
    return rays_a[both], rays_b[both]


def _inliers(problem: _Problem, pose: RelativePose) -> tuple[Ints, Ints]:
    """Return how many joints of each possible match are inliers, and how many it has.

    `[frame, I, J]` each.
    """
    rotation, translation = pose
    shape = (*problem.pairs_of_detections, *problem.rays_a.shape[2:])
    rays_a = np.broadcast_to(problem.rays_a[:, :, None], shape).reshape(-1, 3)
    rays_b = np.broadcast_to(problem.rays_b[:, None], shape).reshape(-1, 3)
    error = np.abs(sampson_angle(essential_matrix(rotation, translation), rays_a, rays_b))
    depth_a, depth_b = depths(rotation, translation, rays_a, rays_b)
    inlier = (error < problem.threshold) & (depth_a > 0) & (depth_b > 0)
    seen = np.isfinite(error)
    return inlier.reshape(shape[:-1]).sum(-1), seen.reshape(shape[:-1]).sum(-1)


def _share(inliers: Ints, seen: Ints) -> Floats:
    """Return the share of inliers of each possible match, 0 where it has too few joints."""
    return inliers / np.maximum(seen, 1) * (seen >= FIVE_POINT_LEAST_JOINTS)


def _count_inliers(problem: _Problem, pose: RelativePose) -> float:
    """Return how many joints of right matches are inliers."""
    inliers, seen = _inliers(problem, pose)
    share = _share(inliers, seen)
    right = mutual_best(share, least=0.0) & (share >= problem.config.least_fit)
    return float((inliers * right).sum())


def _best_matches_mask(problem: _Problem, pose: RelativePose) -> Bools:
    """Return where two detections are each other's best match, `[frame, I, J]`."""
    return mutual_best(_share(*_inliers(problem, pose)), least=0.0)


def _list_matches(problem: _Problem, pose: RelativePose) -> Ints:
    """Return the best matches as rows (frame, i, j) `[match, 3]`."""
    return np.argwhere(_best_matches_mask(problem, pose)).astype(np.int64)
