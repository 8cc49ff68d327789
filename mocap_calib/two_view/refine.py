"""Robust least squares on the rays of two views, many hypotheses at once."""

import numpy as np

from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.types import Floats


def refine_two_view(
    rotation: Floats,
    translation: Floats,
    rays_a: Floats,
    rays_b: Floats,
    weight: Floats,
    far: Floats,
    *,
    scale: float,
    steps: int = 12,
) -> tuple[Floats, Floats]:
    """Gauss-Newton on R and the direction of t, under a Geman-McClure loss that tightens from 4 x scale to scale.

    Minimises Sampson's error on rays times `far`; the length of t stays. rotation `[M, 3, 3]`, translation `[M, 3]`, rays
    `[M, N, 3]`, weight and far `[M, N]`.
    """
    length = np.linalg.norm(translation, axis=-1, keepdims=True)
    direction = translation / np.maximum(length, 1e-12)
    first, second = (
        np.ascontiguousarray(np.swapaxes(rays, 1, 2)) for rays in (rays_a, rays_b)
    )  # by component, `[M, 3, N]`
    for step in range(steps):
        width = scale * max(4.0 * 0.75**step, 1.0)
        tangent = np.linalg.svd(direction[:, None])[2][
            :, 1:
        ]  # (M, 2, 3) spans the plane normal to t
        error, jacobian = epipolar_system(rotation, direction, first, second, tangent)
        error, jacobian = error * far, jacobian * far[:, None]
        robust = weight / (1 + (error / width) ** 2) ** 2
        weighted = jacobian * robust[:, None]
        hessian = weighted @ np.swapaxes(jacobian, 1, 2)
        gradient = weighted @ error[..., None]
        damping = 1e-6 * np.trace(hessian, axis1=1, axis2=2)[:, None, None] * np.eye(
            5
        ) + 1e-12 * np.eye(5)
        delta = -np.linalg.solve(hessian + damping, gradient)[..., 0]
        delta *= np.minimum(
            1.0, 0.3 / np.maximum(np.linalg.norm(delta, axis=1, keepdims=True), 1e-12)
        )
        rotation = matrix_from_vector(delta[:, :3]) @ rotation
        direction = direction + np.einsum("mk,mkj->mj", delta[:, 3:], tangent)
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    return rotation, direction * length


def epipolar_system(
    rotation: Floats, direction: Floats, first: Floats, second: Floats, tangent: Floats
) -> tuple[Floats, Floats]:
    """Sampson's errors in radians `[M, N]` and their slopes `[M, 3 + K, N]` in a turn (left) and in shifts of t along `tangent` `[M, K, 3]`.

    rotation `[M, 3, 3]`, direction `[M, 3]` unit, first and second `[M, 3, N]` unit rays. t . (R u_a x u_b) over the lengths of its
    gradients.
    """
    turned = rotation @ first
    jacobian = np.empty((len(rotation), 3 + tangent.shape[1], first.shape[2]))
    normal, across = (
        _cross(turned, second),
        _cross(second, np.broadcast_to(direction[..., None], second.shape)),
    )
    value = (direction[:, None] @ normal)[:, 0]
    along = (direction[:, None] @ turned)[:, 0]
    # |t x R u_a|^2 + |t x u_b|^2 - 2 value^2, with unit t and rays
    square = np.einsum("min,min->mn", across, across)
    slope = 1 - along * along + square - 2 * value * value
    unit = 1 / np.sqrt(np.maximum(slope, 1e-12))
    jacobian[:, :3] = _cross(turned, across)
    jacobian[:, 3:] = tangent @ normal
    jacobian *= unit[:, None]
    return value * unit, jacobian


def _cross(first: Floats, second: Floats) -> Floats:
    """`[M, 3, N]` cross products."""
    out = np.empty(np.broadcast_shapes(first.shape, second.shape))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[:, i] = first[:, j] * second[:, k] - first[:, k] * second[:, j]
    return out
