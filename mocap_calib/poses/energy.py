"""Poses that fit what was seen, move smoothly and have bones of constant lengths.

The energy of the points X `[keypoint, frame, 3]` of a track: the squared angles between points and
rays in standard deviations, the squared accelerations beyond what the body's joints share, and the
squared errors of the lengths of bones, all robust (Cauchy 1847; weights 1 / (1 + r^2 / c^2)).
Gauss-Newton: joints are coupled over time by bands, solved by `scipy.linalg.cholesky_banded` for
all joints in one call, and by bones, for which the bands precondition conjugate gradients: the cost
grows with the number of joints, not with its cube. What joints share is that of the points before
each step.
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib.config import PosesConfig
from mocap_calib.kernels.loading import compiled, contiguous
from mocap_calib.poses.track import Body, Detections
from mocap_calib.types import Floats, Ints

SHARED_ROUNDS = 5  # after which the middle hardly moves, where most joints agree
SHARED_LEAST = 0.1  # of the mean distance from it: a joint next to it must not hold it
_TINY = 1e-100  # of an acceleration
_ROUNDING = 1e-12  # of what a point is held by


@dataclass(frozen=True)
class Strengths:
    """How much counts for how much.

    acceleration: standard deviation in body sizes in the square of the usual step from frame to
        frame, beyond what the joints share, of a joint of usual agility; inf = off.
    bones: standard deviation of their lengths in body sizes, beyond what they vary by; inf = off.
    loss: error of a ray, in standard deviations, that counts by half.
    """

    acceleration: float
    bones: float
    loss: float


@dataclass(frozen=True)
class System:
    """Normal equations of a step.

    data: `[keypoint, frame, 6]` xx xy xz yy yz zz, what rays alone make of the blocks of the
        diagonal. own: the same with bones.
    pull: `[keypoint, frame]` weights of the accelerations, by the first of their frames.
    gradient: `[keypoint, frame, 3]`.
    direction: `[edge, frame, 3]` along bones, times the root of their weights.
    """

    data: Floats
    own: Floats
    pull: Floats
    gradient: Floats
    direction: Floats


def squared_errors(points: Floats, seen: Detections) -> Floats:
    """Return squared angles `[view, keypoint, frame]` between rays and points in variances."""
    kernels = compiled("mocap_calib.kernels.pose_angles")
    if kernels is None:
        return _squared_errors(points, seen)
    found = np.empty(seen.precision.shape)
    given = points.swapaxes(1, 2), seen.rays, seen.precision, seen.centres
    kernels.square_angles(*contiguous(*given), found)
    return found


def _squared_errors(points: Floats, seen: Detections) -> Floats:
    """Return what `squared_errors` returns."""
    off, _ = _off_rays(_offsets(points, seen), seen.rays)
    return _sum_of_squares(off) * seen.precision


def squared_errors_at(points: Floats, seen: Detections, at: Ints) -> Floats:
    """Return `squared_errors` `[N]` at views, keypoints and frames `[3, N]` alone."""
    view, keypoint, frame = at
    offset = points[keypoint, frame].T - seen.centres[view].T
    off, _ = _off_rays(offset, seen.rays[:, view, keypoint, frame])
    return _sum_of_squares(off) * seen.precision[view, keypoint, frame]


def _offsets(points: Floats, seen: Detections) -> Floats:
    """Return the vectors `[3, view, keypoint, frame]` from cameras to points."""
    return np.asarray(points.transpose(2, 0, 1)[:, None] - seen.centres.T[:, :, None, None])


def _off_rays(offset: Floats, rays: Floats) -> tuple[Floats, Floats]:
    """Return the tangents of angles, and the depth `[...]`, of vectors from cameras `[3, ...]`.

    The tangents are vectors `[3, ...]` at right angles to the ray. What is beside or behind a
    camera is taken to be just before it.
    """
    along = (rays * offset).sum(0)
    depth = np.maximum(along, 1e-3 * np.abs(offset).sum(0))
    return (offset - along * rays) / depth, depth


def _sum_of_squares(vectors: Floats) -> Floats:
    """Return the squared lengths `[...]` of vectors `[3, ...]`."""
    x, y, z = vectors
    return np.asarray(x * x + y * y + z * z)


def _data_terms(points: Floats, seen: Detections, loss: float) -> tuple[Floats, Floats]:
    """Return the blocks `[keypoint, frame, 6]` and the gradient `[keypoint, frame, 3]`.

    Of a ray r and the tangent u at a depth d they are w (I - r r' - r u' - u r' + u'u r r') / d^2
    and w (u - u'u r) / d: what two directions across the ray give, whichever they are.
    """
    off, depth = _off_rays(_offsets(points, seen), seen.rays)
    size = _sum_of_squares(off)
    square = size * seen.precision
    weight = seen.precision / (1 + square / loss**2) / depth
    gradient = (weight * (off - size * seen.rays)).sum(1)
    weight = weight / depth
    ray, towards = seen.rays, 2 * off + (1 - size) * seen.rays
    rows = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    both = (float(i == j) - (ray[i] * towards[j] + towards[i] * ray[j]) / 2 for i, j in rows)
    own = np.stack([(weight * part).sum(0) for part in both], axis=-1)
    # a point next to a camera is held so hard across the ray that rounding would outweigh what
    # holds it along the ray
    own[..., (0, 3, 5)] += _ROUNDING * own[..., (0, 3, 5)].sum(-1, keepdims=True)
    return own, gradient.transpose(1, 2, 0)


def linearise(
    points: Floats, seen: Detections, body: Body, strengths: Strengths, config: PosesConfig
) -> System:
    """Return the normal equations at these points."""
    data, gradient = _data_terms(points, seen, strengths.loss)
    own = data
    pull = np.zeros(points.shape[:2])
    if np.isfinite(strengths.acceleration):
        pull, slope = _motion_terms(points, body, strengths, config)
        gradient = gradient + slope
    direction = np.zeros((0, points.shape[1], 3))
    if np.isfinite(strengths.bones) and len(body.edges):
        direction, error = _bone_terms(points, body, strengths, config)
        a, b = body.edges.T
        entries = outer_products(direction)
        own = own + spread(a, entries, len(points)) + spread(b, entries, len(points))
        push = direction * error[..., None]
        gradient = gradient + spread(a, push, len(points)) - spread(b, push, len(points))
    return System(data, own, pull, gradient, direction)


def _motion_terms(
    points: Floats, body: Body, strengths: Strengths, config: PosesConfig
) -> tuple[Floats, Floats]:
    """Return the weights `[keypoint, frame]` of accelerations, by first frame, and the gradient."""
    acceleration = own_accelerations(points, body, config)
    ends = acceleration.shape[1]
    steps = body.steps[:, :ends, None]
    allowed = strengths.acceleration * body.agility[:, None] * body.size[:ends]
    precision = 1 / allowed**2
    square = (acceleration**2).sum(-1) * precision
    pull = np.zeros(points.shape[:2])
    pull[:, :ends] = precision / (1 + square / config.prior_loss**2) * (steps[0, :, 0] != 0)
    push = pull[:, :ends, None] * acceleration
    gradient = np.zeros_like(points)
    for k, step in enumerate(steps):
        gradient[:, k : k + ends] += step * push
    return pull, gradient


def accelerations(points: Floats, body: Body) -> Floats:
    """Return the accelerations `[keypoint, frame - 2, 3]` by the first of their frames.

    0 where frames do not follow each other. points: `[keypoint, frame, 3]`.
    """
    ends = max(points.shape[1] - 2, 0)
    steps = body.steps[:, :ends, None]
    parts = (step * points[:, k : k + ends] for k, step in enumerate(steps))
    return np.asarray(sum(parts))


def own_accelerations(points: Floats, body: Body, config: PosesConfig) -> Floats:
    """Return `accelerations` beyond those that the joints share."""
    acceleration = accelerations(points, body)
    return acceleration - shared_accelerations(acceleration.transpose(1, 2, 0), config)


def shared_accelerations(acceleration: Floats, config: PosesConfig) -> Floats:
    """Return what joints share `[frame, 3]` of their accelerations `[frame, 3, keypoint]`.

    Bodies speed up and slow down as a whole. It is a part of the geometric median, or nearly: of
    the point from which the sum of the distances to all accelerations is smallest, some steps from
    the mean towards it (Weiszfeld 1937). A few joints that are wrong hardly move it, and it is the
    same in all axes.
    """
    joints = acceleration.shape[2]
    middle, usual = acceleration.mean(-1), None
    for _ in range(SHARED_ROUNDS):
        off = np.sqrt(((acceleration - middle[..., None]) ** 2).sum(1))
        usual = off.mean(1) if usual is None else usual
        weight = 1 / (off + (SHARED_LEAST * usual + _TINY)[:, None])
        total = weight.sum(-1)
        middle = (acceleration * weight[:, None]).sum(-1) / total[:, None]
        usual = joints / total  # the harmonic mean, which large distances hardly raise
    return np.asarray(middle * shared_part(joints, config))


def shared_part(joints: int, config: PosesConfig) -> float:
    """Return which part of the middle of their accelerations some joints are expected to have.

    Accelerations of variance s^2 around a common one of variance v are expected to be N v / (s^2 +
    N v) of the mean of N joints.
    """
    told = joints * config.shared_acceleration
    return told / (1 + told)


def _bone_terms(
    points: Floats, body: Body, strengths: Strengths, config: PosesConfig
) -> tuple[Floats, Floats]:
    """Return directions `[edge, frame, 3]` along bones and errors `[edge, frame]` of lengths.

    Both are times the root of the weight, which is 0 where a length is not known.
    """
    along = points[body.edges[:, 0]] - points[body.edges[:, 1]]
    length = np.sqrt((along**2).sum(-1))
    known = np.isfinite(body.lengths)
    sigma = np.hypot(strengths.bones * body.size, np.where(known, body.varies, 0.0))
    error = np.nan_to_num(length - body.lengths) / sigma
    weight = known / (1 + error**2 / config.prior_loss**2)
    root = np.sqrt(weight) / sigma
    direction = along * (root / np.maximum(length, 1e-9 * body.size))[..., None]
    return direction, np.sqrt(weight) * error


def outer_products(vectors: Floats) -> Floats:
    """Return the products `[..., 6]` of vectors `[..., 3]` with themselves, xx xy xz yy yz zz."""
    return np.asarray(vectors[..., (0, 0, 0, 1, 1, 2)] * vectors[..., (0, 1, 2, 1, 2, 2)])


def spread(index: Floats, values: Floats, joints: int) -> Floats:
    """Return the sums `[keypoint, ...]` of values `[edge, ...]` over the edges of each joint."""
    incidence = (index == np.arange(joints)[:, None]).astype(np.float64)
    return (incidence @ values.reshape(len(values), -1)).reshape(joints, *values.shape[1:])


def couplings(pull: Floats, steps: Floats) -> Floats:
    """Return what accelerations couple `[3, keypoint, frame]`: a frame with 0, 1, 2 frames on.

    pull: `[keypoint, frame]` their weights. All coordinates alike.
    """
    found = np.zeros((3, *pull.shape))
    ends = max(pull.shape[1] - 2, 0)
    for i in range(3):
        for j in range(i, 3):
            found[j - i, :, i : i + ends] += (pull * steps[i] * steps[j])[:, :ends]
    return found


def _bands(system: System, body: Body, ridge: Floats) -> Floats:
    """Return the upper bands `[7, 3 N]` of the joints without what couples them.

    ridge: `[frame]` added to the diagonal.
    """
    found = np.zeros((7, *system.gradient.shape))
    same, next_one, one_after = couplings(system.pull, body.steps)
    found[6] = system.own[..., (0, 3, 5)] + (same + ridge)[..., None]
    found[5, ..., 1], found[5, ..., 2] = system.own[..., 1], system.own[..., 4]
    found[4, ..., 2] = system.own[..., 2]
    found[3, :, 1:] = next_one[:, :-1, None]
    found[0, :, 2:] = one_after[:, :-2, None]
    return found.reshape(7, -1)


def solve(system: System, body: Body, ridge: Floats, config: PosesConfig) -> Floats:
    """Return the step `[keypoint, frame, 3]` by preconditioned conjugate gradients.

    They end when the residual is small beside the gradient, both by what the bands make of them.
    """
    # slow to import, which the kernels need not pay for
    from scipy.linalg import cho_solve_banded, cholesky_banded  # noqa: PLC0415

    factor = cholesky_banded(_bands(system, body, ridge), overwrite_ab=True, check_finite=False)
    shape = system.gradient.shape

    def precondition(side: Floats) -> Floats:
        solved = cho_solve_banded((factor, False), side.reshape(-1), check_finite=False)
        return np.asarray(solved).reshape(shape)

    step = precondition(system.gradient)
    if not len(system.direction):
        return step
    a, b = body.edges.T

    def coupled(vector: Floats) -> Floats:
        """Return what the bones' coupling makes of a vector."""
        to_a = system.direction * (system.direction * vector[b]).sum(-1, keepdims=True)
        to_b = system.direction * (system.direction * vector[a]).sum(-1, keepdims=True)
        return spread(a, to_a, shape[0]) + spread(b, to_b, shape[0])

    # of M x - N x = g, with the bands M and the coupling N: M x is carried along, and never made
    residual = coupled(step)
    towards = precondition(residual)
    direction, by_bands = towards, residual
    product = float((residual * towards).sum())
    enough = config.inner_tolerance**2 * float((system.gradient * step).sum())
    for _ in range(config.inner_steps):
        if product <= enough:
            break
        image = by_bands - coupled(direction)
        length = product / float((direction * image).sum())
        step = step + length * direction
        residual = residual - length * image
        towards = precondition(residual)
        before, product = product, float((residual * towards).sum())
        direction = towards + product / before * direction
        by_bands = residual + product / before * by_bands
    return step
