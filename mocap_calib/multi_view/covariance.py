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

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mocap_calib.multi_view.freedom import Freedom
from mocap_calib.multi_view.residuals import Observations, State, blocks_of, jacobian
from mocap_calib.multi_view.schur import NormalEquations, eliminate_points, linearise
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
    equations = linearise(state, seen, freedom, loss_scale)
    inverse, schur, _ = eliminate_points(equations)
    centred = np.einsum("ijn,jn->in", inverse, equations.point_gradient)
    gradients, _ = _gradients(state, seen, loss_scale)
    gradients -= np.einsum("vcin,in->vcn", equations.mixed, centred)
    scores = freedom.basis.T @ gradients.reshape(-1, gradients.shape[2])
    scores *= _inflation(seen.weight)
    return Covariance(
        bread=_inverse_at_size(freedom.basis.T @ schur @ freedom.basis, state),
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
    equations = linearise(state, seen, freedom, loss_scale)
    inverse, schur, _ = eliminate_points(equations)
    by_view = _scores_by_view(state, seen, equations, inverse, loss_scale)
    rows = freedom.basis.shape[1]
    scores, bent = np.zeros((rows, seen.weight.shape[1])), np.zeros((rows, rows))
    for of_view, weight in zip(by_view, seen.weight, strict=True):
        score = freedom.basis.T @ of_view
        share = np.where(weight > 0, 2 / (np.where(weight > 0, weight, 1.0) * loss_scale**2), 0.0)
        bent += (score * share) @ score.T
        scores += score
    system = freedom.basis.T @ schur @ freedom.basis
    bread = _inverse_at_size(_less_curved(system, bent, least_curvature), state)
    scatters = np.stack([scatter_of(scores, cluster) for cluster in clusters])
    first, second = clusters
    both = scatter_of(scores, first * (second.max() + 1) + second)
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


def _scores_by_view(
    state: State,
    seen: Observations,
    equations: NormalEquations,
    inverse: Floats,
    loss_scale: float,
) -> Iterator[Floats]:
    """Yield what the detections of each view add to the gradient of all cameras, `[C view, N]`.

    With the points eliminated: they go where the others want them.
    inverse: `[3, 3, N]` of the blocks of the points.
    """
    by_camera, by_point = _gradients(state, seen, loss_scale)
    for view, (own, pull) in enumerate(zip(by_camera, by_point, strict=True)):
        moved = np.einsum("ijn,jn->in", inverse, pull)
        score = -np.einsum("vcin,in->vcn", equations.mixed, moved)
        score[view] += own
        yield score.reshape(-1, score.shape[2])


def _gradients(state: State, seen: Observations, loss_scale: float) -> tuple[Floats, Floats]:
    """Return the gradients by the camera `[view, C, N]` and by the point `[view, 3, N]`.

    Of each detection.
    """
    cameras, points = [], []
    for block in blocks_of(state.points):
        found = jacobian(block, state, seen, loss_scale)
        cameras.append(np.einsum("vkcn,vkn->vcn", found.camera, found.residual))
        points.append(np.einsum("vkcn,vkn->vcn", found.point, found.residual))
    return np.concatenate(cameras, axis=2), np.concatenate(points, axis=2)


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
