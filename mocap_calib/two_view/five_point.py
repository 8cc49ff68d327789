"""Training-free baselines for two views in which nobody knows who is who; for benchmarks, the program uses neither.

Both take rays `[frame, I, keypoint, 3]` and `[frame, J, keypoint, 3]` (unit, NaN = missing) and a threshold in radians,
and give R, unit t and matches `[match, 3]` (frame, i, j), or None where no model is found.
"""

from itertools import product

import cv2
import numpy as np

from mocap_calib.geometry.epipolar import depths, essential_matrix, sampson_angle
from mocap_calib.types import Bools, Floats, Ints

Found = tuple[Floats, Floats, Ints]

_LEAST_JOINTS = 5
_FIT = 0.6  # share of the joints of a right match that are inliers


def all_pairs_magsac(rays_a: Floats, rays_b: Floats, threshold: float) -> Found | None:
    """MAGSAC (Barath 2019, as in OpenCV) on the joints of all cross pairs of detections of a frame."""
    everything = np.ones((rays_a.shape[0], rays_a.shape[1], rays_b.shape[1]), dtype=bool)
    pose = _essential_pose(
        *_correspondences(rays_a, rays_b, everything), threshold, cv2.USAC_MAGSAC
    )
    return None if pose is None else (*pose, _matches(*pose, rays_a, rays_b, threshold))


def five_point_over_matches(
    rays_a: Floats,
    rays_b: Floats,
    threshold: float,
    rng: np.random.Generator,
    *,
    proposals: int = 60,
) -> Found | None:
    """The paper's baseline: RANSAC over instance matches, five-point (Nister 2004) on the joints of those proposed.

    A proposal is two matches of one frame, or one where a frame has but one subject; the relative pose that explains most
    joints of the matches it implies is estimated again from all of them.
    """
    best, most = None, 0.0
    for chosen in _proposals(rays_a, rays_b, rng, proposals):
        pose = _essential_pose(*_correspondences(rays_a, rays_b, chosen), threshold, cv2.RANSAC)
        if pose is not None:
            support = _support(*pose, rays_a, rays_b, threshold)[0]
            best, most = (pose, support) if best is None or support > most else (best, most)
    if best is None:
        return None
    again = _essential_pose(
        *_correspondences(rays_a, rays_b, _matched(*best, rays_a, rays_b, threshold)),
        threshold,
        cv2.RANSAC,
    )
    if again is not None and _support(*again, rays_a, rays_b, threshold)[0] >= most:
        best = again
    return (*best, _matches(*best, rays_a, rays_b, threshold))


def _proposals(rays_a: Floats, rays_b: Floats, rng: np.random.Generator, count: int) -> list[Bools]:
    """Up to `count` masks `[frame, I, J]` of one or two matches of one frame."""
    there_a, there_b = (np.isfinite(r[..., 0]).sum(-1) >= _LEAST_JOINTS for r in (rays_a, rays_b))
    all_of_them = []
    for frame in range(len(rays_a)):
        single = [
            (i, j) for i in np.flatnonzero(there_a[frame]) for j in np.flatnonzero(there_b[frame])
        ]
        double = [[p, q] for p, q in product(single, single) if p[0] < q[0] and p[1] != q[1]]
        all_of_them += [(frame, matches) for matches in double or [[p] for p in single]]
    masks = []
    for k in rng.permutation(len(all_of_them))[:count]:
        frame, matches = all_of_them[k]
        masks.append(np.zeros((*rays_a.shape[:2], rays_b.shape[1]), dtype=bool))
        for i, j in matches:
            masks[-1][frame, i, j] = True
    return masks


def _correspondences(rays_a: Floats, rays_b: Floats, matched: Bools) -> tuple[Floats, Floats]:
    """Rays `[N, 3]` of the joints that both detections of a match show, in front of both image planes."""
    frame, i, j = np.nonzero(matched)
    first, second = rays_a[frame, i].reshape(-1, 3), rays_b[frame, j].reshape(-1, 3)
    use = (np.nan_to_num(first[:, 2]) > 0.1) & (np.nan_to_num(second[:, 2]) > 0.1)
    return first[use], second[use]


def _essential_pose(
    rays_a: Floats, rays_b: Floats, threshold: float, method: int
) -> tuple[Floats, Floats] | None:
    """R and unit t by OpenCV; of the four decompositions the one with most inliers in front of both cameras."""
    if len(rays_a) < _LEAST_JOINTS:
        return None
    image_a, image_b = rays_a[:, :2] / rays_a[:, 2:], rays_b[:, :2] / rays_b[:, 2:]
    model, mask = cv2.findEssentialMat(
        image_a, image_b, np.eye(3), method=method, prob=0.999, threshold=threshold, maxIters=300
    )
    if model is None or model.shape != (3, 3) or not np.any(mask):
        return None
    inlier = mask.ravel() > 0
    first, second, t = (
        np.asarray(part, dtype=np.float64) for part in cv2.decomposeEssentialMat(model)
    )
    candidates = [(r, s * t[:, 0]) for r in (first, second) for s in (1.0, -1.0)]
    ahead = [
        np.mean([(d > 0) for d in depths(r, t, rays_a[inlier], rays_b[inlier])])
        for r, t in candidates
    ]
    return candidates[int(np.argmax(ahead))]


def _support(
    rotation: Floats, translation: Floats, rays_a: Floats, rays_b: Floats, threshold: float
) -> tuple[float, Floats]:
    """Inlier joints of the best match of each detection of a, and the inlier share of every possible match `[frame, I, J]`."""
    frames, rows, keypoints = rays_a.shape[:3]
    columns = rays_b.shape[1]
    shape = (frames, rows, columns, keypoints, 3)
    first, second = (
        np.broadcast_to(rays_a[:, :, None], shape),
        np.broadcast_to(rays_b[:, None], shape),
    )
    error = np.abs(
        sampson_angle(essential_matrix(rotation, translation), first.reshape(-1, 3), second.reshape(-1, 3))
    ).reshape(shape[:-1])
    both = np.isfinite(error)
    ahead = [
        d.reshape(shape[:-1]) > 0
        for d in depths(rotation, translation, first.reshape(-1, 3), second.reshape(-1, 3))
    ]
    inlier = both & (error < threshold) & ahead[0] & ahead[1]
    count = both.sum(-1)
    share = inlier.sum(-1) / np.maximum(count, 1) * (count >= _LEAST_JOINTS)
    right = (
        (share >= _FIT)
        & (share == share.max(-1, keepdims=True))
        & (share == share.max(-2, keepdims=True))
    )
    return float((inlier.sum(-1) * right).sum()), share


def _matched(
    rotation: Floats, translation: Floats, rays_a: Floats, rays_b: Floats, threshold: float
) -> Bools:
    """`[frame, I, J]` mutually best matches."""
    share = _support(rotation, translation, rays_a, rays_b, threshold)[1]
    return (
        (share > 0)
        & (share == share.max(-1, keepdims=True))
        & (share == share.max(-2, keepdims=True))
    )


def _matches(
    rotation: Floats, translation: Floats, rays_a: Floats, rays_b: Floats, threshold: float
) -> Ints:
    return np.argwhere(_matched(rotation, translation, rays_a, rays_b, threshold)).astype(np.int64)
