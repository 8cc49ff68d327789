"""Definitions in plain numpy of what kernels compute for pairs of views."""

import numpy as np

from mocap_calib.config import PairwiseConfig
from mocap_calib.geometry.epipolar import depths
from mocap_calib.pairs.affinity import Hypotheses, unit_essential_matrix
from mocap_calib.pairs.view_pair import ViewPair, body_sizes_per_radian, matched_rays
from mocap_calib.types import Bools, Floats


def epipolar_error(pair: ViewPair, rotation: Floats, translation: Floats) -> tuple[Floats, Floats]:
    """Return Sampson's errors of all joints of all possible matches, and the weight of each.

    Hartley and Zisserman 2004, eq. 11.9, on unit rays as in `geometry.epipolar.sampson_angle`,
    and measured at the body. rotation: `[M, 3, 3]`; translation: `[M, 3]` of any length.
    Returns errors `[M, frame, I, J, keypoint]` in body sizes (unsigned) and weights
    `[frame, I, J, keypoint]`.
    """
    matrix = unit_essential_matrix(rotation, translation)
    from_a = np.einsum("mxy,faky->mfakx", matrix, pair.a.rays, optimize=True)
    from_b = np.einsum("myx,fbky->mfbkx", matrix, pair.b.rays, optimize=True)
    value = np.einsum("mfakx,fbkx->mfabk", from_a, pair.b.rays, optimize=True)
    square_a = (from_a**2).sum(-1)[:, :, :, None]
    square_b = (from_b**2).sum(-1)[:, :, None]
    slope = square_a + square_b - 2 * value**2
    angle = np.abs(value) / np.sqrt(np.maximum(slope, 1e-18))
    weight = pair.a.weight[:, :, None] * pair.b.weight[:, None]
    return angle * body_sizes_per_radian(pair)[None, ..., None], weight


def epipolar_fit(error: Floats, weight: Floats, config: PairwiseConfig) -> Floats:
    """Return in 0..1 the weighted share of joints that fit the epipolar geometry.

    error: `[M, frame, I, J, keypoint]` and weight: `[frame, I, J, keypoint]` of `epipolar_error`.
    Returns `[M, frame, I, J]`, 0 where there are too few joints in common.
    """
    fit = (weight / (1 + (error / config.inlier) ** 2)).sum(-1)
    enough = (weight > 0).sum(-1) >= config.least_joints
    return fit / np.maximum(weight.sum(-1), 1e-9) * enough


def share_of_depths(pair: ViewPair, hypotheses: Hypotheses, matched: Bools) -> Floats:
    """Return the share `[M]` of the joints of matches in front of both cameras."""
    share = np.zeros(len(matched))
    for m, of_one in enumerate(matched):
        rays = matched_rays(pair, of_one)
        if len(rays):
            rotation, translation = hypotheses.rotation[m], hypotheses.translation[m]
            depth_a, depth_b = depths(rotation, translation, rays[:, :3], rays[:, 3:6])
            share[m] = ((depth_a > 0) & (depth_b > 0)).mean()
    return share


def distances_by_size(rays: Floats) -> Floats:
    """Return the distances `[...]` of bodies by how large they look."""
    seen = np.isfinite(rays[..., 0])
    count = np.maximum(seen.sum(-1), 1)
    # the mean squared distance of unit vectors from their middle follows from how long that is
    middle = np.where(seen[..., None], rays, 0.0).sum(-2) / count[..., None]
    angular_size_squared = np.where(seen.any(-1), 1 - (middle**2).sum(-1), 0.0)
    return np.sqrt(2 / 3) / np.sqrt(np.maximum(angular_size_squared, 1e-8))
