"""Robust least squares on the rays of two views, many hypotheses at once."""

import numpy as np

from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.types import Floats


def refine_two_view(
    rotation: Floats, translation: Floats, rays_a: Floats, rays_b: Floats, weight: Floats, far: Floats, *, scale: float, steps: int = 12
) -> tuple[Floats, Floats]:
    """Gauss-Newton on R and the direction of t, under a Geman-McClure loss that tightens from 4 x scale to scale.

    Minimises Sampson's error on rays times `far`; the length of t stays. rotation `[M, 3, 3]`, translation `[M, 3]`, rays
    `[M, N, 3]`, weight and far `[M, N]`.
    """
    length = np.linalg.norm(translation, axis=-1, keepdims=True)
    direction = translation / np.maximum(length, 1e-12)
    for step in range(steps):
        width = scale * max(4.0 * 0.75**step, 1.0)
        turned = np.einsum("mij,mnj->mni", rotation, rays_a)
        normal = np.cross(turned, rays_b)
        value = (normal * direction[:, None]).sum(-1)  # t . (R u_a x u_b) = u_b' [t]x R u_a
        across = np.cross(rays_b, direction[:, None])
        slope = (np.cross(direction[:, None], turned) ** 2).sum(-1) + (across**2).sum(-1) - 2 * value**2
        unit = far / np.sqrt(np.maximum(slope, 1e-12))
        error = value * unit
        tangent = np.linalg.svd(direction[:, None])[2][:, 1:]  # (M, 2, 3) spans the plane normal to t
        jacobian = np.concatenate([np.cross(turned, across), np.einsum("mkj,mnj->mnk", tangent, normal)], -1) * unit[..., None]
        robust = weight / (1 + (error / width) ** 2) ** 2
        hessian = np.einsum("mn,mni,mnj->mij", robust, jacobian, jacobian, optimize=True)
        gradient = np.einsum("mn,mni,mn->mi", robust, jacobian, error, optimize=True)
        damping = 1e-6 * np.trace(hessian, axis1=1, axis2=2)[:, None, None] * np.eye(5) + 1e-12 * np.eye(5)
        delta = -np.linalg.solve(hessian + damping, gradient[..., None])[..., 0]
        delta *= np.minimum(1.0, 0.3 / np.maximum(np.linalg.norm(delta, axis=1, keepdims=True), 1e-12))
        rotation = matrix_from_vector(delta[:, :3]) @ rotation
        direction = direction + np.einsum("mk,mkj->mj", delta[:, 3:], tangent)
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    return rotation, direction * length
