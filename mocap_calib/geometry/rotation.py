"""Rotations and similarities: batched rotations, best alignment of points, and sizes.

A similarity of the world changes the place, turn and size of a rig, and these mean nothing. How far
cameras are from where they should be is what is left after the best similarity between two rigs.
"""

from typing import NamedTuple

import numpy as np

from mocap_calib import mapped
from mocap_calib.errors import DegenerateError
from mocap_calib.types import POSE, CameraRig, Floats


def matrix_from_vector(vector: Floats) -> Floats:
    """Return the matrices `[..., 3, 3]` of rotation vectors `[..., 3]` in radians.

    Rodrigues' formula, R = I + sin(a)/a [v]x + (1 - cos(a))/a^2 [v]x^2.
    """
    vector = np.asarray(vector, dtype=np.float64)
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    # both factors by np.sinc, which is exact near zero
    safe_angle = np.where(angle > 0, angle, 1.0)
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(safe_angle / (2 * np.pi)) ** 2
    cross = skew(vector)
    return np.eye(3) + first * cross + second * (cross @ cross)


def vector_from_matrix(matrix: Floats) -> Floats:
    """Return the rotation vectors `[..., 3]`, of length 0..pi, of rotation matrices `[..., 3, 3]`.

    Through unit quaternions, which are exact near zero and near a half turn.
    """
    quaternion = quaternion_from_matrix(matrix)
    cosine = quaternion[..., 0]
    axis = quaternion[..., 1:]
    sine = np.linalg.norm(axis, axis=-1)
    angle = 2 * np.arctan2(sine, cosine)
    safe_sine = np.where(sine > 1e-12, sine, 1.0)
    factor = np.where(sine > 1e-12, angle / safe_sine, 2.0)
    return factor[..., None] * axis


def quaternion_from_matrix(matrix: Floats) -> Floats:
    """Return the unit quaternions `[..., 4]` (w, x, y, z), w >= 0, of rotations `[..., 3, 3]`.

    Each row of the 4 x 4 array below is 4 q_k q; the one with the largest q_k is the best
    conditioned (Shepperd 1978).
    """
    m = np.asarray(matrix, dtype=np.float64)
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    wx = m[..., 2, 1] - m[..., 1, 2]
    wy = m[..., 0, 2] - m[..., 2, 0]
    wz = m[..., 1, 0] - m[..., 0, 1]
    xy = m[..., 0, 1] + m[..., 1, 0]
    xz = m[..., 0, 2] + m[..., 2, 0]
    yz = m[..., 1, 2] + m[..., 2, 1]
    by_w = np.stack([1 + xx + yy + zz, wx, wy, wz], -1)
    by_x = np.stack([wx, 1 + xx - yy - zz, xy, xz], -1)
    by_y = np.stack([wy, xy, 1 - xx + yy - zz, yz], -1)
    by_z = np.stack([wz, xz, yz, 1 - xx - yy + zz], -1)
    rows = np.stack([by_w, by_x, by_y, by_z], -2)
    best = np.argmax(np.diagonal(rows, axis1=-2, axis2=-1), axis=-1)
    quaternion = np.take_along_axis(rows, best[..., None, None], axis=-2)[..., 0, :]
    quaternion = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
    return np.where(quaternion[..., :1] < 0, -quaternion, quaternion)


def skew(vector: Floats) -> Floats:
    """Return the matrices `[..., 3, 3]` of the cross products with vectors `[..., 3]`.

    [a]x b = a x b.
    """
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    zero = np.zeros_like(x)
    rows = [
        np.stack([zero, -z, y], -1),
        np.stack([z, zero, -x], -1),
        np.stack([-y, x, zero], -1),
    ]
    return np.stack(rows, -2)


def angle_between(first: Floats, second: Floats) -> Floats:
    """Return the geodesic distance `[...]` in radians between rotations `[..., 3, 3]`.

    From the chord |R - I| = sqrt(8) sin(a/2), which is exact also for tiny angles.
    """
    relative = np.swapaxes(first, -1, -2) @ second
    half_sine = np.linalg.norm(relative - np.eye(3), axis=(-2, -1)) / np.sqrt(8.0)
    return 2 * np.arcsin(np.clip(half_sine, 0.0, 1.0))


def direction_angle(first: Floats, second: Floats) -> Floats:
    """Return the angle `[...]` in radians between vectors `[..., 3]` of any length.

    It is pi where one of them has no length.
    """
    sine = np.linalg.norm(np.cross(first, second), axis=-1)
    cosine = (first * second).sum(-1)
    undefined = (sine == 0) & (cosine == 0)
    return np.where(undefined, np.pi, np.arctan2(sine, cosine))


def nearest_rotation(matrix: Floats) -> Floats:
    """Return the rotations `[..., 3, 3]` that maximise tr(R' M), for matrices M `[..., 3, 3]`.

    Kabsch 1976, with the sign of Umeyama 1991.
    """
    u, _, vt = np.linalg.svd(matrix)
    sign = np.linalg.det(u) * np.linalg.det(vt)
    last = u[..., 2:] * sign[..., None, None]
    proper = np.concatenate([u[..., :2], last], axis=-1)
    return proper @ vt


def looking_along(direction: Floats, down: Floats) -> Floats:
    """Return the rotations `[..., 3, 3]` into axes that look along directions `[..., 3]`.

    The new z is along `direction`, and y is as near to `down` `[..., 3]` as it can be. Where the
    direction is along `down`, the new x is near to the old one.
    """
    z = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    x = np.cross(down, z)
    length = np.linalg.norm(x, axis=-1, keepdims=True)
    x = np.where(length > 1e-6, x / np.maximum(length, 1e-6), np.array([1.0, 0.0, 0.0]))
    y = np.cross(z, x)
    y /= np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack([np.cross(y, z), y, z], axis=-2)


class Similarity(NamedTuple):
    """How points move: x' = scale R x + shift, with a rotation `[3, 3]` and a shift `[3]`."""

    scale: float
    rotation: Floats
    shift: Floats

    def apply(self, points: Floats) -> Floats:
        """Return points `[..., 3]` where they are then."""
        return self.scale * points @ self.rotation.T + self.shift


def align_by_similarity(source: Floats, target: Floats) -> Similarity:
    """Return the similarity s, R, t that minimises sum |s R x + t - y|^2.

    source: `[N, 3]` points x. target: `[N, 3]` points y (Umeyama 1991, eqs. 38-42).

    Raises DegenerateError where all source points coincide.
    """
    source_mean = source.mean(0)
    target_mean = target.mean(0)
    x = source - source_mean
    y = target - target_mean
    variance = (x**2).sum()
    if variance < 1e-18:
        raise DegenerateError(
            "alignment", "points in different places", "all of them in one", "use other points"
        )
    rotation = nearest_rotation(y.T @ x)
    scale = float(np.trace(rotation @ x.T @ y) / variance)
    shift = target_mean - scale * rotation @ source_mean
    return Similarity(scale, rotation, shift)


def rig_change(before: CameraRig, after: CameraRig) -> Floats:
    """Return how cameras turn and shift from one rig to another, after the best similarity.

    `[view, 6]`: turns about the axes of the world of the first rig (3, radians), and shifts of the
    centres (3, in sizes of the rig). Both rigs have the same cameras; their first cameras are
    about the same, so that the worlds are.
    """
    turn = vector_from_matrix(np.swapaxes(before.rotation, 1, 2) @ after.rotation)
    scale = rig_size(before) / rig_size(after)
    offsets = [rig.centres - rig.centres.mean(0) for rig in (before, after)]
    shift = (scale * offsets[1] - offsets[0]) / rig_size(before)
    return project_out_similarity(np.concatenate([turn, shift], axis=1), before)


def with_size_of(reference: CameraRig, rig: CameraRig) -> CameraRig:
    """Return the rig at the size of a reference, the first camera where the reference has it."""
    first = reference.centres[0]
    size = np.sqrt(((rig.centres - first) ** 2).sum())
    reference_size = np.sqrt(((reference.centres - first) ** 2).sum())
    centres = first + (rig.centres - first) * (reference_size / size)
    return rig.stand(rig.rotation, centres)


def project_out_similarity(change: Floats, rig: CameraRig) -> Floats:
    """Return what is left of changes of cameras when the best similarity is taken out.

    change: `[view, 6, ...]` turns about the axes of the world (radians) and shifts of the centres,
        in sizes of the rig.
    """
    flat = change.reshape(POSE * len(rig.cameras), -1)
    basis, _ = np.linalg.qr(gauge_of(rig).reshape(len(flat), 7))
    return np.asarray((flat - basis @ (basis.T @ flat)).reshape(change.shape))


def gauge_of(rig: CameraRig) -> Floats:
    """Return the changes `[view, 6, 7]` that similarities of the world make of all cameras.

    Turns about the axes of the world, shifts in sizes of the rig, as of `RigCovariance`.
    """
    offset = (rig.centres - rig.centres.mean(0)) / rig_size(rig)
    gauge = np.zeros((len(rig.cameras), POSE, 7))
    gauge[:, :3, :3] = -np.eye(3)  # the world turns by phi: all cameras turn by -phi ...
    gauge[:, 3:, :3] = -skew(offset)  # ... and their centres go about its middle
    gauge[:, 3:, 3:-1] = np.eye(3)
    gauge[:, 3:, -1] = offset
    return gauge


def rig_size(rig: CameraRig) -> float:
    """Return the RMS distance of the centres of a rig from their middle, in its unit."""
    offset = rig.centres - rig.centres.mean(0)
    return float(np.sqrt((offset**2).sum(1).mean()))


def mean_of_known(values: Floats, axis: int) -> Floats:
    """Return the mean over an axis of the values that are not NaN; NaN where there is none."""
    known = np.isfinite(values)
    count = known.sum(axis)
    total = np.where(known, values, 0.0).sum(axis)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def body_size(points: Floats) -> float:
    """Return the RMS distance of joints `[..., keypoint, 3]` from their middle, the median body's.

    Of the bodies that have half of their joints, and three; where there is none, of those that
    have three, or all where joints are fewer. NaN without bodies. A long recording, the first axis,
    is looked at in some of its frames.
    """
    keypoints = points.shape[-2]
    points = mapped.some_frames(points).reshape(-1, keypoints, 3)
    count, size = np.zeros(len(points), dtype=np.int64), np.zeros(len(points))
    for block in mapped.frame_slices(len(points)):
        bodies = points[block]
        count[block] = np.isfinite(bodies[..., 0]).sum(-1)
        square = ((bodies - mean_of_known(bodies, 1)[:, None]) ** 2).sum(-1)
        size[block] = np.sqrt(mean_of_known(square, 1))
    for least in (max(3, keypoints // 2), min(3, keypoints)):
        enough = count >= least
        if enough.any():
            return float(np.median(size[enough]))
    return float("nan")


def quarter_turn(rotation: Floats, others: Floats, upright_deg: float) -> int:
    """Return the quarter turn (degrees, clockwise) by which a camera's images are rotated, or 0.

    Against the down of the others' images, which must agree among themselves; 0 where they do not,
    or where any looks up or down. rotation: `[3, 3]`; others: `[view, 3, 3]`. upright_deg: by which
    upright cameras roll at most.
    """
    down = np.array([*others, rotation]) @ others[:, 1].mean(0)
    x, y, z = down.T
    *among, own = np.where(np.hypot(x, y) < np.abs(z), np.inf, np.degrees(np.arctan2(-x, y)))
    if np.abs(among).max() >= upright_deg or not np.isfinite(own):
        return 0
    quarters = round(own / 90)
    return 90 * quarters % 360 if abs(own - 90 * quarters) < upright_deg else 0
