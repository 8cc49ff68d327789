"""Two views, on unit rays, so that any camera model is welcome.

The essential matrix and poses, batched over leading axes, and the fundamental matrix.
"""

from itertools import product

import numpy as np

from mocap_calib.config import (
    FIVE_POINT_CONFIDENCE,
    FIVE_POINT_LEAST_RAYS,
    LEAST_FORWARD,
)
from mocap_calib.geometry.rotation import skew
from mocap_calib.types import Floats


def essential_matrix(rotation: Floats, translation: Floats) -> Floats:
    """Return the essential matrix E = [t]x R `[..., 3, 3]` of b_from_a: u_b' E u_a = 0.

    rotation: `[..., 3, 3]`. translation: `[..., 3]`. (Hartley and Zisserman 2004, section 9.6.)
    """
    return skew(translation) @ rotation


def sampson_angle(matrix: Floats, rays_a: Floats, rays_b: Floats) -> Floats:
    """Return the signed angular epipolar errors `[..., N]` of matches in radians, to first order.

    Sampson's error (Hartley and Zisserman 2004, eq. 11.9) in the tangent planes of the unit
    sphere: there the gradient is the part of E u_a that is normal to u_b, and of E' u_b to u_a.

    matrix: `[..., 3, 3]` essential matrices. rays_a, rays_b: `[N, 3]` unit rays.
    """
    from_a = rays_a @ np.swapaxes(matrix, -1, -2)  # [..., N, 3] rows E u_a
    from_b = rays_b @ matrix  # [..., N, 3] rows E' u_b
    value = (from_a * rays_b).sum(-1)
    # the component along the ray is the value itself, in both views
    slope = (from_a**2).sum(-1) + (from_b**2).sum(-1) - 2 * value**2
    return value / np.sqrt(np.maximum(slope, 1e-18))


def depths(
    rotation: Floats, translation: Floats, rays_a: Floats, rays_b: Floats
) -> tuple[Floats, Floats]:
    """Return the distances `[..., N]` along both rays to the midpoint of their common normal.

    They solve d_b u_b - d_a R u_a = t in the least-squares sense. Positive means in front of the
    camera (cheirality).

    rotation: `[..., 3, 3]` and translation: `[..., 3]` of b_from_a. rays_a, rays_b: `[N, 3]`.
    """
    a_in_b = rays_a @ np.swapaxes(rotation, -1, -2)
    baseline = translation[..., None, :]
    cosine = (a_in_b * rays_b).sum(-1)
    along_a = (a_in_b * baseline).sum(-1)
    along_b = (rays_b * baseline).sum(-1)
    squared_sine = np.maximum(1 - cosine**2, 1e-12)
    depth_a = (cosine * along_b - along_a) / squared_sine
    depth_b = (along_b - cosine * along_a) / squared_sine
    return depth_a, depth_b


def five_point(rays_a: Floats, rays_b: Floats, threshold: float) -> list[tuple[Floats, Floats]]:
    """Return R `[3, 3]` and t `[3]` of b_from_a by RANSAC with the five-point method, or nothing.

    Nister 2004, as in OpenCV. Of the four decompositions of the essential matrix it is the one
    with most points in front of both cameras. The list is empty where too few rays point forward
    or no model is found.

    rays_a, rays_b: `[N, 3]` unit rays of matches.
    threshold: largest epipolar error of an inlier in radians.
    """
    forward = (rays_a[:, 2] > LEAST_FORWARD) & (rays_b[:, 2] > LEAST_FORWARD)
    if forward.sum() < FIVE_POINT_LEAST_RAYS:
        return []
    rays_a = rays_a[forward]
    rays_b = rays_b[forward]
    import cv2  # noqa: PLC0415 - slow to import, and not needed where nobody is known

    model, _ = cv2.findEssentialMat(
        rays_a[:, :2] / rays_a[:, 2:],
        rays_b[:, :2] / rays_b[:, 2:],
        np.eye(3),
        method=cv2.USAC_ACCURATE,
        prob=FIVE_POINT_CONFIDENCE,
        threshold=threshold,
    )
    if model is None or model.shape != (3, 3):
        return []
    return [pose_from_essential(np.asarray(model, dtype=np.float64), rays_a, rays_b)]


def fundamental_matrix(points_a: Floats, points_b: Floats) -> Floats | None:
    """Return the fundamental matrix `[3, 3]` of b_from_a: x_b' F x_a = 0; None where there is none.

    The one with the least median of squared errors (Rousseeuw 1984), as in OpenCV.

    points_a, points_b: `[N, 2]` pixels of matches.
    """
    import cv2  # noqa: PLC0415 - as above

    matrix, _ = cv2.findFundamentalMat(points_a, points_b, cv2.FM_LMEDS)
    return None if matrix is None else np.asarray(matrix[:3], dtype=np.float64)


def homography_errors(points: Floats, images: Floats) -> Floats:
    """Return the errors `[N]` of the homography with the least median of squared errors.

    points, images: `[N, 2]` of matches; the errors are in the unit of the images.
    """
    import cv2  # noqa: PLC0415 - as above

    matrix, _ = cv2.findHomography(points, images, cv2.LMEDS)
    if matrix is None:
        return np.full(len(points), np.inf)
    mapped = cv2.perspectiveTransform(points[None], matrix)[0]
    return np.asarray(np.linalg.norm(mapped - images, axis=1))


def pose_from_essential(matrix: Floats, rays_a: Floats, rays_b: Floats) -> tuple[Floats, Floats]:
    """Return R `[3, 3]` and t `[3]` (of length 1) of an essential matrix `[3, 3]`.

    Of its four decompositions the one with most points in front of both cameras (cheirality).

    rays_a, rays_b: `[N, 3]` unit rays of matches.
    """
    candidates = _decompose_essential(matrix)
    in_front = [
        np.mean([depth > 0 for depth in depths(rotation, translation, rays_a, rays_b)])
        for rotation, translation in candidates
    ]
    return candidates[int(np.argmax(in_front))]


def _decompose_essential(matrix: Floats) -> list[tuple[Floats, Floats]]:
    """Return the four R `[3, 3]`, t `[3]` (of length 1) of an essential matrix `[3, 3]`."""
    import cv2  # noqa: PLC0415 - as above

    first, second, column = (
        np.asarray(part, dtype=np.float64) for part in cv2.decomposeEssentialMat(matrix)
    )
    translation = column[:, 0]
    return [
        (rotation, sign * translation) for rotation, sign in product((first, second), (1.0, -1.0))
    ]
