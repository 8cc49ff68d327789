"""3D poses to train on: read from files, made from a skeleton's body, or a mix of both.

A set may lack joints of the vocabulary: they are NaN, never seen, and no target.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.recording.joints import match_names
from mocap_calib.synthetic.procedural import parse_body, sample_bodies
from mocap_calib.types import Bools, Floats, Skeleton

Split = Literal["train", "val", "test"]
UP = {
    f"{sign}{axis}": (column, 1.0 if sign == "+" else -1.0)
    for column, axis in enumerate("xyz")
    for sign in "+-"
}
_LEAST_JOINTS = 4
_ARRAYS = ("poses", "poses3d", "joints", "split", "subject", "clip")


@dataclass(frozen=True)
class PoseSet:
    """3D poses, +z up. poses: `[pose, joint, 3]`, NaN = not known; weight: `[pose]` how often to draw each, sum 1."""

    poses: Floats
    weight: Floats


def load_poses(path: Path, skeleton: Skeleton, split: Split, *, up: str = "+z") -> PoseSet:
    """Reads an npz file, or a folder with `poses3d.npz` and `joints.json` (`names`); any unit.

    The file has `poses` or `poses3d` `[S, J, 3]`, `joints [J]` unless joints.json says them, and optionally `split` and `subject`
    or `clip` `[S]`. up: the axis that points up. Poses are drawn by subject and by the square root of its number of frames, so that
    one long dance does not rule. Raises FormatError, and MismatchError where fewer than four joints are those of the skeleton.
    """
    fields = _read(path)
    found = match_names(tuple(str(name) for name in fields["joints"]), skeleton)
    known = np.flatnonzero(found >= 0)
    if len(known) < _LEAST_JOINTS:
        raise MismatchError(
            f"{path}: expected joints of skeleton {skeleton.name}, found {', '.join(map(str, fields['joints']))}"
        )
    keep = (
        fields["split"] == split if "split" in fields else every_tenth(len(fields["poses"]), split)
    )
    poses = np.full((int(keep.sum()), len(skeleton.keypoints), 3), np.nan)
    poses[:, found[known]] = _upright(fields["poses"][keep][:, known].astype(np.float64), up)
    enough = np.isfinite(poses).all(-1).sum(1) >= _LEAST_JOINTS
    subject = (
        fields["subject"][keep] if "subject" in fields else np.zeros(len(poses), dtype=np.int64)
    )
    _, which, count = np.unique(subject[enough], return_inverse=True, return_counts=True)
    weight = 1.0 / np.sqrt(count[which])
    return PoseSet(poses[enough], weight / weight.sum())


def _read(path: Path) -> dict[str, NDArray[Any]]:
    """Arrays `poses`, `joints` and what else there is. Raises FormatError."""
    folder = path if path.is_dir() else path.parent
    file_path = path / "poses3d.npz" if path.is_dir() else path
    try:
        with np.load(file_path, allow_pickle=False) as file:
            fields = {name: file[name] for name in file.files if name in _ARRAYS}
        if "joints" not in fields and (folder / "joints.json").is_file():
            fields["joints"] = np.array(
                json.loads((folder / "joints.json").read_text("utf-8"))["names"]
            )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FormatError(
            f"{path}: expected an npz file of 3D poses, or a folder with poses3d.npz and joints.json: {error}"
        ) from None
    fields |= {
        new: fields[old]
        for new, old in (("poses", "poses3d"), ("subject", "clip"))
        if old in fields and new not in fields
    }
    if not {"poses", "joints"} <= set(fields):
        raise FormatError(
            f"{path}: expected the arrays `poses` and `joints`, found {', '.join(fields) or 'neither'}"
        )
    if fields["poses"].ndim != 3 or fields["poses"].shape[1:] != (len(fields["joints"]), 3):
        raise FormatError(
            f"{path}: expected poses of shape (any, {len(fields['joints'])}, 3), found {fields['poses'].shape}"
        )
    return fields


def _upright(poses: Floats, up: str) -> Floats:
    """Turns the axis `up` to +z."""
    if up not in UP:
        raise FormatError(f"up axis: expected one of {', '.join(UP)}, found {up}")
    column, sign = UP[up]
    turned = np.roll(poses, 2 - column, axis=-1)
    return turned if sign > 0 else turned * [-1.0, 1.0, -1.0]


def every_tenth(n: int, split: Split) -> Bools:
    """7:2:1 in blocks of time, where a set does not bring its own split."""
    tenth = np.arange(n) * 10 // max(n, 1)
    return {"train": tenth < 7, "val": (tenth >= 7) & (tenth < 9), "test": tenth == 9}[split]


def procedural_poses(
    skeleton: Skeleton, body: Mapping[str, Any], count: int, *, seed: int
) -> PoseSet:
    """`count` bodies from the section `body` of a skeleton's file. Raises FormatError."""
    poses = sample_bodies(np.random.default_rng(seed), parse_body(body, skeleton), count)
    return PoseSet(poses, np.full(count, 1.0 / count))


def mix(sets: Sequence[PoseSet], shares: Sequence[float]) -> PoseSet:
    """One set that draws from each of several with its share; bodies are brought to one size."""
    total = sum(shares)
    return PoseSet(
        np.concatenate([_unit_size(one.poses) for one in sets]),
        np.concatenate([one.weight * s / total for one, s in zip(sets, shares, strict=True)]),
    )


def _unit_size(poses: Floats) -> Floats:
    centred = poses - np.nanmean(poses, axis=1, keepdims=True)
    return centred / np.sqrt(np.nanmean((centred**2).sum(-1), axis=1))[:, None, None]


def by_size(sets: Sequence[PoseSet]) -> list[float]:
    """Shares that let a set count by the square root of its number of poses."""
    return [float(np.sqrt(len(one.poses))) for one in sets]
