"""The covariance of what was adjusted, where the errors of detections are correlated.

Errors of detections are not independent: those of one period are correlated, and those of one
joint. The inverse of the Hessian, which ignores that, is 1.5 to 10 times too small. The sandwich
B M B holds: B is the inverse of the reduced camera system, and M the scatter of the gradient by
clusters of correlated errors (Cameron, Gelbach and Miller 2011: "Robust Inference With Multiway
Clustering").

The system of an adjustment keeps the robust weights fixed. The cost itself is less curved: a rig
errs 1.4 times as far as that system says (Huber 1981: "Robust Statistics", section 7.6). Here the
curvature of the cost is taken.
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib.adjust.parameters import Parameters
from mocap_calib.adjust.residuals import Linearised, Part, Residuals, State, parts_of
from mocap_calib.adjust.solve import eliminate_points, normal_equations
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.types import Floats, Ints

# Least curvature of the cost in any direction, as a share of that with fixed weights. Measured:
# 0.31 to 0.68 in the direction of least curvature, 0.63 to 0.75 on average
_LEAST_CURVATURE = 0.2


@dataclass(frozen=True)
class Covariance:
    """The covariance of the free parameters of an adjustment, `[free, free]`.

    independent: where all detections err independently, the inverse of the reduced system.
    by_time, by_joint: by errors that the detections of a period, or of a joint, have in common.
    once: share (0.5..1) of the sum of both that is not counted twice: what detections of one period
        and one joint have in common is in both. Where there is nothing else, the sum is twice the
        covariance.
    """

    independent: Floats
    by_time: Floats
    by_joint: Floats
    once: float

    @property
    def whole(self) -> Floats:
        """The covariance by all errors."""
        return self.once * self.cautious

    @property
    def cautious(self) -> Floats:
        """The covariance with a margin, for what no camera shall be accused of by mistake.

        Errors that one period and one joint have in common count twice.
        """
        return self.by_time + self.by_joint


def find_covariance(
    state: State,
    seen: Residuals,
    parameters: Parameters,
    *,
    period: Ints,
    joint: Ints,
    scale: float,
) -> Covariance:
    """Return the covariance of the free parameters at a minimum, at the size that the rig has.

    period, joint: `[N]` numbers of the clusters of the points. scale: of the loss.

    Cauchy's loss w s^2 log(1 + r'r / s^2) has the curvature u (I - 2 u r r' / (w s^2)) where its
    weight is u = w / (1 + r'r / s^2). With residuals and derivatives weighted by sqrt(u), as
    everywhere here, the reduced system is too large by the sum of 2 / (w s^2) q q' over all
    detections, q being what each adds to the gradient of the cameras.
    """
    found = gather_information(state, seen, parameters, scale)
    inverse = _inverse_at_size(_less_curved(found.system, found.excess), state)
    time, joints = (scatter_of(found.scores, cluster) for cluster in (period, joint))
    both = scatter_of(found.scores, period * (joint.max(initial=0) + 1) + joint)
    # in standard deviations of independent errors, so that all directions count alike
    twice = float(np.trace(inverse @ both) / max(np.trace(inverse @ (time + joints)), 1e-300))
    return Covariance(
        independent=inverse,
        by_time=inverse @ time @ inverse,
        by_joint=inverse @ joints @ inverse,
        once=min(1.0, max(1 - twice, twice)),  # the whole is not less than what is in both
    )


def _less_curved(system: Floats, excess: Floats) -> Floats:
    """Return a reduced system `[free, free]` without its excess, a share of it left everywhere."""
    stiffness = np.diag(system)
    scale = np.sqrt(np.maximum(stiffness, 1e-15 * stiffness.max()))
    values, vectors = np.linalg.eigh(system / scale / scale[:, None])
    root = np.sqrt(np.maximum(values, 1e-13 * values.max()))
    whitening = vectors / root / scale[:, None]
    shares, directions = np.linalg.eigh(np.eye(len(system)) - whitening.T @ excess @ whitening)
    half = scale[:, None] * (vectors * root) @ directions
    return np.asarray((half * np.maximum(shares, _LEAST_CURVATURE)) @ half.T)


@dataclass(frozen=True)
class Information:
    """What detections determine of the free parameters, with the points eliminated.

    system: `[free, free]` the reduced camera system, with the prior.
    scores: `[free, N]` what the detections of each point add to the gradient.
    excess: `[free, free]` by how much the system is larger than the curvature of the cost.
    """

    system: Floats
    scores: Floats
    excess: Floats


def gather_information(
    state: State, seen: Residuals, parameters: Parameters, scale: float
) -> Information:
    """Return the information of all points, and that of the prior. scale: of the loss."""
    parts = parts_of(state, seen)
    found = list(map_in_threads(lambda part: _information_of(part, parameters, scale), parts))
    stiffness, _ = parameters.prior(state.intrinsics)
    prior = parameters.basis.T @ (stiffness.reshape(-1, 1) * parameters.basis)
    return Information(
        system=np.sum([each.system for each in found], axis=0) + prior,
        scores=np.concatenate([each.scores for each in found], axis=1),
        excess=np.sum([each.excess for each in found], axis=0),
    )


def _information_of(part: Part, parameters: Parameters, scale: float) -> Information:
    """Return the information of a block of points."""
    basis = parameters.by_view[part.views].reshape(-1, parameters.basis.shape[1])
    linear = part.seen.linearise(part.block, part.state, scale, steps=0)
    equations = normal_equations(part.state.rotation, linear)
    inverse, system, _ = eliminate_points(equations)
    own, pull = _gradients(part.state.rotation, linear)
    # how far each detection moves its point: the points go where the others want them
    moved = np.einsum("ijn,vjn->vin", inverse, pull)
    scores = own - np.einsum("vcin,in->vcn", equations.mixed, moved.sum(0))
    weight = part.seen.weight[:, part.block]
    share = np.where(weight > 0, 2 / (np.where(weight > 0, weight, 1.0) * scale**2), 0.0)
    return Information(
        system=basis.T @ system @ basis,
        scores=basis.T @ scores.reshape(len(basis), -1),
        excess=basis.T @ _excess(equations.mixed, own, moved, share) @ basis,
    )


def _gradients(rotation: Floats, linear: Linearised) -> tuple[Floats, Floats]:
    """Return what each detection adds to the gradients of its camera and its point.

    `[view, C, n]` and `[view, 3, n]`.
    """
    force = np.einsum("vkin,vkn->vin", linear.by_point, linear.residual)  # in the camera's frame
    turning = np.cross(linear.in_camera, force, axis=1)
    intrinsics = np.einsum("vkin,vkn->vin", linear.by_intrinsics, linear.residual)
    own = np.concatenate([turning, force, intrinsics], axis=1)
    return own, np.matmul(np.swapaxes(rotation, 1, 2), force)


def _excess(mixed: Floats, own: Floats, moved: Floats, share: Floats) -> Floats:
    """Return the sum of s q q' over all detections, `[C view, C view]`, s being their share.

    q is what a detection adds to the gradient of all cameras: its `own` `[view, C, n]` to that of
    its camera, and -W m by the way m that it moves its point (`moved`, `[view, 3, n]`).
    mixed: `[view, C, 3, n]` W; share: `[view, n]`.
    """
    rows = mixed.shape[0] * mixed.shape[1]
    spread = np.einsum("vn,vin,vjn->ijn", share, moved, moved)
    # half of what is symmetric: (W M / 2 - D) W' and its transpose, D being that of the own parts
    half = np.einsum("vcin,ijn->vcjn", mixed, 0.5 * spread)
    half -= (share[:, None] * own)[:, :, None] * moved[:, None]
    found = half.reshape(rows, -1) @ mixed.reshape(rows, -1).T
    found += found.T.copy()
    of_views = found.reshape(*mixed.shape[:2], *mixed.shape[:2])
    view = np.arange(len(mixed))
    of_views[view, :, view] += np.matmul(share[:, None] * own, np.swapaxes(own, 1, 2))
    return found


def scatter_of(scores: Floats, cluster: Ints) -> Floats:
    """Return the scatter `[free, free]` of the sums of scores over clusters.

    scores: `[free, N]`; cluster: `[N]`.
    """
    _, number = np.unique(cluster, return_inverse=True)
    count = int(number.max()) + 1
    sums = np.stack([np.bincount(number, row, minlength=count) for row in scores])
    return np.asarray(sums @ sums.T * (count / max(count - 1, 1)), dtype=np.float64)


def _inverse_at_size(matrix: Floats, state: State) -> Floats:
    """Return the inverse of a reduced camera system `[free, free]`, the size of the rig held.

    The size changes as all cameras move away from the first: C -> C0 + s (C - C0).
    """
    first = -state.rotation[0].T @ state.translation[0]
    size = np.zeros(len(matrix))
    moves = np.zeros((len(state.rotation) - 1, 6))
    moves[:, 3:] = state.translation[1:] + state.rotation[1:] @ first
    size[: moves.size] = moves.ravel()
    directions = np.linalg.svd(size[None])[2][1:].T  # all that leave the size as it is
    stiffness = np.diag(matrix)
    scale = 1 / np.sqrt(np.maximum(stiffness, 1e-15 * stiffness.max()))  # rounding may go below
    directions, _ = np.linalg.qr(directions / scale[:, None])
    scaled = directions.T @ (scale[:, None] * matrix * scale) @ directions
    values, vectors = np.linalg.eigh(scaled)
    vectors = directions @ vectors
    # what nothing determines is as uncertain as numbers allow, not certain
    inverse = (vectors / np.maximum(values, 1e-13 * values.max())) @ vectors.T
    return scale[:, None] * inverse * scale
