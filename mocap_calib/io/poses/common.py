"""What a file of 3D poses holds besides the poses, and what the formats share."""

import re
import struct
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mocap_calib.errors import MismatchError
from mocap_calib.io.file import malformed, repeated
from mocap_calib.io.units import unit_factor
from mocap_calib.types import Floats, Ints, Poses3D

# what h5py, numpy, zipfile and c3d raise on files that are cut or damaged
DAMAGE = (
    *(
        OSError,
        KeyError,
        IndexError,
        ValueError,
        TypeError,
        AttributeError,
        RuntimeError,
        OverflowError,
        MemoryError,
        EOFError,
        AssertionError,
    ),
    *(
        ZeroDivisionError,
        NotImplementedError,
        NameError,
        struct.error,
        zipfile.BadZipFile,
        zlib.error,
    ),
)
_LONGEST = 5_000_000  # frames of a file without gaps: a day and a half at 30 per second
UNNAMED = re.compile(r"individual_[0-9]+")  # what individuals without a name are called
_UP = {
    "x": [[0, 0, 1], [1, 0, 0], [0, 1, 0]],
    "y": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "z": [[0, 1, 0], [0, 0, 1], [1, 0, 0]],
    "-x": [[0, 1, 0], [-1, 0, 0], [0, 0, 1]],
    "-y": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "-z": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
}
UP_AXES = tuple(_UP)


@dataclass(frozen=True)
class PoseFile:
    """Poses and what files say beside.

    rate: frames per second, NaN where nobody says. individuals: a name each. notes: what a user should know of what was
    left out. Where a file lacks them, the poses' error and confidence are NaN and views 0.
    """

    poses: Poses3D
    rate: float = float("nan")
    individuals: tuple[str, ...] = ()
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        count = self.poses.positions.shape[1]
        if not self.individuals:
            object.__setattr__(self, "individuals", tuple(f"individual_{k}" for k in range(count)))
        if len(self.individuals) != count:
            raise ValueError(f"{len(self.individuals)} names for {count} individuals")


@dataclass(frozen=True)
class WrittenPoses:
    """A file's content, and what of the poses it does not carry."""

    content: bytes
    lost: tuple[str, ...] = ()


def bare_poses(
    keypoints: Sequence[str],
    frames: Ints,
    positions: Floats,
    unit: str,
    confidence: Floats | None = None,
) -> Poses3D:
    """Poses of a file that says no more: `[frame, individual, keypoint, 3]` positions, NaN = missing."""
    nothing, views = (
        np.full(positions.shape[:3], np.nan),
        np.zeros(positions.shape[:3], dtype=np.int64),
    )
    return Poses3D(
        tuple(keypoints),
        frames,
        positions,
        nothing,
        views,
        nothing if confidence is None else confidence,
        unit,
    )


def in_unit(file: PoseFile, unit: str, owner: str) -> PoseFile:
    """The lengths in another unit. Raises MismatchError where the poses' own is not known."""
    factor = unit_factor(file.poses.unit, unit, owner)
    return replace(
        file, poses=replace(file.poses, positions=file.poses.positions * factor, unit=unit)
    )


def need_rate(file: PoseFile, owner: str) -> float:
    """Frames per second. Raises MismatchError where nobody said."""
    if not file.rate > 0 or not np.isfinite(file.rate):
        raise MismatchError(
            f"{owner}: expected the number of frames per second, found none; say it with --fps"
        )
    return file.rate


def without_gaps(poses: Poses3D, owner: str) -> tuple[Ints, Floats]:
    """All frame numbers from the first to the last, and the positions, NaN where a frame is missing. Raises MismatchError."""
    if not len(poses.frames):
        raise MismatchError(f"{owner}: expected at least one frame, found none; nothing to write")
    first, last = int(poses.frames[0]), int(poses.frames[-1])
    if last - first >= _LONGEST:
        found = f"{first} to {last}"
        raise MismatchError(
            f"{owner}: expected frames within {_LONGEST} of each other, as the format has no gaps, found {found}; split the file"
        )
    positions = np.full((last - first + 1, *poses.positions.shape[1:]), np.nan)
    positions[poses.frames - first] = poses.positions
    return np.arange(first, last + 1), positions


def turn_up_axis(file: PoseFile, up: str) -> PoseFile:
    """The poses turned so that what was `up` (x, y, z, -x, -y, -z) is y, as OpenSim and others take it; other axes follow."""
    return replace(
        file,
        poses=replace(
            file.poses, positions=file.poses.positions @ np.array(_UP[up], dtype=np.float64).T
        ),
    )


def need_keypoints(file: PoseFile, pattern: str, words: str, owner: str) -> None:
    """Raises MismatchError where a keypoint's or an individual's name does not match the pattern, which `words` describe."""
    for name in (*file.poses.keypoints, *file.individuals):
        if not re.fullmatch(pattern, name):
            raise MismatchError(f"{owner}: expected names of {words}, found {name!r}; rename it")


def lost_quality(file: PoseFile) -> tuple[str, ...]:
    """What is lost by a format of positions alone."""
    poses = file.poses
    there = {
        "reprojection errors": np.isfinite(poses.error).any(),
        "numbers of views": poses.views.any(),
        "confidences": np.isfinite(poses.confidence).any(),
    }
    return tuple(name for name, any_ in there.items() if any_)


def lost_names(file: PoseFile) -> tuple[str, ...]:
    """What is lost by a format that does not name individuals."""
    return (
        ()
        if all(UNNAMED.fullmatch(name) for name in file.individuals)
        else ("the individuals' names",)
    )


def check_poses(file: PoseFile, source: str) -> PoseFile:
    """The file as it is: names and frames each once, frames in order. Raises FormatError."""
    for what, names in (("keypoint", file.poses.keypoints), ("individual", file.individuals)):
        twice = repeated(names)
        if twice:
            raise malformed(
                source, f"each {what} once", f"{', '.join(twice)} twice", "rename one of them"
            )
    if (np.diff(file.poses.frames) <= 0).any():
        raise malformed(source, "frames in order, each once", "others", "write the file again")
    return file


def attribute(attributes: Mapping[str, Any], key: str) -> str:
    """A text attribute of HDF5, "" where there is none."""
    value = attributes.get(key, "")
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
