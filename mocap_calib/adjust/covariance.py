"""The covariance of what was adjusted, which holds also where errors go together.

Errors of detections are no independent noise: those of one moment go together, and those of one
joint. The inverse of the Hessian, which knows nothing of that, is 1.5 to 10 times too sure. The
sandwich B M B is right: B is the inverse of the reduced camera system, and M the sum, over groups
whose errors go together, of what their gradients scatter by (Cameron, Gelbach and Miller 2011:
"Robust Inference With Multiway Clustering").

The system of an adjustment is that of weights which stay as they are, as suits its steps. The cost
itself is less curved, since a robust loss bends: a rig goes 1.4 times as far as that system says
(Huber 1981: "Robust Statistics", section 7.6). `find_curved_covariance` takes the curvature of the
cost.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from mocap_calib.adjust.freedom import Freedom
from mocap_calib.adjust.residuals import (
    Observations,
    Slopes,
    State,
    blocks_of,
    part_of,
    slopes_of,
)
from mocap_calib.adjust.schur import eliminate_points, equations_of, prior_of
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.types import Floats, Ints


@dataclass(frozen=True)
class Covariance:
    """What the covariance of the free unknowns of `Freedom` is made of, `[free, free]` each.

    bread: inverse of the reduced camera system, which is the covariance where all detections err
        independently.
    scatter: of the gradient, by the groups of detections whose errors go together.
    """

    bread: Floats
    scatter: Floats

    @property
    def sandwich(self) -> Floats:
        """The covariance `[free, free]` that follows from what was seen."""
        return self.bread @ self.scatter @ self.bread


@dataclass(frozen=True)
class CurvedCovariance:
    """The covariance of free unknowns by the errors that go together in one way or the other.

    parts: `[cluster, free, free]` by what each kind of groups scatters by.
    once: share (0.5..1) of the sum of the parts that is not counted twice: what detections of one
        moment and one joint have in common is in both parts. Where there is nothing else, the sum
        is twice the covariance.
    """

    parts: Floats
    once: float


def find_covariance(
    state: State,
    seen: Observations,
    freedom: Freedom,
    *,
    clusters: tuple[Ints, ...],
    loss_scale: float,
) -> Covariance:
    """Return the covariance of the free unknowns at a minimum, at the size that the rig has.

    clusters: `[N]` numbers each; the errors of points of one number go together.

    Residuals count for as much as points have absorbed of them. The derivatives without the points
    are blind to that part, so nothing is missing without it: what it adds, 1.2 to 2 times, is a
    margin for what shall not be accused by mistake.
    """
    told = _all_that_is_told(state, seen, freedom, loss_scale, curved=False)
    scores = told.scores * _inflation(seen.weight)
    return Covariance(
        bread=_inverse_at_size(told.system, state),
        scatter=np.sum([scatter_of(scores, cluster) for cluster in clusters], axis=0),
    )


def find_curved_covariance(
    state: State,
    seen: Observations,
    freedom: Freedom,
    *,
    clusters: tuple[Ints, Ints],
    loss_scale: float,
    least_curvature: float,
) -> CurvedCovariance:
    """Return the covariance of the free unknowns at a minimum of the robust cost.

    clusters: as of `find_covariance`. least_curvature: of the cost in any direction, as a share of
        what it would be with weights that stay as they are.

    Cauchy's loss w s^2 log(1 + r'r / s^2) has the curvature u (I - 2 u r r' / (w s^2)) where its
    weight is u = w / (1 + r'r / s^2). With residuals and derivatives weighed by sqrt(u), as
    everywhere here, what is missing in the reduced system is the sum of 2 / (w s^2) q q' over all
    detections, q being what each adds to the gradient of the cameras.
    """
    told = _all_that_is_told(state, seen, freedom, loss_scale, curved=True)
    bread = _inverse_at_size(_less_curved(told.system, told.bent, least_curvature), state)
    scatters = np.stack([scatter_of(told.scores, cluster) for cluster in clusters])
    first, second = clusters
    both = scatter_of(told.scores, first * (second.max() + 1) + second)
    # in standard deviations of independent errors, so that all directions count alike
    twice = float(np.trace(bread @ both) / max(np.einsum("ij,cji->", bread, scatters), 1e-300))
    # the whole is not less than what is in both parts
    return CurvedCovariance(bread @ scatters @ bread, once=min(1.0, max(1 - twice, twice)))


def _less_curved(system: Floats, bent: Floats, least: float) -> Floats:
    """Return a reduced system `[free, free]` without a part of it, at least a share in each way.

    bent: `[free, free]` the part.
    """
    stiffness = np.diag(system)
    scale = np.sqrt(np.maximum(stiffness, 1e-15 * stiffness.max()))
    values, vectors = np.linalg.eigh(system / scale / scale[:, None])
    root = np.sqrt(np.maximum(values, 1e-13 * values.max()))
    whitening = vectors / root / scale[:, None]
    shares, ways = np.linalg.eigh(np.eye(len(system)) - whitening.T @ bent @ whitening)
    half = scale[:, None] * (vectors * root) @ ways
    return np.asarray((half * np.maximum(shares, least)) @ half.T)


@dataclass(frozen=True)
class _Told:
    """What detections of points tell of the free unknowns, with the points eliminated.

    system: `[free, free]` the reduced camera system.
    scores: `[free, N]` what the detections of each point add to the gradient.
    bent: `[free, free]` what the curvature of the cost is less than the system by; 0 where it was
        not asked for.
    """

    system: Floats
    scores: Floats
    bent: Floats


def _all_that_is_told(
    state: State, seen: Observations, freedom: Freedom, loss_scale: float, *, curved: bool
) -> _Told:
    """Return what all points tell, and what is known of the intrinsics beforehand."""
    work = partial(
        _told_by, state=state, seen=seen, basis=freedom.basis, loss_scale=loss_scale, curved=curved
    )
    parts = list(map_in_threads(work, blocks_of(state.points)))
    known = prior_of(freedom, state)[0].reshape(-1, 1) * freedom.basis
    return _Told(
        system=np.sum([part.system for part in parts], axis=0) + freedom.basis.T @ known,
        scores=np.concatenate([part.scores for part in parts], axis=1),
        bent=np.sum([part.bent for part in parts], axis=0),
    )


def _told_by(
    block: slice,
    *,
    state: State,
    seen: Observations,
    basis: Floats,
    loss_scale: float,
    curved: bool,
) -> _Told:
    """Return what a block of points tells."""
    part = part_of(block, state, seen)
    block, state, seen = part.block, part.state, part.seen
    rows = 6 + state.intrinsics.shape[1]
    basis = basis.reshape(-1, rows, basis.shape[1])[part.views].reshape(-1, basis.shape[1])
    found, robust, slopes = slopes_of(block, state, seen, loss_scale)
    residual = found.residual * robust[:, None]
    equations = equations_of(state.rotation, found.in_camera, slopes, residual)
    inverse, system, _ = eliminate_points(equations)
    own, pull = _gradients(state.rotation, found.in_camera, slopes, residual)
    # how far each detection moves its point: the points go where the others want them
    moved = np.einsum("ijn,vjn->vin", inverse, pull)
    scores = own - np.einsum("vcin,in->vcn", equations.mixed, moved.sum(0))
    bent = np.zeros_like(system)
    if curved:
        weight = seen.weight[:, block]
        share = np.where(weight > 0, 2 / (np.where(weight > 0, weight, 1.0) * loss_scale**2), 0.0)
        bent = _bent(equations.mixed, own, moved, share)
    return _Told(
        system=basis.T @ system @ basis,
        scores=basis.T @ scores.reshape(len(basis), -1),
        bent=basis.T @ bent @ basis,
    )


def _gradients(
    rotation: Floats, in_camera: Floats, slopes: Slopes, residual: Floats
) -> tuple[Floats, Floats]:
    """Return what each detection adds to the gradients of its camera and its point.

    `[view, C, n]` and `[view, 3, n]`; in_camera: `[view, 3, n]`, residual: `[view, 2, n]`.
    """
    force = np.einsum("vkin,vkn->vin", slopes.in_camera, residual)  # in the frame of the camera
    turning = np.cross(in_camera, force, axis=1)
    intrinsics = np.einsum("vkin,vkn->vin", slopes.intrinsics, residual)
    own = np.concatenate([turning, force, intrinsics], axis=1)
    return own, np.matmul(np.swapaxes(rotation, 1, 2), force)


def _bent(mixed: Floats, own: Floats, moved: Floats, share: Floats) -> Floats:
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


def _inflation(weight: Floats) -> Floats:
    """Return by how much residuals of a point are too small: three of its numbers bend to them."""
    numbers = np.maximum(2 * (weight > 0).sum(0), 4)
    return np.asarray(np.sqrt(numbers / (numbers - 3)))


def scatter_of(scores: Floats, cluster: Ints) -> Floats:
    """Return the scatter `[free, free]` of the summed scores of clusters.

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
    # what nothing determines is as uncertain as can be told, not certain
    inverse = (vectors / np.maximum(values, 1e-13 * values.max())) @ vectors.T
    return scale[:, None] * inverse * scale
