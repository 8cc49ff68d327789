"""Bring what cameras saw at times of their own to the time of the first camera.

A detection moves in the image as its triangulated point moves in the offset of the camera's clock:
a prediction of motion in 3D. Images are not interpolated.
"""

from dataclasses import replace

import numpy as np

from mocap_calib.config import TriangulateConfig
from mocap_calib.geometry import lens
from mocap_calib.multi_view.motion import Motion, motion_between, usual_step
from mocap_calib.multi_view.triangulation import triangulate
from mocap_calib.types import CameraRig, Floats, Ints, Matches, Poses3D, Reals, Recording

_PASSES = 2  # the second triangulates what the first has brought nearer together
_BLOCK = 1000  # frames at a time


def bring_in_step(
    recording: Recording, rig: CameraRig, matches: Matches, tau: Floats, config: TriangulateConfig
) -> Recording:
    """Return the recording with detections as the cameras would have seen them at one time.

    tau: `[view]` frames by which a camera's images are later than those of the same number of a
    camera whose offset is 0. Detections of nobody, and of points that are not known or whose
    motion is not, stay as they are.
    """
    in_step = recording
    for _ in range(_PASSES):
        poses = triangulate(in_step, rig, matches, config)
        positions = recording.positions.copy()
        for view in np.flatnonzero(tau):
            _move_view(positions[view], matches.labels[view], rig, view, poses, float(tau[view]))
        in_step = replace(recording, positions=positions)
    return in_step


def _move_view(
    detections: Reals, labels: Ints, rig: CameraRig, view: int, poses: Poses3D, offset: float
) -> None:
    """Move the detections `[frame, instance, keypoint, 2]` of a view to the time of the poses.

    labels: `[frame, instance]` the individual that each is of.
    """
    frames = len(poses.frames)
    for start in range(0, frames, _BLOCK):
        block = np.arange(start, min(start + _BLOCK, frames))
        shift = _image_motion(rig, view, poses, block, offset)
        frame, instance = np.nonzero(labels[block] >= 0)
        of_detection = shift[frame, labels[block][frame, instance]]
        detections[block[frame], instance] -= np.nan_to_num(of_detection).astype(detections.dtype)


def _image_motion(rig: CameraRig, view: int, poses: Poses3D, block: Ints, offset: float) -> Floats:
    """Return how far poses of some frames move in a view's images in an offset in frames.

    `[frame, individual, keypoint, 2]` in pixels, NaN where it is not known.
    """
    points = poses.positions[block].reshape(-1, 3).T
    moved = points + motion_of(poses, block).displacement(np.array([offset]))[0]
    rotation, translation = rig.rotation[view], rig.translation[view][:, None]
    now, then = (
        lens.project(rig.cameras[view], rotation @ where + translation) for where in (points, moved)
    )
    return (then - now).T.reshape(*poses.positions[block].shape[:3], 2)


def motion_of(poses: Poses3D, block: Ints) -> Motion:
    """Return how the points of some frames move, in the order frame, individual, keypoint.

    block: `[frame]` indices, one after the other. Where a neighbour is not known, or its frame
    does not follow, a point moves as the other one says; NaN where neither is.
    """
    step = usual_step(poses.frames)
    from_last = _steps(poses, block - 1, step)
    to_next = _steps(poses, block, step)
    from_last, to_next = (
        np.where(np.isfinite(one), one, other)
        for one, other in ((from_last, to_next), (to_next, from_last))
    )
    return motion_between(-from_last, np.zeros_like(to_next), to_next, step)


def _steps(poses: Poses3D, first: Ints, step: int) -> Floats:
    """Return how far points move from frames (`[frame]` indices) to those that follow, `[3, N]`.

    NaN where there is none that follows by `step`.
    """
    last = len(poses.frames) - 1
    here, there = np.clip(first, 0, last), np.clip(first + 1, 0, last)
    follows = poses.frames[there] - poses.frames[here] == step
    moved = poses.positions[there] - poses.positions[here]
    return np.where(follows[:, None, None, None], moved, np.nan).reshape(-1, 3).T
