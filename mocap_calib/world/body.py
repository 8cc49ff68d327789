"""What the bodies of poses are: which joint is where, how large they are, when they stand."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_calib import mapped
from mocap_calib.geometry.alignment import mean_of_known
from mocap_calib.lift.weights import load_vocabulary
from mocap_calib.recording.joints import choose_skeleton, match_names
from mocap_calib.results import POINT_SOURCES, Poses3D
from mocap_calib.types import Bools, Floats, Recording, Skeleton


@dataclass(frozen=True)
class Joints:
    """Where the joints of a skeleton are among the keypoints of poses.

    kind: name of the skeleton ("people", "quadruped", ...).
    columns: joint -> index of the keypoint.
    """

    kind: str
    columns: dict[str, int]

    def present(self, names: Sequence[str]) -> list[int]:
        """Return the indices of the keypoints of these joints, without those that are absent."""
        return [self.columns[name] for name in names if name in self.columns]


def find_joints(keypoints: tuple[str, ...], skeleton: Skeleton | None = None) -> Joints:
    """Return which keypoints are which joints.

    skeleton: of the model; None: the shipped one that knows most of the names.
    """
    skeleton = skeleton or choose_skeleton(keypoints)
    known = match_names(keypoints, skeleton)
    columns = {skeleton.keypoints[joint]: k for k, joint in enumerate(known) if joint >= 0}
    return Joints(skeleton.name, columns)


def joints_of_recording(recording: Recording) -> Joints:
    """Return which keypoints of a recording are which joints, as its model calls them."""
    skeleton = load_vocabulary(recording.model)
    columns = {
        skeleton.keypoints[joint]: k for k, joint in enumerate(recording.vocabulary) if joint >= 0
    }
    if not columns:
        return find_joints(recording.keypoints)
    return Joints(choose_skeleton(columns).name, columns)


def stated_joints(recording: Recording) -> tuple[str, ...]:
    """Return the joint `[keypoint]` of each keypoint, "" = none, where their names do not say so.

    That is where a user's file of names or another model did; empty otherwise.
    """
    skeleton = load_vocabulary(recording.model)
    joints = tuple(
        skeleton.keypoints[joint] if joint >= 0 else "" for joint in recording.vocabulary
    )
    spelt = tuple(a or b for a, b in zip(joints, recording.keypoints, strict=True))
    same = find_joints(spelt).columns == find_joints(recording.keypoints).columns
    return () if same else joints


def keep_triangulated(poses: Poses3D) -> Poses3D:
    """Return poses without the points that no two views saw: these rest on other bodies."""
    seen = poses.source == POINT_SOURCES.index("triangulated")
    positions = mapped.in_blocks(
        lambda block: np.where(seen[block, ..., None], poses.positions[block], np.nan), len(seen)
    )
    return replace(poses, positions=positions, raw=positions, source=poses.source * seen)


def mean_of(positions: Floats, columns: Sequence[int]) -> Floats:
    """Return the middle `[frame, individual, 3]` of some keypoints, NaN where none is there."""
    return mapped.in_blocks(
        lambda block: mean_of_known(positions[block][:, :, list(columns)], axis=2), len(positions)
    )


def distance(positions: Floats, a: int, b: int) -> Floats:
    """Return the distance `[frame, individual]` between two keypoints."""
    return mapped.in_blocks(
        lambda block: np.linalg.norm(positions[block, :, a] - positions[block, :, b], axis=-1),
        len(positions),
    )


def leg_lengths(poses: Poses3D, joints: Joints) -> Floats:
    """Return the length `[individual]` of the legs of people, thigh and shank; NaN = not known."""
    lengths = np.full((2, poses.positions.shape[1]), np.nan)
    for k, side in enumerate(("left", "right")):
        chain = joints.present([f"{side}_{joint}" for joint in ("hip", "knee", "ankle")])
        if len(chain) == 3:
            bones = [distance(poses.positions, *pair) for pair in (chain[:2], chain[1:])]
            lengths[k] = sum(median_over_frames(bone) for bone in bones)
    return mean_of_known(lengths, axis=0)


def stand_straight(poses: Poses3D, joints: Joints, least: float) -> Bools:
    """Return in which frames which people `[frame, individual]` stand on a straight leg.

    least: share of the length of the leg that the hip is away from the ankle.
    """
    length = leg_lengths(poses, joints)
    straight = np.zeros(poses.positions.shape[:2], dtype=bool)
    for side in ("left", "right"):
        ends = joints.present([f"{side}_hip", f"{side}_ankle"])
        if len(ends) == 2:
            straight |= distance(poses.positions, *ends) > least * length
    return straight


def median_over_frames(values: Floats) -> Floats:
    """Return the median `[...]` of `[frame, ...]` values without NaN; NaN where there is none."""
    return quantile_over_frames(values, 0.5)


def quantile_over_frames(values: Floats, share: float) -> Floats:
    """Return a quantile `[...]` of `[frame, ...]` values without NaN; NaN where there is none."""
    ordered = np.sort(values, axis=0)  # NaN comes last
    count = np.isfinite(values).sum(0)
    index = np.floor(share * np.maximum(count - 1, 0)).astype(np.int64)
    found = np.take_along_axis(ordered, index[None], axis=0)[0] if len(values) else np.nan
    return np.where(count > 0, found, np.nan)
