"""What `train` trains on: files with poses, a run, bodies made from a skeleton's file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from mocap_calib.config import OWN_SPECIES_TRAINING, TrainConfig
from mocap_calib.io.cameras.read import read_rig
from mocap_calib.io.poses.read import read_poses
from mocap_calib.recording.joints import load_section, load_skeleton
from mocap_calib.steerpose.training.own_species import (
    own_poses,
    own_skeleton,
    up_direction,
    up_of_rig,
)
from mocap_calib.steerpose.training.poses import (
    PoseSet,
    Split,
    load_poses,
    mix,
    procedural_poses,
    shares_by_size,
)
from mocap_calib.types import Skeleton


@dataclass(frozen=True)
class TrainingSource:
    """What to train on, as it was typed.

    poses: files and folders with poses. calibrated: poses that a run found, instead.
    skeleton: name or file of the vocabulary. up: axis that points up, once or for each file.
    procedural: share of bodies made from the skeleton's file; None: where it is of use.
    """

    poses: tuple[Path, ...]
    calibrated: Path | None
    skeleton: str | None
    up: tuple[str, ...]
    procedural: float | None

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


def load_vocabulary(source: TrainingSource) -> tuple[Skeleton, dict[str, Any]]:
    """Return the joints to train for, and settings other than the defaults. Raises FormatError."""
    if source.calibrated is not None and source.skeleton is None:
        poses = read_poses(source.calibrated, "poses-h5").poses
        return own_skeleton(source.calibrated.stem, poses), OWN_SPECIES_TRAINING
    name = source.skeleton_name
    return load_skeleton(name), load_section(name, "training")


def load_pose_sets(
    source: TrainingSource, vocabulary: Skeleton, config: TrainConfig
) -> tuple[PoseSet, PoseSet]:
    """Return the poses to train and to test on.

    Raises FormatError, MismatchError, DegenerateError, and click's UsageError where what was
    typed does not go together.
    """
    if source.calibrated is None:
        return _pose_set(source, "train", config), _pose_set(source, "test", config)
    if source.poses or source.procedural:
        raise click.UsageError("expected POSES or --procedural, or --from, found both")
    splits: tuple[Split, Split] = ("train", "test")
    training, testing = (
        _poses_of_run(source.calibrated, vocabulary, source.up, split) for split in splits
    )
    return training, testing


def _poses_of_run(
    calibrated: Path, vocabulary: Skeleton, up: tuple[str, ...], split: Split
) -> PoseSet:
    """Return the poses that a run found. Raises click's UsageError where nothing says what is up.

    calibrated: the poses3d.h5 of the run; its cameras.yaml beside it tells what is up, else --up.
    """
    rig_file = calibrated.with_name("cameras.yaml")
    if not up and not rig_file.is_file():
        raise click.UsageError(f"expected {rig_file} beside the poses, or --up, found neither")
    direction = up_direction(up[0]) if up else up_of_rig(read_rig(rig_file))
    return own_poses(read_poses(calibrated, "poses-h5").poses, vocabulary, direction, split)


def _pose_set(source: TrainingSource, split: Split, config: TrainConfig) -> PoseSet:
    """Return the poses of the files, and bodies made from the skeleton's file, mixed."""
    name = source.skeleton_name
    vocabulary = load_skeleton(name)
    body = load_section(name, "body")
    sets = [
        load_poses(path, vocabulary, split, up=up)
        for path, up in zip(source.poses, _up_axes(source), strict=True)
    ]
    share = _procedural_share(source, has_body=bool(body))
    if not share:
        return sets[0] if len(sets) == 1 else mix(sets, shares_by_size(sets))
    made = procedural_poses(vocabulary, body, config.bodies, seed=config.seed + (split == "test"))
    if not sets:
        return mix([made], [1.0])
    sizes = shares_by_size(sets)
    total = sum(sizes)
    return mix([*sets, made], [*(size / total * (1 - share) for size in sizes), share])


def _up_axes(source: TrainingSource) -> tuple[str, ...]:
    """Return what points up in each file. Raises click's UsageError."""
    files = len(source.poses)
    if len(source.up) not in (0, 1, files):
        raise click.UsageError(
            f"--up: expected it once, or once for each of {files} files, "
            f"found it {len(source.up)} times"
        )
    return source.up if len(source.up) == files else (source.up or ("+z",)) * files


def _procedural_share(source: TrainingSource, *, has_body: bool) -> float:
    """Return the share of bodies that are made. Raises click's UsageError where there is nothing.

    has_body: the skeleton's file says how its bodies are made.
    """
    share = source.procedural
    if share is None:
        share = (0.5 if source.poses else 1.0) * has_body
    if (share and not has_body) or not (source.poses or share):
        raise click.UsageError(
            "expected POSES, or a skeleton with a section `body` to make some from, "
            f"found neither in {source.skeleton_name}; see docs/skeletons.md"
        )
    return share
