"""Read files of 3D poses of any format of `io.poses.formats`.

`read_poses` returns the poses; `load_poses` all that a file says.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mocap_calib.errors import FormatError, MismatchError, argument
from mocap_calib.io.crash_guard import guard_hdf5
from mocap_calib.io.file import find_repeated, read_bytes
from mocap_calib.io.poses import poses3d_h5
from mocap_calib.io.poses.common import UNNAMED, PoseFile, check_poses
from mocap_calib.io.poses.formats import POSE_FORMATS, PoseFormat
from mocap_calib.io.registry import find_format, read_names
from mocap_calib.io.units import ARBITRARY, refuse_unit
from mocap_calib.results import Poses3D


def read_poses(path: str | Path, format: str | None = None, unit: str | None = None) -> Poses3D:
    """Read the 3D poses in a file; the arguments are those of `load_poses`.

    Raises FormatError and MismatchError.
    """
    return load_poses(path, format, unit).poses


def load_poses(path: str | Path, format: str | None = None, unit: str | None = None) -> PoseFile:
    """Read all that a file says of 3D poses: also frames per second and names.

    format: name of a pose format; where none is given, the content says it.
    unit: what a length of 1 is ("m", "cm", "mm"), where the file does not say.

    Raises FormatError, and MismatchError where the file states another unit.
    """
    return parse_poses(read_bytes(Path(path)), str(path), format, unit)


def parse_poses(
    content: bytes, source: str, format: str | None = None, unit: str | None = None
) -> PoseFile:
    """Return what `load_poses` does of the content of a file; `source` stands for its path."""
    file = guard_hdf5(content, len(content), source, _parse, content, source, format)
    if unit is None:
        return file
    if poses3d_h5.sniff(content) and file.poses.unit == ARBITRARY:
        raise refuse_unit(source, unit)
    if file.poses.unit not in (ARBITRARY, unit):
        raise MismatchError(
            source,
            f"lengths in {file.poses.unit}, as the file says",
            argument("input_unit", unit),
            "leave it out",
        )
    return replace(file, poses=replace(file.poses, unit=unit))


def looks_like_poses(content: bytes) -> bool:
    """Return whether the content of a file is of one of the formats."""
    try:
        return guard_hdf5(content, len(content), "content", _sniff, content) != ""
    except FormatError:
        return False


def join_individuals(files: Sequence[PoseFile], source: str) -> PoseFile:
    """Join the individuals of several files, on all frames that any of the files has.

    source: what complaints call the files.

    Raises MismatchError where the files do not belong together.
    """
    first = files[0]
    if len(files) == 1:
        return first
    if not all(_belong_together(first, other) for other in files[1:]):
        raise MismatchError(
            source,
            "files of one recording",
            "other keypoints, units or rates",
            "give them one by one",
        )
    notes = tuple(note for file in files for note in file.notes)
    poses = _join_poses([file.poses for file in files])
    return PoseFile(poses, first.rate, _join_names(files), notes, first.edges, joints=first.joints)


def _sniff(content: bytes) -> str:
    """Return the name of the format that the content shows, "" where it shows none."""
    return next((each.name for each in POSE_FORMATS if each.sniff(content)), "")


def _parse(content: bytes, source: str, format: str | None) -> PoseFile:
    known = _find_format(content, source, format)
    return check_poses(known.read(content, source), source)


def _find_format(content: bytes, source: str, format: str | None) -> PoseFormat:
    """Return the format that is named, or that the content shows. Raises FormatError."""
    name = format or _sniff(content)
    if name:
        return find_format(POSE_FORMATS, name)
    found = f"content that begins with {content[:16]!r}" if content else "an empty file"
    expected = f"one of: {', '.join(read_names(POSE_FORMATS))}"
    raise FormatError(source, expected, found, "export one of these, or name it")


def _belong_together(first: PoseFile, other: PoseFile) -> bool:
    """Return whether two files may be of one recording."""
    return (
        first.poses.keypoints == other.poses.keypoints
        and first.poses.unit == other.poses.unit
        and np.array_equal(first.rate, other.rate, equal_nan=True)
    )


def _join_poses(parts: Sequence[Poses3D]) -> Poses3D:
    """Join the individuals of poses with the same keypoints."""
    frames = np.unique(np.concatenate([part.frames for part in parts]))
    individuals = sum(part.positions.shape[1] for part in parts)
    shape = (len(frames), individuals, len(parts[0].keypoints))
    arrays: dict[str, Any] = {
        "positions": np.full((*shape, 3), np.nan),
        "error": np.full(shape, np.nan),
        "views": np.zeros(shape, dtype=np.int64),
        "confidence": np.full(shape, np.nan),
        "covariance": np.full((*shape, 6), np.nan, dtype=np.float32),
        "raw": np.full((*shape, 3), np.nan),
        "source": np.zeros(shape, dtype=np.int8),
    }
    start = 0
    for part in parts:
        end = start + part.positions.shape[1]
        rows = np.searchsorted(frames, part.frames)
        for name, array in arrays.items():
            array[rows, start:end] = getattr(part, name)
        start = end
    return replace(parts[0], frames=frames, **arrays)


def _join_names(files: Sequence[PoseFile]) -> tuple[str, ...]:
    """Return the names of all individuals; nothing where two are alike.

    Mere numbers (`individual_0`) are counted on from file to file.
    """
    names = [name for file in files for name in file.individuals]
    for index, name in enumerate(names):
        if UNNAMED.fullmatch(name):
            names[index] = f"individual_{index}"
    return () if find_repeated(names) else tuple(names)
