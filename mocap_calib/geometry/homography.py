"""Whether what two views saw may lie in a plane: a homography maps one image of a plane to another.

Hartley and Zisserman 2004, section 4.1 (direct linear transform) and 13.1.
"""

import numpy as np

from mocap_calib.types import Bools, Floats

_STEPS = 6  # of reweighting
_LEAST_FORWARD = (
    0.1  # z of a unit ray about the mean ray: what is beside it has no place in a plane
)
_LEAST_MATCHES = 20


def plane_errors(rays_a: Floats, rays_b: Floats) -> Floats:
    """Return the errors `[n]` in radians of the homography that maps most rays of a to those of b.

    By direct linear transform, reweighted by Cauchy's loss at two medians. Of those of the matches
    that both views see within 84 degrees of the mean ray; none where these are too few.

    rays_a, rays_b: `[N, 3]` unit rays of matches.
    """
    if len(rays_a) < _LEAST_MATCHES:
        return np.zeros(0)
    (flat_a, seen_a), (flat_b, seen_b) = _project(rays_a), _project(rays_b)
    both = seen_a & seen_b
    if both.sum() < _LEAST_MATCHES:
        return np.zeros(0)
    return homography_errors(flat_a[both], flat_b[both])


def homography_errors(points: Floats, images: Floats) -> Floats:
    """Return the errors `[N]` of the homography that maps most points to their images.

    As `plane_errors` does. points, images: `[N, 2]`; the errors are in the unit of the images.
    """
    (points, _), (images, scale) = _normalise(points), _normalise(images)
    points = np.column_stack([points, np.ones(len(points))])
    weight, depth = np.ones(len(points)), np.ones(len(points))
    for _ in range(_STEPS):
        rows = np.zeros((2, len(points), 9))
        rows[0, :, :3], rows[1, :, 3:6] = points, points
        rows[..., 6:] = -images.T[..., None] * points
        rows *= (np.sqrt(weight) / depth)[:, None]
        flat = rows.reshape(-1, 9)
        matrix = np.linalg.eigh(flat.T @ flat)[1][:, 0].reshape(3, 3)
        mapped = points @ matrix.T
        depth = np.maximum(np.abs(mapped[:, 2]), 1e-9)
        mapped = mapped[:, :2] / np.where(mapped[:, 2:] < 0, -depth[:, None], depth[:, None])
        error = np.linalg.norm(mapped - images, axis=1)
        weight = 1 / (1 + (error / (2 * np.median(error) + 1e-12)) ** 2)
    return np.asarray(error * scale)


def _project(rays: Floats) -> tuple[Floats, Bools]:
    """Return rays `[N, 2]` in the plane that touches the sphere at their mean, and which do."""
    axis = rays.mean(0) / np.linalg.norm(rays.mean(0))
    side = np.linalg.svd(axis[None])[2][1:]
    forward = rays @ axis
    return rays @ side.T / np.maximum(forward, _LEAST_FORWARD)[:, None], forward > _LEAST_FORWARD


def _normalise(points: Floats) -> tuple[Floats, float]:
    """Return points `[n, 2]` about their middle in units of their usual distance, and this unit."""
    offset = points - np.median(points, axis=0)
    scale = float(np.median(np.linalg.norm(offset, axis=1))) + 1e-12
    return offset / scale, scale
