"""Refine relative poses on the rays of two views by robust least squares, many at once."""

from dataclasses import replace

import numpy as np

from mocap_calib.config import PairwiseConfig
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.kernels.loading import compiled, contiguous
from mocap_calib.pairs.hypotheses import Hypotheses
from mocap_calib.pairs.view_pair import MatchedRays, ViewPair, matched_rays
from mocap_calib.types import Bools, Floats


def refine_on_rays(
    pair: ViewPair,
    hypotheses: Hypotheses,
    config: PairwiseConfig,
    *,
    matched: Bools,
    rng: np.random.Generator,
) -> Hypotheses:
    """Refine each hypothesis on the rays of its own matches `[M, frame, I, J]`."""
    batch = _gather_rays(pair, matched, config, rng)
    rotation, translation = refine_two_view(
        hypotheses.rotation, hypotheses.translation, batch, config
    )
    return replace(hypotheses, rotation=rotation, translation=translation)


def _gather_rays(
    pair: ViewPair, matched: Bools, config: PairwiseConfig, rng: np.random.Generator
) -> MatchedRays:
    """Draw joints of the matches of each hypothesis, as many of each: M batches of N.

    matched: `[M, frame, I, J]`. Where there are fewer, the rest are axes of weight 0.
    """
    rays = [matched_rays(pair, of_one) for of_one in matched]
    count, size = len(rays), min(config.points, max(map(len, rays)))
    batch = MatchedRays(
        a=np.zeros((count, size, 3)),
        b=np.zeros((count, size, 3)),
        weight=np.zeros((count, size)),
        body_sizes_per_radian=np.ones((count, size)),
    )
    batch.a[..., 2] = batch.b[..., 2] = 1.0
    for m, of_one in enumerate(rays):
        drawn = of_one[rng.permutation(len(of_one))[:size]]
        batch.a[m, : len(drawn)] = drawn.a
        batch.b[m, : len(drawn)] = drawn.b
        batch.weight[m, : len(drawn)] = drawn.weight
        batch.body_sizes_per_radian[m, : len(drawn)] = drawn.body_sizes_per_radian
    return batch


def refine_two_view(
    rotation: Floats, translation: Floats, rays: MatchedRays, config: PairwiseConfig
) -> tuple[Floats, Floats]:
    """Minimise Sampson's error at the body over R and the direction of t; the length of t stays.

    Gauss-Newton under a Geman-McClure loss that tightens in the first steps, as graduated
    non-convexity does (Black and Rangarajan 1996).

    rotation: `[M, 3, 3]`; translation: `[M, 3]`; rays: M batches of N, `[M, N, ...]`.
    Returns R `[M, 3, 3]` and t `[M, 3]`.
    """
    length = np.linalg.norm(translation, axis=-1, keepdims=True)
    direction = translation / np.maximum(length, 1e-12)
    narrowing = config.refine_widest * config.refine_narrowing ** np.arange(config.refine_steps)
    widths = config.inlier * np.maximum(narrowing, 1.0)
    kernels = compiled("mocap_calib.kernels.pair_refinement")
    if kernels:
        rotation, direction = rotation.copy(), direction.copy()
        given = contiguous(rays.in_blocks(), widths)
        kernels.refine(rotation, direction, *given, config.refine_largest_step)
        return rotation, direction * length
    rays_a = np.ascontiguousarray(np.swapaxes(rays.a, 1, 2))  # by component, [M, 3, N]
    rays_b = np.ascontiguousarray(np.swapaxes(rays.b, 1, 2))
    for width in widths:
        tangent = np.linalg.svd(direction[:, None])[2][:, 1:]  # [M, 2, 3], normal to t
        angle, jacobian = epipolar_system(
            rotation, direction, rays_a=rays_a, rays_b=rays_b, tangent=tangent
        )
        error = angle * rays.body_sizes_per_radian
        robust = rays.weight / (1 + (error / width) ** 2) ** 2
        delta = _gauss_newton_step(
            error, jacobian * rays.body_sizes_per_radian[:, None], robust, config
        )
        rotation = matrix_from_vector(delta[:, :3]) @ rotation
        direction = direction + np.einsum("mk,mkj->mj", delta[:, 3:], tangent)
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    return rotation, direction * length


def _gauss_newton_step(
    error: Floats, jacobian: Floats, weight: Floats, config: PairwiseConfig
) -> Floats:
    """Return the step `[M, 5]` of weighted least squares, no longer than it may be.

    error and weight: `[M, N]`; jacobian: `[M, 5, N]`.
    """
    weighted = jacobian * weight[:, None]
    hessian = weighted @ np.swapaxes(jacobian, 1, 2)
    gradient = weighted @ error[..., None]
    trace = np.trace(hessian, axis1=1, axis2=2)[:, None, None]
    damping = 1e-6 * trace * np.eye(5) + 1e-12 * np.eye(5)
    delta = -np.linalg.solve(hessian + damping, gradient)[..., 0]
    length = np.linalg.norm(delta, axis=1, keepdims=True)
    delta *= np.minimum(1.0, config.refine_largest_step / np.maximum(length, 1e-12))
    return delta


def epipolar_system(
    rotation: Floats, direction: Floats, *, rays_a: Floats, rays_b: Floats, tangent: Floats
) -> tuple[Floats, Floats]:
    """Return Sampson's errors in radians and their slopes in a turn and in shifts of t.

    The error is t . (R u_a x u_b), Kneip and Lynen's (2013) coplanarity of the ray normals with
    t, over the length of its gradients on the unit spheres (Sampson; Hartley and Zisserman 2004,
    eq. 11.9): |t x R u_a|^2 + |t x u_b|^2 - 2 value^2.

    rotation: `[M, 3, 3]`; direction: `[M, 3]` unit; rays: `[M, 3, N]` unit; tangent: `[M, K, 3]`
    the shifts of t. Returns errors `[M, N]` and slopes `[M, 3 + K, N]`; turns are from the left.
    """
    turned = rotation @ rays_a
    normal = _cross(turned, rays_b)
    baseline = np.broadcast_to(direction[..., None], rays_b.shape)
    across = _cross(rays_b, baseline)  # u_b x t
    value = (direction[:, None] @ normal)[:, 0]
    along_a = (direction[:, None] @ turned)[:, 0]
    along_b = (direction[:, None] @ rays_b)[:, 0]
    # with unit t and rays |t x R u_a|^2 = 1 - (t . R u_a)^2, and likewise |t x u_b|^2
    gradient_squared = np.maximum(2 - along_a**2 - along_b**2 - 2 * value**2, 1e-12)
    scale = 1 / np.sqrt(gradient_squared)
    # a step changes the lengths of the gradients, too: without that the steps end elsewhere
    ratio = value / gradient_squared
    growth = (1 + 2 * value * ratio)[:, None]
    pull_a, pull_b = (ratio * along_a)[:, None], (ratio * along_b)[:, None]
    jacobian = np.empty((len(rotation), 3 + tangent.shape[1], rays_a.shape[2]))
    jacobian[:, :3] = growth * _cross(turned, across) + pull_a * _cross(turned, baseline)
    jacobian[:, 3:] = tangent @ (growth * normal + pull_a * turned + pull_b * rays_b)
    jacobian *= scale[:, None]
    return value * scale, jacobian


def _cross(first: Floats, second: Floats) -> Floats:
    """Return the cross products of `[M, 3, N]` and `[M, 3, N]`."""
    out = np.empty(np.broadcast_shapes(first.shape, second.shape))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[:, i] = first[:, j] * second[:, k] - first[:, k] * second[:, j]
    return out
