"""The formats of 3D poses: one table, by which files are recognised, read and written."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.io.atomic import folder, of_individual, write_bytes
from mocap_calib.io.file import malformed, read_bytes, repeated
from mocap_calib.io.poses import anipose_csv, arrays, c3d_file, movement, nwb, trc
from mocap_calib.io.poses.common import UNNAMED, PoseFile, WrittenPoses, check_poses
from mocap_calib.io.sandbox import contained
from mocap_calib.io.units import ARBITRARY


@dataclass(frozen=True)
class PoseFormat:
    """One format.

    single: a file holds one individual, so that several are several files. timed: it needs the number of frames per second.
    endings: of a file's name, for which it is written unnamed.
    """

    name: str
    title: str
    sniff: Callable[[bytes], bool]
    parse: Callable[[bytes, str], PoseFile]
    write: Callable[[PoseFile, str], WrittenPoses]
    endings: tuple[str, ...]
    single: bool = False
    timed: bool = False


POSE_FORMATS = (
    PoseFormat(
        "poses-h5",
        "mocap-calib poses3d.h5",
        arrays.sniff_own,
        arrays.parse_own,
        arrays.write_own,
        (".h5",),
    ),
    PoseFormat(
        "anipose-csv",
        "Anipose CSV",
        anipose_csv.sniff,
        anipose_csv.parse,
        anipose_csv.write,
        (".csv",),
        single=True,
    ),
    PoseFormat(
        "trc", "OpenSim TRC", trc.sniff, trc.parse, trc.write, (".trc",), single=True, timed=True
    ),
    PoseFormat("c3d", "C3D", c3d_file.sniff, c3d_file.parse, c3d_file.write, (".c3d",), timed=True),
    PoseFormat(
        "movement-3d", "movement netCDF", movement.sniff, movement.parse, movement.write, (".nc",)
    ),
    PoseFormat(
        "sleap-anipose",
        "SLEAP-anipose points3d.h5",
        arrays.sniff_sleap_anipose,
        arrays.parse_sleap_anipose,
        arrays.write_sleap_anipose,
        (),
    ),
    PoseFormat(
        "nwb-3d", "NWB with ndx-pose", nwb.sniff, nwb.parse, nwb.write, (".nwb",), timed=True
    ),
    PoseFormat(
        "npz", "numpy archive", arrays.sniff_npz, arrays.parse_npz, arrays.write_npz, (".npz",)
    ),
)
POSE_FORMAT_NAMES = tuple(each.name for each in POSE_FORMATS)


def pose_format(name: str) -> PoseFormat:
    """The format of that name. Raises MismatchError."""
    for each in POSE_FORMATS:
        if each.name == name:
            return each
    raise MismatchError(
        f"expected one of the pose formats {', '.join(POSE_FORMAT_NAMES)}, found {name!r}; use one of them"
    )


def sniff_poses(content: bytes) -> PoseFormat | None:
    """The format that the content is of, if it is of one."""
    try:
        return contained(content, "content", _sniffed, content)
    except FormatError:
        return None


def _sniffed(content: bytes) -> PoseFormat | None:
    return next((each for each in POSE_FORMATS if each.sniff(content)), None)


def parse_poses(
    content: bytes, source: str, name: str | None = None, unit: str | None = None
) -> PoseFile:
    """The poses in a file's content; `source` stands for its path. Raises FormatError, and MismatchError where the file states another unit."""
    file = contained(content, source, _parsed, content, source, name)
    if unit is not None and file.poses.unit not in (ARBITRARY, unit):
        raise MismatchError(
            f"{source}: expected lengths in {file.poses.unit}, as the file says, found --unit {unit}; leave it out"
        )
    return file if unit is None else replace(file, poses=replace(file.poses, unit=unit))


def _parsed(content: bytes, source: str, name: str | None) -> PoseFile:
    form = _sniffed(content) if name is None else pose_format(name)
    if form is None:
        found = f"content that begins with {content[:16]!r}" if content else "an empty file"
        raise malformed(
            source,
            f"one of: {', '.join(POSE_FORMAT_NAMES)}",
            found,
            "export one of these, or name it",
        )
    return check_poses(form.parse(content, source), source)


def read_poses(path: Path, name: str | None = None, unit: str | None = None) -> PoseFile:
    """The 3D poses in a file; `name` is the format, where it is not to be recognised, `unit` what a length of 1 is.

    Raises FormatError and MismatchError.
    """
    return parse_poses(read_bytes(path), str(path), name, unit)


def format_poses(
    file: PoseFile, name: str, path: Path, title: str = ""
) -> tuple[dict[str, bytes], tuple[str, ...]]:
    """The files of the poses in the format by name (of `path`, and further ones beside it), and what they do not carry.

    Raises MismatchError where the format carries too little.
    """
    form = pose_format(name)
    if not form.single:
        written = form.write(file, title)
        return {path.name: written.content}, written.lost
    each = [form.write(_only(file, k), title or path.name) for k in range(len(file.individuals))]
    if not each:
        raise MismatchError(
            f"{name}: expected at least one individual, found none; nothing to write"
        )
    return {of_individual(path, k).name: written.content for k, written in enumerate(each)}, tuple(
        dict.fromkeys(lost for one in each for lost in one.lost)
    )


def write_poses(path: Path, file: PoseFile, name: str, title: str = "") -> tuple[str, ...]:
    """Writes the poses in the format, atomically; individuals beyond the first go to NAME_1, NAME_2, ... where a file holds one.

    Returns what of the poses the format does not carry. Raises MismatchError where it carries too little.
    """
    files, lost = format_poses(file, name, path, title)
    if len(files) == 1:
        write_bytes(path, files[path.name])
        return lost
    with folder(path.absolute().parent) as work:
        for called, content in files.items():
            (work / called).write_bytes(content)
    return lost


def _only(file: PoseFile, individual: int) -> PoseFile:
    """The file with one individual; what it is called stays."""
    arrays_: dict[str, Any] = {
        name: getattr(file.poses, name)[:, individual : individual + 1]
        for name in ("positions", "error", "views", "confidence")
    }
    return replace(
        file, poses=replace(file.poses, **arrays_), individuals=(file.individuals[individual],)
    )


def together(files: list[PoseFile], source: str) -> PoseFile:
    """One individual a file, on all frames that any has. Raises MismatchError where the files do not belong together."""
    first = files[0]
    if len(files) == 1:
        return first
    for each in files[1:]:
        if (each.poses.keypoints, each.poses.unit) != (
            first.poses.keypoints,
            first.poses.unit,
        ) or not np.array_equal(each.rate, first.rate, equal_nan=True):
            raise MismatchError(
                f"{source}: expected files of one recording, found other keypoints, units or rates; give them one by one"
            )
    frames = np.unique(np.concatenate([each.poses.frames for each in files]))
    shape = (len(frames), sum(len(each.individuals) for each in files), len(first.poses.keypoints))
    poses: dict[str, Any] = {name: np.full(shape, np.nan) for name in ("error", "confidence")}
    poses |= {"positions": np.full((*shape, 3), np.nan), "views": np.zeros(shape, dtype=np.int64)}
    at = 0
    for each in files:
        rows = np.searchsorted(frames, each.poses.frames)
        for name, array in poses.items():
            array[rows, at : at + len(each.individuals)] = getattr(each.poses, name)
        at += len(each.individuals)
    notes = tuple(note for each in files for note in each.notes)
    return PoseFile(replace(first.poses, frames=frames, **poses), first.rate, _called(files), notes)


def _called(files: list[PoseFile]) -> tuple[str, ...]:
    """The individuals' names as the files have them, mere numbers counted on from file to file; nothing where two are alike."""
    names = [name for each in files for name in each.individuals]
    names = [f"individual_{k}" if UNNAMED.fullmatch(name) else name for k, name in enumerate(names)]
    return () if repeated(names) else tuple(names)
