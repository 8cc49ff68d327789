"""The most probable relative pose of two views, given the rays and the lifted bodies together.

Few joints determine an epipolar geometry badly (a body alone is nearly flat and far), and lifted bodies say where the
answer lies to some ten degrees: each is weighted by what it knows. With many frames the rays alone decide, because the
errors of lifted bodies are alike and do not average out.
"""

from collections.abc import Sequence

import numpy as np

from mocap_calib.config import PairwiseConfig
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.two_view.refine import epipolar_system
from mocap_calib.two_view.view_pair import ViewPair
from mocap_calib.types import Bools, Floats

_STEPS = 25
_SETTLED = 1e-3  # of the log posterior: a thousandth of what is worth a word


def most_probable(
    pair: ViewPair,
    rotation: Floats,
    translation: Floats,
    matched: Bools,
    rays: Sequence[Floats],
    config: PairwiseConfig,
) -> tuple[Floats, Floats]:
    """Levenberg-Marquardt on R and t of one mode from where robust refinement on rays has left it.

    rotation `[3, 3]`, translation `[3]` in body sizes; matched: `[frame, I, J]`; rays: both unit rays `[N, 3]` of all joints
    of the matches, their weight and reach `[N]`. Returned unchanged where nothing matched is lifted, or no ray is left.
    """
    use = matched & (pair.overlap.lifted > 0)
    if not use.any() or not len(rays[0]):
        return rotation, translation
    share = 1 / (1 + use.sum() / config.lift_independent)
    rays = [rays[0].T[None].copy(), rays[1].T[None].copy(), *rays[2:]]  # by component
    error = _epipolar(rotation, translation, rays)[0]
    freedom = np.sqrt(len(error) / max(len(error) - 5, 1))
    noise = max(1.4826 * float(np.median(np.abs(error))) * freedom, config.least_noise)
    width = max(
        3 * noise, config.inlier
    )  # as the refinement before: keypoints err by more than chance

    def system(r: Floats, t: Floats) -> tuple[float, Floats, Floats]:
        """Energy (negative log posterior), its Hessian `[6, 6]` and its gradient `[6]`."""
        error, jacobian = _epipolar(r, t, rays)
        square = (error / width) ** 2
        robust = rays[2] / (noise * (1 + square)) ** 2
        on_rays = 0.5 * (width / noise) ** 2 * float((rays[2] * square / (1 + square)).sum())
        parts = [
            (on_rays, (jacobian * robust) @ jacobian.T, jacobian @ (robust * error)),
            *(
                (share * e, share * h, share * g)
                for e, h, g in (_bodies(pair, r, use, config), _places(pair, r, t, use, config))
            ),
        ]
        return sum(e for e, _, _ in parts), sum(h for _, h, _ in parts), sum(g for _, _, g in parts)

    damping = 1e-3
    energy, hessian, gradient = system(rotation, translation)
    for _ in range(_STEPS):
        delta = -np.linalg.solve(
            hessian + damping * np.diag(np.diag(hessian)) + 1e-9 * np.trace(hessian) * np.eye(6),
            gradient,
        )
        moved = matrix_from_vector(delta[:3]) @ rotation, translation + delta[3:]
        after = system(*moved)
        settled = (
            abs(energy - after[0]) < _SETTLED
        )  # a step up by less is as good a sign of the bottom as one down
        if after[0] < energy:
            (rotation, translation), (energy, hessian, gradient), damping = (
                moved,
                after,
                damping / 5,
            )
        else:
            damping *= 5
        if settled:
            break
    return rotation, translation


def _epipolar(
    rotation: Floats, translation: Floats, rays: Sequence[Floats]
) -> tuple[Floats, Floats]:
    """Sampson's errors at the body `[N]` and their slopes `[6, N]` in a turn (left) and a shift of t."""
    rays_a, rays_b, _, far = rays
    length = np.linalg.norm(translation)
    direction = translation / length
    across = (np.eye(3) - np.outer(direction, direction)) / length
    error, jacobian = epipolar_system(rotation[None], direction[None], rays_a, rays_b, across[None])
    return error[0] * far, jacobian[0] * far


def _bodies(
    pair: ViewPair, rotation: Floats, use: Bools, config: PairwiseConfig
) -> tuple[float, Floats, Floats]:
    """Energy, Hessian `[6, 6]` and gradient `[6]` of sum |R X_a - X_b|^2 / 2 sigma^2; all joints of a body are as wrong as one."""
    turned = rotation @ pair.overlap.cross[use].sum(0)  # sum w (R X_a) X_b'
    precision = 3 / config.lift_spread**2
    hessian, gradient = np.zeros((6, 6)), np.zeros(6)
    hessian[:3, :3] = precision * (np.trace(turned) * np.eye(3) - (turned + turned.T) / 2)
    gradient[:3] = precision * np.array(
        [turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]
    )
    values, axes = np.linalg.eigh(
        hessian[:3, :3]
    )  # far from the minimum it may curve the other way
    hessian[:3, :3] = (axes * np.maximum(values, 0.0)) @ axes.T
    return precision * float(pair.overlap.norm[use].sum() / 2 - np.trace(turned)), hessian, gradient


def _places(
    pair: ViewPair, rotation: Floats, translation: Floats, use: Bools, config: PairwiseConfig
) -> tuple[float, Floats, Floats]:
    """The same of the gaps R c_a + t - c_b of the bodies' places: uncertain along the two rays, good to a part of a body across."""
    frame, i, j = np.nonzero(use)
    moved, seen = pair.a.centre[frame, i] @ rotation.T, pair.b.centre[frame, j]
    gap = moved + translation - seen
    spread = config.centre_spread**2 * (
        moved[:, :, None] * moved[:, None] + seen[:, :, None] * seen[:, None]
    )
    information = np.linalg.inv(spread + config.lift_spread**2 * np.eye(3))
    squared = np.einsum("ni,nij,nj->n", gap, information, gap)
    information /= ((1 + squared / 9) ** 2)[:, None, None]
    x, y, z = moved.T
    zero = np.zeros_like(x)
    turn = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], -1).reshape(-1, 3, 3)  # -[R c_a]x
    jacobian = np.concatenate([turn, np.broadcast_to(np.eye(3), turn.shape)], -1)
    weighted = np.einsum("nik,nij->nkj", jacobian, information)
    energy = 4.5 * float((squared / 9 / (1 + squared / 9)).sum())
    return (
        energy,
        np.einsum("nkj,njl->kl", weighted, jacobian),
        np.einsum("nkj,nj->k", weighted, gap),
    )
