"""Similarities: their best alignment of points, what they change of a rig, and sizes.

A similarity of the world changes the place, turn and size of a rig, and these mean nothing. How far
cameras are from where they should be is what is left after the best similarity between two rigs.
"""

from typing import NamedTuple

import numpy as np

from mocap_calib import mapped
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.rotation import (
    matrix_from_vector,
    nearest_rotation,
    skew,
    vector_from_matrix,
)
from mocap_calib.types import POSE, CameraRig, Floats


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
            "alignment: expected points in different places, all of them coincide"
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


def changed_rig(rig: CameraRig, change: Floats) -> CameraRig:
    """Return a rig whose cameras were turned and shifted by changes `[view, 6]` of `rig_change`."""
    rotation = rig.rotation @ matrix_from_vector(change[:, :3])
    centres = rig.centres + rig_size(rig) * change[:, 3:]
    return rig.stand(rotation, centres)


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
