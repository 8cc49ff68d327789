"""A species' own vocabulary and training poses, from the 3D poses of a calibrated recording: the loop that needs no model to begin with."""

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

from mocap_calib.errors import DegenerateError, FormatError
from mocap_calib.geometry.rotation import looking_along
from mocap_calib.recording.joints import match_names, parse_skeleton
from mocap_calib.steerpose.training.poses import UP, PoseSet, Split, every_tenth
from mocap_calib.types import CameraRig, Floats, Poses3D, Skeleton

# of TrainConfig: nobody has said how the species is looked at, or that it has knees
TRAINING = {"elevation_deg": [-60, 88], "roll_deg": 20, "straighten": 0}
_LEAST_JOINTS = 4
_LEAST_POSES = 20
_FAR = 3.0  # usual reprojection errors


def up_of_rig(rig: CameraRig) -> Floats:
    """`[3]` the direction that is up if the cameras stand upright: against the mean of their y axes."""
    up = -rig.rotation[:, 1].mean(0)
    return up / np.linalg.norm(up)


def axis(name: str) -> Floats:
    """`[3]` of +x, -y, ... Raises FormatError."""
    if name not in UP:
        raise FormatError(f"up axis: expected one of {', '.join(UP)}, found {name}")
    column, sign = UP[name]
    return sign * np.eye(3)[column]


def own_poses(poses: Poses3D, skeleton: Skeleton, up: Floats, split: Split) -> PoseSet:
    """The well triangulated poses of all individuals, +z up, 7:2:1 by blocks of time; up: `[3]` in the axes of the poses.

    Raises DegenerateError where they are too few to learn from.
    """
    good = poses.error <= _FAR * np.nanmedian(poses.error)
    bodies = np.where(good[..., None], poses.positions, np.nan)[
        every_tenth(len(poses.frames), split)
    ]
    bodies = bodies.reshape(-1, *bodies.shape[2:])
    found = match_names(poses.keypoints, skeleton)
    joints = np.full((len(bodies), len(skeleton.keypoints), 3), np.nan)
    joints[:, found[found >= 0]] = bodies[:, found >= 0]
    enough = np.isfinite(joints[..., 0]).sum(1) >= max(_LEAST_JOINTS, len(poses.keypoints) // 2)
    if enough.sum() < _LEAST_POSES:
        raise DegenerateError(
            f"expected at least {_LEAST_POSES} whole 3D poses to {split} on, found {enough.sum()}; record longer"
        )
    upright = looking_along(up[None], np.array([0.0, 0.0, 1.0]))[0]  # its third axis is up
    return PoseSet(joints[enough] @ upright.T, np.full(int(enough.sum()), 1.0 / enough.sum()))


def own_skeleton(name: str, poses: Poses3D) -> Skeleton:
    """The keypoints of the poses, joined into a tree by what is most rigid: the bones that change their length least."""
    spread, length = _lengths(poses.positions)
    tree = minimum_spanning_tree(
        csr_array(np.triu(1e-6 + np.nan_to_num(spread, nan=np.nanmax(spread)), 1))
    )
    order, parent = breadth_first_order(
        tree, int(np.nanmean(length, axis=1).argmin()), directed=False
    )
    edges = [[poses.keypoints[parent[child]], poses.keypoints[child]] for child in order[1:]]
    return parse_skeleton({"name": name, "keypoints": list(poses.keypoints), "edges": edges}, name)


def _lengths(positions: Floats) -> tuple[Floats, Floats]:
    """`[keypoint, keypoint]` spread and typical value of the distance between two keypoints, in sizes of the individual.

    positions: `[frame, individual, keypoint, 3]`. Medians: some points are wrong, and some individuals are children.
    """
    count = positions.shape[2]
    length = np.full((count, *positions.shape[:3]), np.nan)
    for k in range(count):
        length[k] = np.linalg.norm(positions - positions[:, :, k : k + 1], axis=-1)
    size = np.nanmedian(length, axis=(0, 1, 3))
    length = length / size[:, None]
    typical = np.nanmedian(length, axis=1, keepdims=True)
    return np.nanmedian(np.abs(length - typical), axis=(1, 2)), np.nanmedian(typical, axis=(1, 2))
