"""3D poses to train on: of files, of a run, and bodies made from the `body` of a skeleton.

A set may lack joints of the vocabulary: they are NaN, never seen, and no target.
"""

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mocap_calib.config import LEAST_JOINTS
from mocap_calib.errors import DegenerateError, FormatError, MismatchError, argument
from mocap_calib.geometry.graphs import spanning_tree
from mocap_calib.geometry.rotation import looking_along
from mocap_calib.io.camera_files import read_rig
from mocap_calib.io.hdf5 import check_archive, damage_refused
from mocap_calib.io.pose_files import read_poses
from mocap_calib.recording.joints import load_section, load_skeleton, match_names, parse_skeleton
from mocap_calib.results import Poses3D
from mocap_calib.synthetic.body_plan import parse_body, sample_bodies
from mocap_calib.training import (
    OWN_SPECIES_LARGEST_ERROR,
    OWN_SPECIES_LEAST_POSES,
    OWN_SPECIES_TRAINING,
    TrainConfig,
)
from mocap_calib.types import Bools, CameraRig, Floats, Skeleton

Split = Literal["train", "val", "test"]
_TENTHS: dict[Split, int] = {"train": 7, "val": 2, "test": 1}  # of a set without a split

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
    names = tuple(map(str, fields["joints"]))
    found = match_names(names, skeleton)
    if (found >= 0).sum() < LEAST_JOINTS:
        raise MismatchError(
            path,
            f"joints of skeleton {skeleton.name}",
            ", ".join(names),
            "add the names to its aliases",
        )
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


def _weight_by_subject(subject: NDArray[Any]) -> Floats:
    """Return the weight `[pose]` that lets a subject `[pose]` count by the root of its poses."""
    _, index, count = np.unique(subject, return_inverse=True, return_counts=True)
    weight = 1.0 / np.sqrt(count[index])
    return weight / weight.sum()


def _read(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of a file that are known, with the names of joints.json beside it.

    Raises FormatError.
    """
    folder, file_path = path.parent, path
    if path.is_dir():
        folder, file_path = path, path / "poses3d.npz"
    wanted = "an npz file of 3D poses, or a folder with poses3d.npz and joints.json"
    with damage_refused(str(path), wanted):
        content = file_path.read_bytes()
        check_archive(content, str(path))
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            fields = {
                _OTHER_NAMES.get(name, name): file[name] for name in file.files if name in _ARRAYS
            }
        names = folder / "joints.json"
        if "joints" not in fields and names.is_file():
            fields["joints"] = np.array(json.loads(names.read_text("utf-8"))["names"])
    if not {"poses", "joints"} <= set(fields):
        found = ", ".join(fields) or "neither"
        raise FormatError(
            path, "the arrays `poses` and `joints`", found, "write both (docs/skeletons.md)"
        )
    shape, joints = fields["poses"].shape, fields["joints"].size
    if len(shape) != 3 or shape[1:] != (joints, 3):
        raise FormatError(path, f"poses of shape (any, {joints}, 3)", shape, "write a pose a row")
    return fields


def up_direction(up: str) -> Floats:
    """Return the unit vector `[3]` of an axis: +x, -y, ... Raises FormatError."""
    axes = {f"+{axis}": row for axis, row in zip("xyz", np.eye(3), strict=True)}
    axes |= {f"-{axis}": -axes[f"+{axis}"] for axis in "xyz"}
    if up not in axes:
        raise FormatError("up axis", f"one of {', '.join(axes)}", up, "choose one of these")
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


# --- what to train on


@dataclass(frozen=True)
class TrainingSource:
    """What to train on.

    poses: files and folders with poses.
    calibrated: poses3d.h5 of a run, instead; cameras.yaml beside it tells what is up, unless `up`
        does.
    skeleton: name or file of the vocabulary; None: people, or the joints of the run.
    up: axis that points up (+z, -y, ...), once or for each file; none: +z.
    procedural: share of bodies made from the skeleton's file; None: where the file tells how,
        `TrainConfig.procedural` beside poses, all without.
    """

    poses: tuple[Path, ...] = ()
    calibrated: Path | None = None
    skeleton: str | None = None
    up: tuple[str, ...] = ()
    procedural: float | None = None

    @property
    def files(self) -> tuple[Path, ...]:
        """The files with poses."""
        return self.poses if self.calibrated is None else (*self.poses, self.calibrated)

    @property
    def skeleton_name(self) -> str:
        """The vocabulary, where the poses of a run do not bring their own."""
        return self.skeleton or "people"

    def describe(self) -> str:
        """Return what a model card says of the data unless stated otherwise."""
        return ", ".join(path.name for path in self.files) or "procedural bodies"


def check_source(source: TrainingSource) -> None:
    """Raise MismatchError where the parts of a source do not go together.

    Raises FormatError where the skeleton's file cannot be read.
    """
    files = len(source.poses)
    if source.calibrated is not None:
        rig_file = _rig_file(source.calibrated)
        if source.poses or source.procedural:
            raise MismatchError(
                "",
                f"POSES or {argument('procedural')}, or {argument('calibrated')}",
                "both",
                "leave one out",
            )
        if not source.up and not rig_file.is_file():
            raise MismatchError(
                "",
                f"{rig_file} beside the poses, or {argument('up')}",
                "neither",
                f"give {argument('up')}",
            )
        return
    if len(source.up) not in (0, 1, files):
        raise MismatchError(
            argument("up"),
            f"it once, or once for each of {files} files",
            f"it {len(source.up)} times",
            "give one direction a file",
        )
    has_body = bool(load_section(source.skeleton_name, "body"))
    wants_bodies = has_body if source.procedural is None else source.procedural > 0
    if (wants_bodies and not has_body) or not (files or wants_bodies):
        raise MismatchError(
            "",
            "POSES, or a skeleton with a section `body` to make some from",
            f"neither in {source.skeleton_name}",
            "see docs/skeletons.md",
        )


def load_vocabulary(source: TrainingSource) -> tuple[Skeleton, Mapping[str, Any]]:
    """Return the joints to train for, and settings other than the defaults of TrainConfig.

    Raises FormatError.
    """
    if source.calibrated is not None and source.skeleton is None:
        poses = read_poses(source.calibrated, "poses-h5")
        return own_skeleton(source.calibrated.stem, poses), OWN_SPECIES_TRAINING
    name = source.skeleton_name
    return load_skeleton(name), load_section(name, "training")


def load_pose_sets(
    source: TrainingSource, vocabulary: Skeleton, config: TrainConfig
) -> tuple[PoseSet, PoseSet]:
    """Return the poses to train and to test on, in the joints of the vocabulary.

    Raises FormatError, DegenerateError where a run has too few poses, and MismatchError where the
    parts of the source, or the poses and the vocabulary, do not go together.
    """
    check_source(source)
    if source.calibrated is None:
        training = _poses_of_files(source, vocabulary, config, "train")
        return training, _poses_of_files(source, vocabulary, config, "test")
    poses = read_poses(source.calibrated, "poses-h5")
    if source.up:
        up = up_direction(source.up[0])
    else:
        up = up_of_rig(read_rig(_rig_file(source.calibrated)))
    return own_poses(poses, vocabulary, up, "train"), own_poses(poses, vocabulary, up, "test")


def _rig_file(calibrated: Path) -> Path:
    """Return the file with the cameras of a run, beside its poses."""
    return calibrated.with_name("cameras.yaml")


def _poses_of_files(
    source: TrainingSource, vocabulary: Skeleton, config: TrainConfig, split: Split
) -> PoseSet:
    """Return the poses of the files, and bodies made from the skeleton's file, mixed.

    Each file counts by the square root of its number of poses.
    """
    files = len(source.poses)
    up_axes = source.up if len(source.up) == files else (source.up or ("+z",)) * files
    sets = [
        load_poses(path, vocabulary, split, up=up)
        for path, up in zip(source.poses, up_axes, strict=True)
    ]
    sizes = np.sqrt([len(one.poses) for one in sets])
    shares = sizes / sizes.sum()
    body = load_section(source.skeleton_name, "body")
    made = source.procedural
    if made is None:
        made = 0.0 if not body else config.procedural if sets else 1.0
    if made:
        seed = config.seed + (split == "test")
        sets.append(procedural_poses(vocabulary, body, config.bodies, seed=seed))
        shares = np.append((1 - made) * shares, made)
    return mix(sets, shares.tolist())


# --- poses of a calibrated recording


def up_of_rig(rig: CameraRig) -> Floats:
    """Return the direction `[3]` that is up if the cameras stand upright.

    It is opposite to the mean of their y axes, in the axes of the rig.
    """
    up = -rig.rotation[:, 1].mean(0)
    return up / np.linalg.norm(up)


def own_poses(poses: Poses3D, skeleton: Skeleton, up: Floats, split: Split) -> PoseSet:
    """Return the well triangulated poses of all individuals, +z up, 7:2:1 by blocks of time.

    up: `[3]` the direction that is up, in the axes of the poses.

    Raises DegenerateError where they are too few to learn from.
    """
    largest = OWN_SPECIES_LARGEST_ERROR * _median(poses.error, axis=(0, 1, 2))
    known = np.where((poses.error <= largest)[..., None], poses.positions, np.nan)
    bodies = known[every_tenth(len(poses.frames), split)]
    bodies = bodies.reshape(-1, *bodies.shape[2:])  # [pose, keypoint, 3]
    found = match_names(poses.keypoints, skeleton)
    joints = np.full((len(bodies), len(skeleton.keypoints), 3), np.nan)
    joints[:, found[found >= 0]] = bodies[:, found >= 0]
    least_joints = max(LEAST_JOINTS, int((found >= 0).sum()) // 2)
    enough = np.isfinite(joints[..., 0]).sum(1) >= least_joints
    count = int(enough.sum())
    if count < OWN_SPECIES_LEAST_POSES:
        raise DegenerateError(
            "",
            f"at least {OWN_SPECIES_LEAST_POSES} whole 3D poses to {split} on",
            count,
            "record longer",
        )
    return PoseSet(stand_upright(joints[enough], up), np.full(count, 1.0 / count))


def own_skeleton(name: str, poses: Poses3D) -> Skeleton:
    """Return a skeleton of the keypoints that have points, joined into a tree by what is rigid.

    The bones are those that change their length least: a minimum spanning tree.

    Raises DegenerateError where no pose has enough points.
    """
    known = np.isfinite(poses.positions[..., 0])
    most = int(known.sum(-1).max(initial=0))
    if most < LEAST_JOINTS:
        raise DegenerateError(
            "",
            f"poses with at least {LEAST_JOINTS} keypoints in 3D to learn from",
            f"{most} at most",
            "record longer",
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
