"""The energy of poses that fit what was seen, move smoothly and have bones of constant lengths.

The energy of the points X `[keypoint, frame, 3]` of a track: the squared angles between points and
rays in standard deviations, the squared accelerations beyond what the body's joints share, and the
squared errors of the lengths of bones, all robust (Cauchy 1847; weights 1 / (1 + r^2 / c^2)).
`poses.fit` minimises it.
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib.config import PosesConfig
from mocap_calib.kernels.loading import contiguous
from mocap_calib.kernels.pose_angles import square_angles
from mocap_calib.poses.track import Body, Detections
from mocap_calib.types import Floats, Ints

SHARED_ROUNDS = 5  # after which the middle hardly moves, where most joints agree
SHARED_LEAST = 0.1  # of the mean distance from it: a joint next to it must not hold it
_TINY = 1e-100  # of an acceleration


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


def squared_errors(points: Floats, seen: Detections) -> Floats:
    """Return squared angles `[view, keypoint, frame]` between rays and points in variances."""
    found = np.empty(seen.precision.shape)
    given = points.swapaxes(1, 2), seen.rays, seen.precision, seen.centres
    square_angles(*contiguous(*given), found)
    return found


def squared_errors_at(points: Floats, seen: Detections, at: Ints) -> Floats:
    """Return `squared_errors` `[N]` at views, keypoints and frames `[3, N]` alone."""
    view, keypoint, frame = at
    offset = points[keypoint, frame].T - seen.centres[view].T
    off, _ = _off_rays(offset, seen.rays[:, view, keypoint, frame])
    return _sum_of_squares(off) * seen.precision[view, keypoint, frame]


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
