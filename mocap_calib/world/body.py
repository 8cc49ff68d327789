"""The bodies of poses: their joints, the length of their legs, and when they stand."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib import mapped
from mocap_calib.kinematics import leg_lengths
from mocap_calib.lift.weights import load_vocabulary
from mocap_calib.recording.joints import choose_skeleton, match_names
from mocap_calib.results import POINT_SOURCES, Poses3D
from mocap_calib.types import Bools, Floats, Recording, Skeleton

# joints that touch the floor, and those above them in the middle of the body, by kind of skeleton
FEET = {
    "people": ("left_ankle", "right_ankle"),
    "quadruped": ("left_back_paw", "right_back_paw", "left_front_paw", "right_front_paw"),
    "rodent": ("left_hindpaw", "right_hindpaw", "left_forepaw", "right_forepaw"),
}
_SHOULDERS = ("left_shoulder", "right_shoulder")
TRUNK = {
    "people": (*_SHOULDERS, "neck"),
    "quadruped": (
        *("spine", "croup", "neck_base", "tail_base", "left_hip", "right_hip"),
        *_SHOULDERS,
    ),
    "rodent": (
        *("spine_front", "spine_middle", "spine_back", "tail_base", "left_hip", "right_hip"),
        *_SHOULDERS,
    ),
}
_LEG = ("hip", "knee", "ankle")


@dataclass(frozen=True)
class Joints:
    """The keypoints of poses that are joints of a skeleton.

    kind: name of the skeleton ("people", "quadruped", ...).
    columns: joint -> index of the keypoint.
    """

    kind: str
    columns: dict[str, int]

    def present(self, names: Sequence[str]) -> list[int]:
        """Return the indices of the keypoints of these joints, without joints that are absent."""
        return [self.columns[name] for name in names if name in self.columns]

    @property
    def feet(self) -> list[int]:
        """Indices of the keypoints of the feet."""
        return self.present(FEET.get(self.kind, ()))

    @property
    def trunk(self) -> list[int]:
        """Indices of the keypoints of the trunk."""
        return self.present(TRUNK.get(self.kind, ()))

    @property
    def have_feet(self) -> bool:
        """Whether bodies with these joints can show a floor."""
        return len(self.feet) >= 2 and bool(self.trunk)


def find_joints(keypoints: tuple[str, ...], skeleton: Skeleton | None = None) -> Joints:
    """Return the joints that keypoints are, by their names.

    skeleton: of the model; None: the shipped one that knows most of the names.
    """
    skeleton = skeleton or choose_skeleton(keypoints)
    known = match_names(keypoints, skeleton)
    columns = {skeleton.keypoints[joint]: k for k, joint in enumerate(known) if joint >= 0}
    return Joints(skeleton.name, columns)


def joints_of_recording(recording: Recording) -> Joints:
    """Return the joints that the keypoints of a recording are, by the vocabulary of its model."""
    columns = {joint: k for k, joint in enumerate(_spell_joints(recording)) if joint}
    if not columns:
        return find_joints(recording.keypoints)
    return Joints(choose_skeleton(columns).name, columns)


def stated_joints(recording: Recording) -> tuple[str, ...]:
    """Return the joint `[keypoint]` of each keypoint, "" = none; empty where names say the same.

    Names do not say it where a user's file of names or another model does.
    """
    joints = _spell_joints(recording)
    spelt = tuple(a or b for a, b in zip(joints, recording.keypoints, strict=True))
    same = find_joints(spelt).columns == find_joints(recording.keypoints).columns
    return () if same else joints


def _spell_joints(recording: Recording) -> tuple[str, ...]:
    """Return the model's joint `[keypoint]` of each keypoint, "" = none."""
    names = load_vocabulary(recording.model).keypoints
    return tuple(names[joint] if joint >= 0 else "" for joint in recording.vocabulary)


def sample_poses(poses: Poses3D) -> Poses3D:
    """Return at most 10,000 of the frames with bodies, and of these the triangulated points.

    Points that fewer than two views saw follow from other frames and other bodies.
    """
    seen = mapped.in_blocks(
        lambda block: np.isfinite(poses.positions[block, ..., 0]).any((1, 2)), len(poses.frames)
    )
    poses = poses.select(frames=mapped.some_frames(np.flatnonzero(seen)))
    triangulated = poses.source == POINT_SOURCES.index("triangulated")
    positions = np.where(triangulated[..., None], poses.positions, np.nan)
    return replace(poses, positions=positions, raw=positions)


def distance(positions: Floats, a: int, b: int) -> Floats:
    """Return the distance `[frame, individual]` between two keypoints."""
    return np.asarray(np.linalg.norm(positions[:, :, a] - positions[:, :, b], axis=-1))


def lengths_of_legs(positions: Floats, joints: Joints) -> Floats:
    """Return the length `[individual]` of people's legs, hip to ankle; NaN = not known."""
    legs = [joints.present([f"{side}_{joint}" for joint in _LEG]) for side in ("left", "right")]
    return leg_lengths(positions, [leg for leg in legs if len(leg) == len(_LEG)])


def stand_straight(positions: Floats, joints: Joints, least: float) -> Bools:
    """Return whether people `[frame, individual]` stand on a straight leg.

    least: distance of hip and ankle, as a share of the length of the leg.
    """
    length = lengths_of_legs(positions, joints)
    straight = np.zeros(positions.shape[:2], dtype=bool)
    for side in ("left", "right"):
        ends = joints.present([f"{side}_hip", f"{side}_ankle"])
        if len(ends) == 2:
            straight |= distance(positions, *ends) > least * length
    return straight
