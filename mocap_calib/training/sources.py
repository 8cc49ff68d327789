"""Gather what a network is trained on: poses of files, poses of a run, procedural bodies."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mocap_calib.errors import MismatchError
from mocap_calib.io.cameras.read import read_rig
from mocap_calib.io.poses.read import read_poses
from mocap_calib.recording.joints import load_section, load_skeleton
from mocap_calib.training.config import OWN_SPECIES_TRAINING, TrainConfig
from mocap_calib.training.poses import (
    PoseSet,
    Split,
    load_poses,
    mix,
    own_poses,
    own_skeleton,
    procedural_poses,
    shares_by_size,
    up_direction,
    up_of_rig,
)
from mocap_calib.types import Floats, Skeleton


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
        """Return what a model card says of the data where nobody says more."""
        return ", ".join(path.name for path in self.files) or "procedural bodies"


def check_source(source: TrainingSource) -> None:
    """Raise MismatchError where the parts of a source do not go together.

    Raises FormatError where the skeleton's file cannot be read.
    """
    if source.calibrated is not None:
        _check_run(source, source.calibrated)
    else:
        _check_up(source)
        _check_bodies(source)


def _check_run(source: TrainingSource, calibrated: Path) -> None:
    """Raise MismatchError where there is more than a run, or nothing says what is up."""
    if source.poses or source.procedural:
        raise MismatchError("expected POSES or --procedural, or --from, found both")
    rig_file = _rig_file(calibrated)
    if not source.up and not rig_file.is_file():
        raise MismatchError(f"expected {rig_file} beside the poses, or --up, found neither")


def _check_up(source: TrainingSource) -> None:
    """Raise MismatchError where there is neither one axis that is up nor one for each file."""
    files = len(source.poses)
    if len(source.up) not in (0, 1, files):
        raise MismatchError(
            f"--up: expected it once, or once for each of {files} files, "
            f"found it {len(source.up)} times"
        )


def _check_bodies(source: TrainingSource) -> None:
    """Raise MismatchError where there are no poses, or nothing to make bodies from."""
    has_body = bool(load_section(source.skeleton_name, "body"))
    wants_bodies = has_body if source.procedural is None else source.procedural > 0
    if (wants_bodies and not has_body) or not (source.poses or wants_bodies):
        raise MismatchError(
            "expected POSES, or a skeleton with a section `body` to make some from, "
            f"found neither in {source.skeleton_name}; see docs/skeletons.md"
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
    up = _up_of_run(source.calibrated, source.up)
    return own_poses(poses, vocabulary, up, "train"), own_poses(poses, vocabulary, up, "test")


def _up_of_run(calibrated: Path, up: tuple[str, ...]) -> Floats:
    """Return the direction `[3]` that is up: the axis that is given, else what its rig says."""
    return up_direction(up[0]) if up else up_of_rig(read_rig(_rig_file(calibrated)))


def _rig_file(calibrated: Path) -> Path:
    """Return the file with the cameras of a run, beside its poses."""
    return calibrated.with_name("cameras.yaml")


def _poses_of_files(
    source: TrainingSource, vocabulary: Skeleton, config: TrainConfig, split: Split
) -> PoseSet:
    """Return the poses of the files, and bodies made from the skeleton's file, mixed."""
    files = len(source.poses)
    up_axes = source.up if len(source.up) == files else (source.up or ("+z",)) * files
    sets = [
        load_poses(path, vocabulary, split, up=up)
        for path, up in zip(source.poses, up_axes, strict=True)
    ]
    body = load_section(source.skeleton_name, "body")
    share = _procedural_share(source, config, has_body=bool(body))
    if not share:
        return sets[0] if len(sets) == 1 else mix(sets, shares_by_size(sets))
    made = procedural_poses(vocabulary, body, config.bodies, seed=config.seed + (split == "test"))
    if not sets:
        return mix([made], [1.0])
    sizes = shares_by_size(sets)
    total = sum(sizes)
    return mix([*sets, made], [*(size / total * (1 - share) for size in sizes), share])


def _procedural_share(source: TrainingSource, config: TrainConfig, *, has_body: bool) -> float:
    """Return the share of bodies that are made.

    has_body: the skeleton's file says how its bodies are made.
    """
    if source.procedural is not None:
        return source.procedural
    if not has_body:
        return 0.0
    return config.procedural if source.poses else 1.0
