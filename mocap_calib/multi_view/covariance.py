"""The covariance of what was adjusted, which holds also where errors go together.

Errors of detections are no independent noise: those of one moment go together, and those of one
joint. The inverse of the Hessian, which knows nothing of that, is 1.5 to 10 times too sure. The
sandwich B M B is right: B is the inverse of the reduced camera system, and M the sum, over groups
whose errors go together, of what their gradients scatter by (Cameron, Gelbach and Miller 2011:
"Robust Inference With Multiway Clustering").
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib.multi_view.residuals import Observations, State, blocks_of, jacobian
from mocap_calib.multi_view.schur import Freedom, eliminate_points, linearise
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


def find_covariance(
    state: State,
    seen: Observations,
    freedom: Freedom,
    *,
    clusters: tuple[Ints, ...],
    loss_scale: float,
    cautious: bool = True,
) -> Covariance:
    """Return the covariance of the free unknowns at a minimum, at the size that the rig has.

    clusters: `[N]` numbers each; the errors of points of one number go together.
    cautious: count residuals for as much as points have absorbed of them. The derivatives without
        the points are blind to that part, so nothing is missing without it: what it adds, 1.2 to 2
        times, is a margin for what shall not be accused by mistake.
    """
    equations = linearise(state, seen, freedom, loss_scale)
    inverse, schur, _ = eliminate_points(equations, 0.0)
    centred = np.einsum("ijn,jn->in", inverse, equations.point_gradient)
    gradients = _gradients_of_points(state, seen, loss_scale)
    gradients -= np.einsum("vcin,in->vcn", equations.mixed, centred)
    scores = freedom.basis.T @ gradients.reshape(-1, gradients.shape[2])
    if cautious:
        scores *= _inflation(seen.weight)
    return Covariance(
        bread=_inverse_at_size(freedom.basis.T @ schur @ freedom.basis, state),
        scatter=np.sum([scatter_of(scores, cluster) for cluster in clusters], axis=0),
    )


def _gradients_of_points(state: State, seen: Observations, loss_scale: float) -> Floats:
    """Return what each point adds to the gradient of the cameras, `[view, C, N]`."""
    parts = []
    for block in blocks_of(state.points):
        found = jacobian(block, state, seen, loss_scale)
        parts.append(np.einsum("vkcn,vkn->vcn", found.camera, found.residual))
    return np.concatenate(parts, axis=2)


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
