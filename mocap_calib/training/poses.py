"""3D poses to train on, from files and from the `body` of a skeleton.

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

from mocap_calib.config import LEAST_JOINTS
from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.geometry.rotation import looking_along
from mocap_calib.recording.joints import match_names
from mocap_calib.synthetic.body_plan import parse_body
from mocap_calib.synthetic.procedural import sample_bodies
from mocap_calib.types import Bools, Floats, Skeleton
from mocap_calib.wording import one_line

Split = Literal["train", "val", "test"]
_TENTHS: dict[Split, int] = {"train": 7, "val": 2, "test": 1}  # of a set without a split

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
    direction = up_direction(up)
    fields = _read(path)
    found = _match_joints(fields["joints"], skeleton, path)
    poses = fields["poses"]
    keep = fields["split"] == split if "split" in fields else every_tenth(len(poses), split)
    subject = fields.get("subject", np.zeros(len(poses), dtype=np.int64))
    known = np.flatnonzero(found >= 0)
    given = poses[keep][:, known].astype(np.float64)
    given[~np.isfinite(given).all(-1)] = np.nan
    bodies = np.full((len(given), len(skeleton.keypoints), 3), np.nan)
    bodies[:, found[known]] = stand_upright(given, direction)
    enough = np.isfinite(bodies[..., 0]).sum(1) >= LEAST_JOINTS
    return PoseSet(bodies[enough], _weight_by_subject(subject[keep][enough]))


def _match_joints(names: NDArray[Any], skeleton: Skeleton, path: Path) -> NDArray[np.int64]:
    """Return the index `[J]` in the skeleton of each name of a file, -1 = none.

    Raises MismatchError where fewer than four are joints of the skeleton.
    """
    found = match_names(tuple(str(name) for name in names), skeleton)
    if (found >= 0).sum() < LEAST_JOINTS:
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


def up_direction(up: str) -> Floats:
    """Return the unit vector `[3]` of an axis: +x, -y, ... Raises FormatError."""
    axes = {f"+{axis}": row for axis, row in zip("xyz", np.eye(3), strict=True)}
    axes |= {f"-{axis}": -axes[f"+{axis}"] for axis in "xyz"}
    if up not in axes:
        raise FormatError(f"up axis: expected one of {', '.join(axes)}, found {up}")
    return axes[up]


def stand_upright(poses: Floats, up: Floats) -> Floats:
    """Rotate poses `[..., 3]` so that the direction `up` `[3]` becomes +z."""
    return poses @ looking_along(up, np.array([0.0, 0.0, 1.0])).T  # its third axis is up


def every_tenth(n: int, split: Split) -> Bools:
    """Return which of n frames `[n]` a split has: 7:2:1 in blocks of time.

    For sets that do not bring a split of their own.
    """
    of_tenth = np.repeat(list(_TENTHS), list(_TENTHS.values()))
    return np.asarray(of_tenth[np.arange(n) * 10 // max(n, 1)] == split)


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
