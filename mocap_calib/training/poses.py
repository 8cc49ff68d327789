"""3D poses to train on: from files, from a skeleton's body, or from a calibrated recording.

A set may lack joints of the vocabulary: they are NaN, never seen, and no target.
"""

import io
import json
import struct
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mocap_calib.errors import DegenerateError, FormatError, MismatchError
from mocap_calib.geometry.graphs import spanning_tree
from mocap_calib.geometry.rotation import looking_along
from mocap_calib.recording.joints import match_names, parse_skeleton
from mocap_calib.results import Poses3D
from mocap_calib.synthetic.body_plan import parse_body
from mocap_calib.synthetic.procedural import sample_bodies
from mocap_calib.training.config import (
    OWN_SPECIES_LARGEST_ERROR,
    OWN_SPECIES_LEAST_POSES,
    TRAINING_JOINTS,
)
from mocap_calib.types import Bools, CameraRig, Floats, Skeleton
from mocap_calib.wording import one_line

Split = Literal["train", "val", "test"]

_UP = {  # column and sign
    "+x": (0, 1.0),
    "-x": (0, -1.0),
    "+y": (1, 1.0),
    "-y": (1, -1.0),
    "+z": (2, 1.0),
    "-z": (2, -1.0),
}
# what numpy and zipfile raise of a file that is cut, changed or none of theirs
_DAMAGED = (
    *(OSError, EOFError, ValueError, KeyError, TypeError, NotImplementedError, MemoryError),
    *(SyntaxError, RecursionError, zipfile.BadZipFile, zlib.error, struct.error),
)
_ARRAYS = ("poses", "poses3d", "joints", "split", "subject", "clip")
_OTHER_NAMES = {"poses3d": "poses", "clip": "subject"}


@dataclass(frozen=True)
class PoseSet:
    """3D poses, +z up.

    poses: `[pose, joint, 3]`, NaN = not known.
    weight: `[pose]` how often to draw each; sum 1.
    """

    poses: Floats
    weight: Floats


def load_poses(path: Path, skeleton: Skeleton, split: Split, *, up: str = "+z") -> PoseSet:
    """Read an npz file, or a folder with `poses3d.npz` and `joints.json` (`names`), in any unit.

    The file has `poses` or `poses3d` `[S, J, 3]`, `joints [J]` unless joints.json has them, and
    optionally `split` and `subject` or `clip` `[S]`. up: the axis that points up. Poses are drawn
    by subject and by the square root of its number of frames, so that one long dance does not rule.

    Raises FormatError, and MismatchError where fewer than four joints are those of the skeleton.
    """
    fields = _read(path)
    found = _match_joints(fields["joints"], skeleton, path)
    poses = fields["poses"]
    keep = fields["split"] == split if "split" in fields else every_tenth(len(poses), split)
    subject = fields.get("subject", np.zeros(len(poses), dtype=np.int64))
    known = np.flatnonzero(found >= 0)
    bodies = np.full((int(keep.sum()), len(skeleton.keypoints), 3), np.nan)
    bodies[:, found[known]] = _turn_upright(poses[keep][:, known].astype(np.float64), up)
    enough = np.isfinite(bodies).all(-1).sum(1) >= TRAINING_JOINTS
    return PoseSet(bodies[enough], _weight_by_subject(subject[keep][enough]))


def _match_joints(names: NDArray[Any], skeleton: Skeleton, path: Path) -> NDArray[np.int64]:
    """Return the index `[J]` in the skeleton of each name of a file, -1 = none.

    Raises MismatchError where fewer than four are joints of the skeleton.
    """
    found = match_names(tuple(str(name) for name in names), skeleton)
    if (found >= 0).sum() < TRAINING_JOINTS:
        raise MismatchError(
            f"{path}: expected joints of skeleton {skeleton.name}, "
            f"found {', '.join(map(str, names))}"
        )
    return found


def _weight_by_subject(subject: NDArray[Any]) -> Floats:
    """Return the weight `[pose]` that lets a subject `[pose]` count by the root of its poses."""
    _, index, count = np.unique(subject, return_inverse=True, return_counts=True)
    weight = 1.0 / np.sqrt(count[index])
    return weight / weight.sum()


def _read(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays `poses`, `joints` and what else there is. Raises FormatError."""
    try:
        fields = _read_arrays(path)
    except _DAMAGED as error:
        raise FormatError(
            f"{path}: expected an npz file of 3D poses, "
            f"or a folder with poses3d.npz and joints.json: {one_line(error, width=200)}"
        ) from None
    for other, name in _OTHER_NAMES.items():
        if other in fields:
            fields.setdefault(name, fields[other])
    if not {"poses", "joints"} <= set(fields):
        found = ", ".join(fields) or "neither"
        raise FormatError(f"{path}: expected the arrays `poses` and `joints`, found {found}")
    shape, joints = fields["poses"].shape, fields["joints"].size
    if len(shape) != 3 or shape[1:] != (joints, 3):
        raise FormatError(f"{path}: expected poses of shape (any, {joints}, 3), found {shape}")
    return fields


def _read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of a file that are known, with the names of joints.json beside it."""
    folder = path if path.is_dir() else path.parent
    file_path = path / "poses3d.npz" if path.is_dir() else path
    with np.load(io.BytesIO(file_path.read_bytes()), allow_pickle=False) as file:
        fields = {name: file[name] for name in file.files if name in _ARRAYS}
    names = folder / "joints.json"
    if "joints" not in fields and names.is_file():
        fields["joints"] = np.array(json.loads(names.read_text("utf-8"))["names"])
    return fields


def parse_up(up: str) -> tuple[int, float]:
    """Return the column and the sign of an axis that points up: +x, -y, ... Raises FormatError."""
    if up not in _UP:
        raise FormatError(f"up axis: expected one of {', '.join(_UP)}, found {up}")
    return _UP[up]


def _turn_upright(poses: Floats, up: str) -> Floats:
    """Turn the axis `up` of poses `[..., 3]` to +z. Raises FormatError."""
    column, sign = parse_up(up)
    turned = np.roll(poses, 2 - column, axis=-1)
    return turned if sign > 0 else turned * [-1.0, 1.0, -1.0]


def every_tenth(n: int, split: Split) -> Bools:
    """Return which of n frames `[n]` a split has: 7:2:1 in blocks of time.

    For sets that do not bring a split of their own.
    """
    tenth = np.arange(n) * 10 // max(n, 1)
    return {"train": tenth < 7, "val": (tenth >= 7) & (tenth < 9), "test": tenth == 9}[split]


def procedural_poses(
    skeleton: Skeleton, body: Mapping[str, Any], count: int, *, seed: int
) -> PoseSet:
    """Make `count` bodies from the section `body` of a skeleton's file. Raises FormatError."""
    poses = sample_bodies(np.random.default_rng(seed), parse_body(body, skeleton), count)
    return PoseSet(poses, np.full(count, 1.0 / count))


def mix(sets: Sequence[PoseSet], shares: Sequence[float]) -> PoseSet:
    """Return one set that draws from each of several with its share, all bodies of one size."""
    total = sum(shares)
    weights = [one.weight * share / total for one, share in zip(sets, shares, strict=True)]
    poses = [_unit_size(one.poses) for one in sets]
    return PoseSet(np.concatenate(poses), np.concatenate(weights))


def _unit_size(poses: Floats) -> Floats:
    """Return poses `[pose, joint, 3]` about their centroids with an RMS radius of 1."""
    centred = poses - np.nanmean(poses, axis=1, keepdims=True)
    radius = np.sqrt(np.nanmean((centred**2).sum(-1), axis=1))
    return centred / radius[:, None, None]


def shares_by_size(sets: Sequence[PoseSet]) -> list[float]:
    """Return shares that let each set count by the square root of its number of poses."""
    return [float(np.sqrt(len(one.poses))) for one in sets]


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
