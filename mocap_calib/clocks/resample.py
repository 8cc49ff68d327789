"""Resample detections to the time of the first camera.

A detection moves in the image as its triangulated point moves in the offset of the camera's clock:
a prediction of motion in 3D. Images are not interpolated. The motion is taken to be straight:
single points show more noise than acceleration.
"""

from dataclasses import replace

import numpy as np

from mocap_calib.config import TriangulateConfig
from mocap_calib.geometry import lens
from mocap_calib.recording.sampling import usual_step
from mocap_calib.results import Matches, Poses3D
from mocap_calib.rig.triangulate import triangulate
from mocap_calib.types import CameraRig, Floats, Ints, Recording

_BLOCK = 1000  # frames at a time


def resample(
    recording: Recording, rig: CameraRig, matches: Matches, tau: Floats, config: TriangulateConfig
) -> Recording:
    """Return the recording with detections as the cameras would have seen them at one time.

    tau: `[view]` frames by which a camera's images are later than those of the same number of a
    camera whose offset is 0. Unassigned detections, and those of points that are not known or whose
    motion is not, stay as they are.
    """
    resampled = recording
    for _ in range(2):  # the second triangulates what the first has brought nearer together
        poses = triangulate(resampled, rig, matches, config)
        resampled = _move_detections(recording, rig, matches, poses, -tau)
    return resampled


def _move_detections(
    recording: Recording, rig: CameraRig, matches: Matches, poses: Poses3D, time: Floats
) -> Recording:
    """Return the recording with detections moved as their points move in a time `[view]`."""
    positions = recording.positions.copy()
    frames = len(poses.frames)
    for view in np.flatnonzero(time).tolist():
        for start in range(0, frames, _BLOCK):
            block = np.arange(start, min(start + _BLOCK, frames))
            shift = _image_motion(rig, view, poses, block, float(time[view]))
            labels = matches.labels[view, block]
            frame, instance = np.nonzero(labels >= 0)
            moved = np.nan_to_num(shift[frame, labels[frame, instance]])
            positions[view, block[frame], instance] += moved.astype(positions.dtype)
    return replace(recording, positions=positions)


def _image_motion(rig: CameraRig, view: int, poses: Poses3D, block: Ints, time: float) -> Floats:
    """Return how far poses of some frames move in a view's images in a time in frames.

    `[frame, individual, keypoint, 2]` in pixels, NaN where it is not known.
    """
    points = poses.positions[block].reshape(-1, 3).T
    moved = points + time * _velocity(poses, block)
    rotation, translation = rig.rotation[view], rig.translation[view][:, None]
    now, then = (
        lens.project(rig.cameras[view], rotation @ where + translation) for where in (points, moved)
    )
    return (then - now).T.reshape(*poses.positions[block].shape[:3], 2)


def _velocity(poses: Poses3D, block: Ints) -> Floats:
    """Return the velocity `[3, N]` of the points of some frames, in lengths by frame.

    block: `[frame]` indices, one after the other. Points are in the order frame, individual,
    keypoint. Where a neighbour is not known, or its frame does not follow, a point moves as the
    other one says; NaN where neither is.
    """
    step = usual_step(poses.frames)
    from_last = _steps(poses, block - 1, step)
    to_next = _steps(poses, block, step)
    from_last, to_next = (
        np.where(np.isfinite(one), one, other)
        for one, other in ((from_last, to_next), (to_next, from_last))
    )
    return (from_last + to_next) / (2 * step)


def _steps(poses: Poses3D, first: Ints, step: int) -> Floats:
    """Return how far points move from frames (`[frame]` indices) to those that follow, `[3, N]`.

    NaN where there is none that follows by `step`.
    """
    last = len(poses.frames) - 1
    here, there = np.clip(first, 0, last), np.clip(first + 1, 0, last)
    follows = poses.frames[there] - poses.frames[here] == step
    moved = poses.positions[there] - poses.positions[here]
    return np.where(follows[:, None, None, None], moved, np.nan).reshape(-1, 3).T
