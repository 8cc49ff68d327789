"""The paper's baseline without a network: five-point RANSAC over matches of detections."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from mocap_calib.config import FIVE_POINT_CONFIDENCE, LEAST_FORWARD
from mocap_calib.geometry.epipolar import depths, essential_matrix, sampson_angle
from mocap_calib.pairs.affinity import mutual_best
from mocap_calib.pairs.view_pair import ViewPair
from mocap_calib.types import Bools, Floats, Ints


@dataclass(frozen=True)
class FivePointConfig:
    """The baseline that calibrates a pair of views without lifted bodies."""

    candidates: int = 60  # sets of matches that RANSAC draws
    inlier_px: float = 6.0
    least_fit: float = 0.6  # share of the joints of a right match that are inliers
    ransac_iterations: int = 300


FIVE_POINT_LEAST_JOINTS = 5  # determine an essential matrix


RelativePose = tuple[Floats, Floats]  # R [3, 3] and t [3] of b_from_a

# Of rays [N, 3] of both views, a threshold in radians and trials (draws of five points), the pose
# that most rays agree on; None where there is none.
Estimator = Callable[[Floats, Floats, float, int], RelativePose | None]


class Found(NamedTuple):
    """A relative pose b_from_a and matches.

    rotation: `[3, 3]`; translation: `[3]` of length 1.
    matches: `[match, 3]` rows (frame, instance in a, instance in b).
    """

    rotation: Floats
    translation: Floats
    matches: Ints


def estimate_by_loransac(
    rays_a: Floats, rays_b: Floats, threshold: float, trials: int
) -> RelativePose | None:
    """Return the relative pose by COLMAP's LO-RANSAC of five points, as an `Estimator` does.

    Chum, Matas and Kittler 2003: "Locally Optimized RANSAC"; the five points by Nister 2004. The
    draws are the same in each call.
    """
    import pycolmap  # noqa: PLC0415 - takes 0.3 s, and other solvers of pairs do not need it

    # of focal length 1, so that its pixels are radians
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=1, height=1, params=[1.0, 0.0, 0.0])
    options = pycolmap.RANSACOptions(
        max_error=threshold,
        confidence=FIVE_POINT_CONFIDENCE,
        min_num_trials=trials,
        max_num_trials=trials,
        random_seed=0,
    )
    points_a, points_b = (rays[:, :2] / rays[:, 2:] for rays in (rays_a, rays_b))
    found = pycolmap.estimate_essential_matrix(points_a, points_b, camera, camera, options)
    if found is None:
        return None
    b_from_a = found["cam2_from_cam1"]
    translation = np.array(b_from_a.translation)
    return b_from_a.rotation.matrix(), translation / np.linalg.norm(translation)


def five_point_over_matches(
    rays_a: Floats,
    rays_b: Floats,
    threshold: float,
    rng: np.random.Generator,
    *,
    config: FivePointConfig = FivePointConfig(),
    estimator: Estimator = estimate_by_loransac,
) -> Found | None:
    """Run RANSAC over matches of detections, five-point (Nister 2004) on their joints.

    The paper's baseline. A candidate is two matches of one frame, or one where a frame has but
    one subject; the relative pose that explains most joints of the matches it implies is
    estimated again from all of them.

    rays_a, rays_b: unit rays `[frame, I | J, keypoint, 3]` of both views, NaN = missing.
    threshold: Sampson's angle in radians. Returns None where no model is found.
    """

    def estimate(matched: Bools) -> RelativePose | None:
        """Return R and unit t from the joints of matches `[frame, I, J]`, None = there is none."""
        joints = _correspondences(rays_a, rays_b, matched)
        if len(joints[0]) < FIVE_POINT_LEAST_JOINTS:
            return None
        return estimator(*joints, threshold, config.ransac_iterations)

    def explained(pose: RelativePose) -> int:
        """Return how many joints of right matches are inliers."""
        inliers, seen = _inliers(rays_a, rays_b, pose, threshold)
        share = _share(inliers, seen)
        return int((inliers * (mutual_best(share) & (share >= config.least_fit))).sum())

    drawn = map(estimate, _candidates(rays_a, rays_b, config.candidates, rng))
    found = [pose for pose in drawn if pose is not None]
    if not found:
        return None
    best = max(found, key=explained)
    again = estimate(match_by_pose(rays_a, rays_b, best, threshold))
    if again is not None:
        best = max(again, best, key=explained)
    matched = match_by_pose(rays_a, rays_b, best, threshold)
    return Found(*best, matches=np.argwhere(matched).astype(np.int64))


def _candidates(
    rays_a: Floats, rays_b: Floats, most: int, rng: np.random.Generator
) -> Iterator[Bools]:
    """Draw masks `[frame, I, J]` of two matches of one frame, or of one where there are not two."""
    present_a, present_b = (
        np.isfinite(rays[..., 0]).sum(-1) >= FIVE_POINT_LEAST_JOINTS for rays in (rays_a, rays_b)
    )
    both = present_a[:, :, None] & present_b[:, None]  # [frame, I, J]
    possible: list[tuple[int, list[list[int]]]] = []
    for frame, matched in enumerate(both):
        single = np.argwhere(matched).tolist()
        double = [
            [first, second]
            for first, second in product(single, single)
            if first[0] < second[0] and first[1] != second[1]
        ]
        possible += [(frame, matches) for matches in double or [[match] for match in single]]
    for k in rng.permutation(len(possible))[:most]:
        frame, matches = possible[k]
        mask = np.zeros_like(both)
        for i, j in matches:
            mask[frame, i, j] = True
        yield mask


def _correspondences(rays_a: Floats, rays_b: Floats, matched: Bools) -> tuple[Floats, Floats]:
    """Return rays `[N, 3]` of the joints of matches, in front of both image planes."""
    frame, i, j = np.nonzero(matched)
    of_a, of_b = rays_a[frame, i].reshape(-1, 3), rays_b[frame, j].reshape(-1, 3)
    both = np.minimum(np.nan_to_num(of_a[:, 2]), np.nan_to_num(of_b[:, 2])) > LEAST_FORWARD
    return of_a[both], of_b[both]


def match_by_pose(rays_a: Floats, rays_b: Floats, pose: RelativePose, threshold: float) -> Bools:
    """Return where two detections of a frame are each other's best match, `[frame, I, J]`.

    rays_a, rays_b: unit rays `[frame, I | J, keypoint, 3]` of both views, NaN = missing.
    threshold: Sampson's angle in radians, below which a joint agrees with the pose.
    """
    return mutual_best(_share(*_inliers(rays_a, rays_b, pose, threshold)))


def _inliers(
    rays_a: Floats, rays_b: Floats, pose: RelativePose, threshold: float
) -> tuple[Ints, Ints]:
    """Return how many joints of each possible match are inliers, and how many it has.

    `[frame, I, J]` each.
    """
    rotation, translation = pose
    shape = np.broadcast_shapes(rays_a[:, :, None].shape, rays_b[:, None].shape)
    rays_a = np.broadcast_to(rays_a[:, :, None], shape).reshape(-1, 3)
    rays_b = np.broadcast_to(rays_b[:, None], shape).reshape(-1, 3)
    error = np.abs(sampson_angle(essential_matrix(rotation, translation), rays_a, rays_b))
    depth_a, depth_b = depths(rotation, translation, rays_a, rays_b)
    inlier = (error < threshold) & (depth_a > 0) & (depth_b > 0)
    seen = np.isfinite(error)
    return inlier.reshape(shape[:-1]).sum(-1), seen.reshape(shape[:-1]).sum(-1)


def _share(inliers: Ints, seen: Ints) -> Floats:
    """Return the share of inliers of each possible match, 0 where it has too few joints."""
    return inliers / np.maximum(seen, 1) * (seen >= FIVE_POINT_LEAST_JOINTS)


def find_by_five_point(
    pair: ViewPair, focal: float, *, config: FivePointConfig = FivePointConfig()
) -> Found | None:
    """Return the relative pose with most inliers, or None where nothing is matched.

    focal: of both views in pixels, the mean.
    """
    rays = pair.a.rays_or_nan, pair.b.rays_or_nan
    return five_point_over_matches(*rays, config.inlier_px / focal, pair.rng, config=config)
