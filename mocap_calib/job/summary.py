"""What the files of a recording gave, and what of it is not used: for messages."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_calib import mapped
from mocap_calib.config import LEAST_JOINTS
from mocap_calib.recording.names import unshared_keypoints, views_with_detections
from mocap_calib.recording.synchronise import JoinedViews
from mocap_calib.types import Camera, Keypoints2D, Recording


@dataclass(frozen=True)
class CameraSummary:
    """The keypoints of one camera: where they come from, and how many there are."""

    camera: str
    source: str
    frames: int
    detections: int


@dataclass(frozen=True)
class RecordingSummary:
    """What the files of a recording gave, and what of it is not used.

    cameras: those with keypoints, in the order of the intrinsics.
    without_keypoints: names of cameras that no keypoint file belongs to.
    left_out: names of cameras in which nothing was detected.
    lone_detections: number of detections in frames that no second camera has.
    frames: number of frames of the recording.
    keypoints: names of its joints. unknown: those that the model does not know.
    single_camera_joints: name of joint -> the one camera that names it; not used.
    skeleton: name of the skeleton of the model.
    camera_notes: what the file of the cameras lacks, a line each.
    ignored_files: keypoint files beside which another file of the same name was read.
    filled_in: a line for each camera with keypoints that were completed, not measured.
    unknown_cameras: names of keypoint files that no camera of the rig belongs to.
    """

    cameras: tuple[CameraSummary, ...]
    without_keypoints: tuple[str, ...]
    left_out: tuple[str, ...]
    lone_detections: int
    frames: int
    keypoints: tuple[str, ...]
    unknown: tuple[str, ...]
    single_camera_joints: Mapping[str, str]
    skeleton: str
    camera_notes: tuple[str, ...] = ()
    ignored_files: tuple[str, ...] = ()
    filled_in: tuple[str, ...] = ()
    unknown_cameras: tuple[str, ...] = ()

    @property
    def known(self) -> int:
        """Number of joints of the recording that the model knows."""
        return len(self.keypoints) - len(self.unknown)

    @property
    def too_few_known_joints(self) -> bool:
        """Whether the model knows too few joints to help."""
        return self.known < LEAST_JOINTS


def summarise_recording(
    recording: Recording, joined: JoinedViews, cameras: Sequence[Camera]
) -> RecordingSummary:
    """Return what a recording took of the views and the cameras it was made of."""
    found = {}
    for view, name in zip(joined.files, joined.camera_names, strict=True):
        found[name] = CameraSummary(name, view.source, len(view.frames), count_detections(view))
    unshared = unshared_keypoints(views_with_detections(joined.files), joined.meanings)
    names = [camera.name for camera in cameras]
    joints = zip(recording.keypoints, recording.vocabulary, strict=True)
    return RecordingSummary(
        cameras=tuple(found[name] for name in names if name in found),
        without_keypoints=tuple(name for name in names if name not in found),
        left_out=tuple(name for name in names if name not in recording.names),
        lone_detections=_count_lone_detections(joined.files, recording),
        frames=len(recording.frames),
        keypoints=recording.keypoints,
        unknown=tuple(name for name, joint in joints if joint < 0),
        single_camera_joints=unshared,
        skeleton=joined.skeleton.name,
    )


def count_detections(view: Keypoints2D) -> int:
    """Return the number of instances, in all frames, that have any keypoint."""
    blocks = mapped.frame_slices(len(view.frames))
    return sum(int(np.isfinite(view.positions[block, ..., 0]).any(-1).sum()) for block in blocks)


def _count_lone_detections(views: Sequence[Keypoints2D], recording: Recording) -> int:
    """Return how many detections are in frames that no second camera has."""
    count = 0
    for view in views:
        lone = view.positions[~np.isin(view.frames, recording.frames), ..., 0]
        count += int(np.isfinite(lone).any(-1).sum())
    return count
