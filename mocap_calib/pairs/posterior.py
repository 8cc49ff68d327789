"""The most probable relative pose of two views, given the rays and the lifted bodies together.

Few joints determine an epipolar geometry badly (a body alone is nearly flat and far), and lifted
bodies say where the answer lies to some ten degrees: each is weighted by what it knows. With many
frames the rays alone decide, because the errors of lifted bodies are alike and do not average
out. Three energies (negative logarithms of probabilities) are added: of the rays, of the lifted
bodies, and of their centres.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib.config import PairwiseConfig
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.kernels.loading import compiled
from mocap_calib.pairs.affinity import in_one_reading
from mocap_calib.pairs.refine import epipolar_system
from mocap_calib.pairs.view_pair import MatchedRays, ViewPair
from mocap_calib.types import Bools, Floats

_SIGMA_OF_MEDIAN = 1.4826  # standard deviation over median absolute value, of a normal distribution
_PARAMETERS = 5  # of an essential matrix


@dataclass(frozen=True)
class Energy:
    """An energy and its slopes in a turn (rotation vector, from the left) and a shift of t.

    hessian: `[6, 6]`, its positive semidefinite approximation; gradient: `[6]`.
    """

    value: float
    hessian: Floats
    gradient: Floats

    def __add__(self, other: "Energy") -> "Energy":
        return Energy(
            self.value + other.value,
            self.hessian + other.hessian,
            self.gradient + other.gradient,
        )

    def scale(self, factor: float) -> "Energy":
        """Return the energy times a factor."""
        return Energy(factor * self.value, factor * self.hessian, factor * self.gradient)


EnergyAt = Callable[[Floats, Floats], Energy]


def most_probable(
    pair: ViewPair,
    matched: Bools,
    rays: MatchedRays,
    config: PairwiseConfig,
    *,
    rotation: Floats,
    translation: Floats,
) -> tuple[Floats, Floats]:
    """Return R and t with the least energy, from where robust refinement on rays has left them.

    The same rotation and translation are returned where nothing matched is lifted, or no ray is
    left.

    matched: `[frame, I, J]`.
    rays: joints of the matches, or some of them.
    rotation: `[3, 3]` and translation: `[3]`, in body sizes.
    """
    lifted = matched & (pair.overlap.lifted > 0)
    if not lifted.any() or not len(rays):
        return rotation, translation
    pair = in_one_reading(pair, rotation)
    config = replace(config, lift_spread=lift_spread(pair, lifted, config))
    noise = _noise(ray_errors(rays, rotation, translation)[0], config)
    # the errors of lifted bodies are alike: many know little more than one
    share = 1 / (1 + lifted.sum() / config.lift_independent)
    kernels = compiled("mocap_calib.kernels.pair_refinement")
    if kernels:
        frame, i, j = np.nonzero(lifted)
        rotation, translation = rotation.copy(), translation.copy()
        kernels.minimise(
            rays.in_blocks(),
            pair.overlap.cross[0, lifted].sum(0),
            float(pair.overlap.norm[lifted].sum()),
            np.hstack([pair.a.centre[frame, i], pair.b.centre[frame, j]]),
            rotation,
            translation,
            *_rule(noise, share, config),
            config.posterior_steps,
        )
        return rotation, translation

    def energy_at(rotation: Floats, translation: Floats) -> Energy:
        """Return the negative log posterior of R `[3, 3]` and t `[3]`."""
        of_rays = ray_energy(rays, rotation, translation, noise=noise, config=config)
        of_bodies = body_energy(pair, lifted, rotation, config)
        of_centres = centre_energy(pair, lifted, config, rotation=rotation, translation=translation)
        return of_rays + of_bodies.scale(share) + of_centres.scale(share)

    return _minimise(energy_at, rotation, translation, config)


def lift_spread(pair: ViewPair, lifted: Bools, config: PairwiseConfig) -> float:
    """Return by how much two lifts of a body differ in what turns the answer, in body sizes.

    A difference in shape turns nothing. No less than that of right lifts. lifted:
    `[frame, I, J]` matches.
    """
    expected = float(np.sqrt(pair.overlap.doubt[lifted].mean()))
    return max(config.lift_spread, config.lift_turned * expected)


def _rule(noise: float, share: float, config: PairwiseConfig) -> tuple[Floats, Floats]:
    """Return the energies and the damping by the numbers that the compiled kernel takes."""
    of_rays = (noise, _loss_width(noise, config))
    of_bodies = (share, config.lift_spread, config.centre_spread, config.centre_outlier)
    damping = (config.posterior_damping, config.posterior_damping_factor, config.posterior_settled)
    return np.array([*of_rays, *of_bodies]), np.array(damping)


def _minimise(
    energy_at: EnergyAt, rotation: Floats, translation: Floats, config: PairwiseConfig
) -> tuple[Floats, Floats]:
    """Minimise an energy by Levenberg-Marquardt (Marquardt 1963: damping scaled by the Hessian)."""
    damping = config.posterior_damping
    energy = energy_at(rotation, translation)
    for _ in range(config.posterior_steps):
        step = _damped_step(energy, damping)
        next_rotation = matrix_from_vector(step[:3]) @ rotation
        next_translation = translation + step[3:]
        next_energy = energy_at(next_rotation, next_translation)
        # a small step up is as good a sign of the bottom as a small one down
        settled = abs(energy.value - next_energy.value) < config.posterior_settled
        if next_energy.value < energy.value:
            rotation, translation, energy = next_rotation, next_translation, next_energy
            damping /= config.posterior_damping_factor
        else:
            damping *= config.posterior_damping_factor
        if settled:
            break
    return rotation, translation


def _damped_step(energy: Energy, damping: float) -> Floats:
    """Return the step `[6]` of Levenberg-Marquardt."""
    hessian = energy.hessian
    scaled = damping * np.diag(np.diag(hessian))
    guard = 1e-9 * np.trace(hessian) * np.eye(6)
    return -np.linalg.solve(hessian + scaled + guard, energy.gradient)


def _noise(error: Floats, config: PairwiseConfig) -> float:
    """Return the standard deviation of the errors `[N]` of rays that were refined on them."""
    freedom = np.sqrt(len(error) / max(len(error) - _PARAMETERS, 1))
    spread = _SIGMA_OF_MEDIAN * float(np.median(np.abs(error))) * freedom
    return max(spread, config.least_noise)


def ray_energy(
    rays: MatchedRays,
    rotation: Floats,
    translation: Floats,
    *,
    noise: float,
    config: PairwiseConfig,
) -> Energy:
    """Return the energy of Sampson's errors under a Geman-McClure loss.

    E = 1/2 (width / noise)^2 sum w q / (1 + q), q = (error / width)^2. The width is not below
    that of the refinement before: keypoints err by more than chance.

    rotation: `[3, 3]` and translation: `[3]` of b_from_a. noise: in body sizes.
    """
    width = _loss_width(noise, config)
    error, jacobian = ray_errors(rays, rotation, translation)
    square = (error / width) ** 2
    robust = rays.weight / (noise * (1 + square)) ** 2
    loss = float((rays.weight * square / (1 + square)).sum())
    return Energy(
        value=0.5 * (width / noise) ** 2 * loss,
        hessian=(jacobian * robust) @ jacobian.T,
        gradient=jacobian @ (robust * error),
    )


def _loss_width(noise: float, config: PairwiseConfig) -> float:
    """Return the width of the loss of rays, in body sizes."""
    return max(config.loss_noises * noise, config.inlier)


def ray_errors(rays: MatchedRays, rotation: Floats, translation: Floats) -> tuple[Floats, Floats]:
    """Return Sampson's errors at the body `[N]` and their slopes `[6, N]` in a turn and a shift."""
    length = np.linalg.norm(translation)
    direction = translation / length
    across = (np.eye(3) - np.outer(direction, direction)) / length  # slope of the direction
    error, jacobian = epipolar_system(
        rotation[None],
        direction[None],
        rays_a=_by_component(rays.a),
        rays_b=_by_component(rays.b),
        tangent=across[None],
    )
    return error[0] * rays.body_sizes_per_radian, jacobian[0] * rays.body_sizes_per_radian


def _by_component(rays: Floats) -> Floats:
    """Return rays `[N, 3]` as one contiguous batch `[1, 3, N]`."""
    return np.ascontiguousarray(rays.T)[None]


def body_energy(pair: ViewPair, lifted: Bools, rotation: Floats, config: PairwiseConfig) -> Energy:
    """Return the energy of the distances between the lifted bodies of matches `[frame, I, J]`.

    E = sum |R X_a - X_b|^2 / 2 sigma^2 = sum (norm - 2 tr(R cross)) / 2 sigma^2, where sigma is
    that of one coordinate, and all joints of a body count as one: they are wrong together.
    """
    turned = rotation @ pair.overlap.cross[0, lifted].sum(0)  # sum w (R X_a) X_b'
    precision = 3 / config.lift_spread**2
    hessian, gradient = np.zeros((6, 6)), np.zeros(6)
    curvature = precision * (np.trace(turned) * np.eye(3) - (turned + turned.T) / 2)
    hessian[:3, :3] = _positive_part(curvature)
    gradient[:3] = precision * _axial_vector(turned)
    distance = float(pair.overlap.norm[lifted].sum() / 2 - np.trace(turned))
    return Energy(precision * distance, hessian, gradient)


def _positive_part(matrix: Floats) -> Floats:
    """Return a symmetric matrix without its negative eigenvalues.

    Far from its minimum an energy may curve the other way.
    """
    values, axes = np.linalg.eigh(matrix)
    return np.asarray((axes * np.maximum(values, 0.0)) @ axes.T)


def _axial_vector(matrix: Floats) -> Floats:
    """Return the vector `[3]` of the antisymmetric part of a matrix, M - M' = [v]x."""
    return np.array(
        [
            matrix[2, 1] - matrix[1, 2],
            matrix[0, 2] - matrix[2, 0],
            matrix[1, 0] - matrix[0, 1],
        ]
    )


def centre_energy(
    pair: ViewPair,
    lifted: Bools,
    config: PairwiseConfig,
    *,
    rotation: Floats,
    translation: Floats,
) -> Energy:
    """Return the energy of the gaps g = R c_a + t - c_b between lifted centres of matches.

    E = k^2 / 2 sum q / (1 + q), q = g' S^-1 g / k^2: Geman-McClure at k standard deviations.
    The covariance S is large along the two lines of sight, and a part of a body across.
    lifted: `[frame, I, J]`.
    """
    frame, i, j = np.nonzero(lifted)
    turned = pair.a.centre[frame, i] @ rotation.T
    centre_b = pair.b.centre[frame, j]
    gap = turned + translation - centre_b
    information = _centre_information(turned, centre_b, config)
    pull = np.einsum("nij,nj->ni", information, gap)
    outlier = config.centre_outlier**2
    share = (gap * pull).sum(-1) / outlier
    robust = 1 / (1 + share) ** 2
    jacobian = _gap_jacobian(turned)
    weighted = np.einsum("nik,nij,n->nkj", jacobian, information, robust)
    gradient = np.einsum("nik,ni,n->nk", jacobian, pull, robust)
    # the line of sight of a turns with R c_a, and S with it
    gradient[:, :3] *= 1 - config.centre_spread**2 * (pull * turned).sum(-1, keepdims=True)
    return Energy(
        value=outlier / 2 * float((share / (1 + share)).sum()),
        hessian=np.einsum("nkj,njl->kl", weighted, jacobian),
        gradient=gradient.sum(0),
    )


def _centre_information(turned: Floats, centre_b: Floats, config: PairwiseConfig) -> Floats:
    """Return the inverse covariances `[N, 3, 3]` of the gaps between centres `[N, 3]`."""
    along_a = turned[:, :, None] * turned[:, None]
    along_b = centre_b[:, :, None] * centre_b[:, None]
    along = config.centre_spread**2 * (along_a + along_b)
    covariance = along + config.lift_spread**2 * np.eye(3)
    return np.asarray(np.linalg.inv(covariance), dtype=np.float64)


def _gap_jacobian(turned: Floats) -> Floats:
    """Return the slopes `[N, 3, 6]` of R c_a + t in a turn, -[R c_a]x, and in a shift of t.

    turned: `[N, 3]` R c_a.
    """
    x, y, z = turned.T
    zero = np.zeros_like(x)
    turn = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], -1).reshape(-1, 3, 3)
    shift = np.broadcast_to(np.eye(3), turn.shape)
    return np.concatenate([turn, shift], -1)
