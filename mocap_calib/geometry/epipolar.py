"""Two views, on unit rays, so that any camera model is welcome. Batched over leading axes."""

import cv2
import numpy as np

from mocap_calib.geometry.rotation import skew
from mocap_calib.types import Floats


def essential(rotation: Floats, translation: Floats) -> Floats:
    """E = [t]x R of b_from_a: u_b' E u_a = 0. `[..., 3, 3]`, `[..., 3]` -> `[..., 3, 3]`."""
    return skew(translation) @ rotation


def sampson_angle(matrix: Floats, rays_a: Floats, rays_b: Floats) -> Floats:
    """Signed first-order angular distance in radians of matches from epipolar consistency.

    Sampson's error (Hartley and Zisserman 2004, eq. 11.9) in the tangent planes of the unit sphere: on the surface
    E u_a is normal to u_b, so its whole length is the gradient. matrix: `[..., 3, 3]`; rays: `[N, 3]`.
    Returns `[..., N]`.
    """
    from_a = rays_a @ np.swapaxes(matrix, -1, -2)  # (..., N, 3) rows E u_a
    from_b = rays_b @ matrix  # rows E' u_b
    value = (from_a * rays_b).sum(-1)
    # the projections onto the tangent planes lose the component along the ray, which is the value itself
    slope = (from_a**2).sum(-1) + (from_b**2).sum(-1) - 2 * value**2
    return value / np.sqrt(np.maximum(slope, 1e-18))


def translation_system(rotation: Floats, rays_a: Floats, rays_b: Floats, weight: Floats) -> Floats:
    """M(R) = sum w n n', n = (R u_a) x u_b: its smallest eigenvector is the direction of t.

    The paper's stacked collinearity and coplanarity system with the points eliminated (the matrix of Kneip and
    Lynen 2013). rotation: `[..., 3, 3]`; rays: `[N, 3]`; weight: `[..., N]`. Returns `[..., 3, 3]`.
    """
    normal = np.cross(rays_a @ np.swapaxes(rotation, -1, -2), rays_b)
    return np.einsum("...n,...ni,...nj->...ij", weight, normal, normal)


def depths(
    rotation: Floats, translation: Floats, rays_a: Floats, rays_b: Floats
) -> tuple[Floats, Floats]:
    """Distances along both rays to the midpoint of their common normal, `[..., N]` each.

    Solves d_b u_b - d_a R u_a = t in the least-squares sense; positive means in front of the camera.
    """
    turned = rays_a @ np.swapaxes(rotation, -1, -2)
    t = translation[..., None, :]
    cosine = (turned * rays_b).sum(-1)
    along_a, along_b = (turned * t).sum(-1), (rays_b * t).sum(-1)
    sine2 = np.maximum(1 - cosine**2, 1e-12)
    return (cosine * along_b - along_a) / sine2, (along_b - cosine * along_a) / sine2


def five_point(rays_a: Floats, rays_b: Floats, threshold: float) -> list[tuple[Floats, Floats]]:
    """R, t of b_from_a by five-point RANSAC (Nister 2004, as in OpenCV) on rays `[N, 3]`; threshold in radians.

    Of the four decompositions of E the one with most points in front of both cameras is returned; an empty list where
    fewer than eight rays point forward or no model is found.
    """
    forward = (rays_a[:, 2] > 0.1) & (rays_b[:, 2] > 0.1)
    rays_a, rays_b = rays_a[forward], rays_b[forward]
    if len(rays_a) < 8:
        return []
    image_a, image_b = rays_a[:, :2] / rays_a[:, 2:], rays_b[:, :2] / rays_b[:, 2:]
    model, _ = cv2.findEssentialMat(
        image_a, image_b, np.eye(3), method=cv2.USAC_ACCURATE, prob=0.999, threshold=threshold
    )
    if model is None or model.shape != (3, 3):
        return []
    first, second, t = (
        np.asarray(part, dtype=np.float64) for part in cv2.decomposeEssentialMat(model)
    )
    candidates = [(r, s * t[:, 0]) for r in (first, second) for s in (1.0, -1.0)]
    ahead = [np.mean([(d > 0) for d in depths(r, t, rays_a, rays_b)]) for r, t in candidates]
    return [candidates[int(np.argmax(ahead))]]
