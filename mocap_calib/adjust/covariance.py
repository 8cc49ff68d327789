"""The covariance of what was adjusted, where the errors of detections are correlated.

Errors of detections are not independent: those of one period are correlated, and those of one
joint. The inverse of the Hessian, which ignores that, is 1.5 to 10 times too small. The sandwich
B M B holds: B is the inverse of the reduced camera system, and M the scatter of the gradient by
clusters of correlated errors (Cameron, Gelbach and Miller 2011: "Robust Inference With Multiway
Clustering").

The system of an adjustment keeps the robust weights fixed. The cost itself is less curved: a rig
errs 1.2 times as far as that system says (Huber 1981: "Robust Statistics", section 7.6).
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib.adjust.residuals import Linearised, Part, Residuals, State, parts_of
from mocap_calib.adjust.solve import Parameters, eliminate_points, normal_equations
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.types import POSE, Floats, Ints

_LEAST_CURVATURE = 0.25  # share of that with fixed weights; measured 0.6 to 0.76


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

    Cauchy's loss w s^2 log(1 + r'r / s^2) of a residual r, of two coordinates, has the curvature
    u (I - 2 u r r' / (w s^2)) where its weight is u = w / (1 + r'r / s^2). Residuals lie in the
    directions in which their points cannot follow, which are less than two of each.
    """
    system, scores, curvature = gather_information(state, seen, parameters, scale)
    inverse = _inverse_at_size(curvature * system, state, parameters)
    time, joints = (scatter_of(scores, cluster) for cluster in (period, joint))
    both = scatter_of(scores, period * (joint.max(initial=0) + 1) + joint)
    # in standard deviations of independent errors, so that all directions count alike
    twice = float(np.trace(inverse @ both) / max(np.trace(inverse @ (time + joints)), 1e-300))
    return Covariance(
        independent=inverse,
        by_time=inverse @ time @ inverse,
        by_joint=inverse @ joints @ inverse,
        once=min(1.0, max(1 - twice, twice)),  # the whole is not less than what is in both
    )


def gather_information(
    state: State, seen: Residuals, parameters: Parameters, scale: float
) -> tuple[Floats, Floats, float]:
    """Return the reduced camera system `[free, free]` of all points and the prior.

    And `[free, N]` what the detections of each point add to its gradient, and the curvature of the
    cost, as a share of that with fixed weights. scale: of the loss.
    """
    parts = parts_of(state, seen)
    work = map_in_threads(lambda part: _information_of(part, parameters, scale), parts)
    systems, scores, sums = zip(*work, strict=True)
    stiffness, _ = parameters.prior(state.intrinsics)
    prior = parameters.basis.T @ (stiffness.reshape(-1, 1) * parameters.basis)
    stiff, excess = np.sum(sums, axis=0)
    seen_by = (seen.weight > 0).sum(0)
    directions = 1 - 3 * (seen_by > 0).sum() / (2 * max(seen_by.sum(), 1))  # of two, per residual
    curvature = 1 - excess / max(directions * stiff, 1e-300)
    return (
        np.sum(systems, axis=0) + prior,
        np.concatenate(scores, axis=1),
        max(float(curvature), _LEAST_CURVATURE),
    )


def _information_of(
    part: Part, parameters: Parameters, scale: float
) -> tuple[Floats, Floats, tuple[float, float]]:
    """Return the information of a block of points, and the sums of u and of u^2 r'r / (w s^2)."""
    basis = parameters.by_view[part.views].reshape(-1, parameters.basis.shape[1])
    linear = part.seen.linearise(part.block, part.state, scale, steps=0)
    equations = normal_equations(part.state.rotation, linear)
    inverse, system, _ = eliminate_points(equations)
    moved = np.einsum("ijn,jn->in", inverse, equations.point_gradient)
    scores = _camera_gradients(linear) - np.einsum("vcin,in->vcn", equations.mixed, moved)
    weight = part.seen.weight[:, part.block]
    # residuals are weighted by u: this is u r'r / (w s^2), and u / w is 1 less it
    square = (linear.residual**2).sum(1) / np.where(weight > 0, weight, 1.0) / scale**2
    robust = weight * (1 - square)
    sums = float(robust.sum()), float((robust * square).sum())
    return basis.T @ system @ basis, basis.T @ scores.reshape(len(basis), -1), sums


def _camera_gradients(linear: Linearised) -> Floats:
    """Return `[view, C, n]` what each detection adds to the gradient of its camera."""
    force = np.einsum("vkin,vkn->vin", linear.by_point, linear.residual)  # in the camera's frame
    turning = np.cross(linear.in_camera, force, axis=1)
    intrinsics = np.einsum("vkin,vkn->vin", linear.by_intrinsics, linear.residual)
    return np.concatenate([turning, force, intrinsics], axis=1)


def scatter_of(scores: Floats, cluster: Ints) -> Floats:
    """Return the scatter `[free, free]` of the sums of scores over clusters.

    scores: `[free, N]`; cluster: `[N]`.
    """
    _, number = np.unique(cluster, return_inverse=True)
    count = int(number.max(initial=-1)) + 1
    sums = np.stack([np.bincount(number, row, minlength=count) for row in scores])
    return np.asarray(sums @ sums.T * (count / max(count - 1, 1)), dtype=np.float64)


def _inverse_at_size(matrix: Floats, state: State, parameters: Parameters) -> Floats:
    """Return the inverse of a reduced camera system `[free, free]`, the size of the rig held."""
    size = size_direction(state, parameters)
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


def size_direction(state: State, parameters: Parameters) -> Floats:
    """Return how the free parameters `[free]` change as the rig grows.

    All cameras move away from the first: C -> C0 + s (C - C0).
    """
    first = -state.rotation[0].T @ state.translation[0]
    moves = np.zeros(parameters.by_view.shape[:2])
    moves[:, 3:POSE] = state.translation + state.rotation @ first  # 0 of the first
    return np.asarray(parameters.basis.T @ moves.ravel())
