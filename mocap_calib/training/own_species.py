"""Vocabulary and training poses of a species from the 3D poses of a calibrated recording.

So a model can be trained where there was none to begin with: the recording is calibrated by
geometry alone, and its poses train the model.
"""

import numpy as np

from mocap_calib.config import OWN_SPECIES_LARGEST_ERROR, OWN_SPECIES_LEAST_POSES, TRAINING_JOINTS
from mocap_calib.errors import DegenerateError
from mocap_calib.geometry.graphs import spanning_tree
from mocap_calib.geometry.rotation import looking_along
from mocap_calib.recording.joints import match_names
from mocap_calib.recording.skeleton_fields import parse_skeleton
from mocap_calib.training.poses import PoseSet, Split, every_tenth, parse_up
from mocap_calib.types import CameraRig, Floats, Poses3D, Skeleton


def up_of_rig(rig: CameraRig) -> Floats:
    """Return the direction `[3]` that is up if the cameras stand upright.

    It is opposite to the mean of their y axes, in the axes of the rig.
    """
    up = -rig.rotation[:, 1].mean(0)
    return up / np.linalg.norm(up)


def up_direction(up: str) -> Floats:
    """Return the unit vector `[3]` of an axis: +x, -y, ... Raises FormatError."""
    column, sign = parse_up(up)
    return sign * np.eye(3)[column]


def own_poses(poses: Poses3D, skeleton: Skeleton, up: Floats, split: Split) -> PoseSet:
    """Return the well triangulated poses of all individuals, +z up, 7:2:1 by blocks of time.

    up: `[3]` the direction that is up, in the axes of the poses.

    Raises DegenerateError where they are too few to learn from.
    """
    bodies = _well_triangulated(poses)[every_tenth(len(poses.frames), split)]
    bodies = bodies.reshape(-1, *bodies.shape[2:])  # [pose, keypoint, 3]
    found = match_names(poses.keypoints, skeleton)
    joints = np.full((len(bodies), len(skeleton.keypoints), 3), np.nan)
    joints[:, found[found >= 0]] = bodies[:, found >= 0]
    least_joints = max(TRAINING_JOINTS, int((found >= 0).sum()) // 2)
    enough = np.isfinite(joints[..., 0]).sum(1) >= least_joints
    count = int(enough.sum())
    if count < OWN_SPECIES_LEAST_POSES:
        raise DegenerateError(
            f"expected at least {OWN_SPECIES_LEAST_POSES} whole 3D poses to {split} on, "
            f"found {count}; record longer"
        )
    upright = looking_along(up[None], np.array([0.0, 0.0, 1.0]))[0]  # its third axis is up
    return PoseSet(joints[enough] @ upright.T, np.full(count, 1.0 / count))


def _well_triangulated(poses: Poses3D) -> Floats:
    """Return the positions `[frame, individual, keypoint, 3]`, NaN where their error is large."""
    largest = OWN_SPECIES_LARGEST_ERROR * _median(poses.error, axis=(0, 1, 2))
    return np.where((poses.error <= largest)[..., None], poses.positions, np.nan)


def own_skeleton(name: str, poses: Poses3D) -> Skeleton:
    """Return a skeleton of the keypoints that have points, joined into a tree by what is rigid.

    The bones are those that change their length least: a minimum spanning tree.

    Raises DegenerateError where no pose has enough points.
    """
    known = np.isfinite(poses.positions[..., 0])
    most = int(known.sum(-1).max(initial=0))
    if most < TRAINING_JOINTS:
        raise DegenerateError(
            f"expected poses with at least {TRAINING_JOINTS} keypoints in 3D to learn from, "
            f"found {most} at most; record longer"
        )
    seen = np.flatnonzero(known.any((0, 1)))
    keypoints = [poses.keypoints[keypoint] for keypoint in seen]
    spread, length = _lengths(poses.positions[:, :, seen])
    spread = np.nan_to_num(spread, nan=np.nanmax(spread))
    root = int(np.nanmean(length, axis=1).argmin())  # the most central keypoint
    tree = spanning_tree(spread, root).tolist()
    edges = [[keypoints[parent], keypoints[child]] for parent, child in tree]
    return parse_skeleton({"name": name, "keypoints": keypoints, "edges": edges}, name)


def _lengths(positions: Floats) -> tuple[Floats, Floats]:
    """Return the spread and the typical value `[keypoint, keypoint]` of distances of keypoints.

    positions: `[frame, individual, keypoint, 3]`. In sizes of the individual, by medians: some
    points are wrong, and some individuals are children. NaN where two are never seen together.
    """
    count = positions.shape[2]
    length = np.full((count, *positions.shape[:3]), np.nan)
    for k in range(count):
        length[k] = np.linalg.norm(positions - positions[:, :, k : k + 1], axis=-1)
    size = _median(length, axis=(0, 1, 3))[0, 0]  # [individual, 1]
    length = length / np.where(size > 0, size, np.nan)
    typical = _median(length, axis=(1,))
    spread = _median(np.abs(length - typical), axis=(1, 2))
    return spread[:, 0, 0], _median(typical, axis=(1, 2))[:, 0, 0]


def _median(values: Floats, axis: tuple[int, ...]) -> Floats:
    """Return the medians of what is known along axes, which are kept; NaN where nothing is."""
    unknown = np.isnan(values).all(axis, keepdims=True)
    medians = np.nanmedian(np.where(unknown, 0.0, values), axis=axis, keepdims=True)
    return np.where(unknown, np.nan, medians)
