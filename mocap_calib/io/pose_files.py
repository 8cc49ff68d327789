"""Read and write files of 3D poses.

`read_poses` returns the poses; `load_poses` all that a file says.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mocap_calib.errors import FormatError, MismatchError, argument
from mocap_calib.io.atomic import individual_files, write_bytes, write_files
from mocap_calib.io.crash_guard import guard_hdf5
from mocap_calib.io.document import Document, as_document
from mocap_calib.io.file import find_repeated
from mocap_calib.io.format import FormatTable, Written
from mocap_calib.io.formats import (
    anipose_csv,
    blender,
    bvh,
    c3d_file,
    movement,
    npz,
    nwb,
    own_poses,
    rerun_file,
    sleap_anipose,
    trc,
)
from mocap_calib.io.pose_axes import turn_upright
from mocap_calib.io.poses import UNNAMED, PoseFile, check_poses
from mocap_calib.io.units import ARBITRARY, refuse_unit
from mocap_calib.results import Poses3D

OWN = "poses-h5"  # the format of a run

POSE_FORMATS = FormatTable(
    "poses",
    (
        own_poses.POSES,
        anipose_csv.POSES,
        trc.POSES,
        c3d_file.POSES,
        movement.POSES,
        sleap_anipose.POSES,
        nwb.POSES,
        npz.POSES,
        bvh.POSES,
        blender.POSES,
        rerun_file.POSES,
    ),
)


def read_poses(
    path: str | Path | bytes, format: str | None = None, unit: str | None = None
) -> Poses3D:
    """Read the 3D poses in a file; the arguments are those of `load_poses`.

    Raises FormatError and MismatchError.
    """
    return load_poses(path, format, unit).poses


def load_poses(
    path: str | Path | bytes, format: str | None = None, unit: str | None = None
) -> PoseFile:
    """Read all that a file says of 3D poses: also frames per second and names.

    path: of the file, or its content.
    format: name of a pose format; where none is given, the content says it.
    unit: what a length of 1 is ("m", "cm", "mm"), where the file does not say.

    Raises FormatError, and MismatchError where the file states another unit.
    """
    # a format that is named is taken at its word: its own refusal says more
    document = replace(as_document(path), format=format)
    known, file = guard_hdf5(document, _read, document, format)
    if unit is None:
        return file
    if known == OWN and file.poses.unit == ARBITRARY:
        raise refuse_unit(document.source, unit)
    if file.poses.unit not in (ARBITRARY, unit):
        raise MismatchError(
            document.source,
            f"lengths in {file.poses.unit}, as the file says",
            argument("input_unit", unit),
            "leave it out",
        )
    return replace(file, poses=replace(file.poses, unit=unit))


def looks_like_poses(path: Path | bytes) -> bool:
    """Return whether the content of a file is of one of the formats."""
    document = as_document(path)
    try:
        return bool(guard_hdf5(document, _sniff, document))
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


def _sniff(document: Document) -> str:
    """Return the name of the format that the content shows. Raises FormatError."""
    return POSE_FORMATS.sniff(document)


def _read(document: Document, format: str | None) -> tuple[str, PoseFile]:
    """Return the name of the format, and the poses. Raises FormatError."""
    known = POSE_FORMATS.require(document, format, "export one of these, or name it")
    return known.name, check_poses(known.reader()(document), document.source)


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


def format_poses(file: PoseFile, format: str, path: Path, title: str = "") -> Written:
    """Return the files of the poses in the format, and what they do not carry.

    path: gives the name of the file. Where a file holds one individual and there are several, the
        files are called NAME_0, NAME_1, ...
    title: of the poses, for formats that have a place for one.

    Where the poses say what is up, they are turned so that it is the axis that the format's readers
    take for up.

    Raises MismatchError where the format carries too little.
    """
    known = POSE_FORMATS.find(format)
    write = known.writer()
    file = turn_upright(file, known.up)
    if not known.single:
        return Written({path.name: write(file, title)}, known.lost(file))
    if not file.individuals:
        raise MismatchError(format, "at least one individual", "none", "nothing to write")
    names = [own.name for own in individual_files(path, len(file.individuals))]
    files = {
        name: write(_select_individual(file, individual), title or name)
        for individual, name in enumerate(names)
    }
    return Written(files, known.lost(file))


def write_poses(path: str | Path, file: PoseFile, format: str, title: str = "") -> tuple[str, ...]:
    """Write the poses in the format, whole or not at all; the arguments are `format_poses`'.

    Returns what of the poses the format does not carry. Raises MismatchError where it carries too
    little.
    """
    path = Path(path)
    written = format_poses(file, format, path, title)
    if path.name in written.files:
        write_bytes(path, written.files[path.name])
    else:
        write_files(path.absolute().parent, written.files)
    return written.lost


def _select_individual(file: PoseFile, individual: int) -> PoseFile:
    """Return the file with one individual alone; what it is called stays."""
    poses = file.poses.select([individual])
    return replace(file, poses=poses, individuals=(file.individuals[individual],))
