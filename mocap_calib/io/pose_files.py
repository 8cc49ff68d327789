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
from mocap_calib.io.format import FormatTable, Written
from mocap_calib.io.formats import (
    anipose_csv,
    blender,
    bvh,
    c3d_file,
    movement,
    nwb,
    own_poses,
    rerun_file,
    sleap_anipose,
    trc,
)
from mocap_calib.io.poses import UNNAMED, PoseFile, check_poses, turn_upright
from mocap_calib.io.units import ARBITRARY, refuse_unit
from mocap_calib.results import Poses3D
from mocap_calib.types import Ints, Reals

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
        own_poses.ARCHIVE,
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
        expected = f"lengths in {file.poses.unit}, as the file says"
        owner = document.source
        raise MismatchError(owner, expected, argument("input_unit", unit), "leave it out")
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
    parts = [file.poses for file in files]
    if any(
        (own.keypoints, own.unit, str(file.rate))
        != (first.poses.keypoints, first.poses.unit, str(first.rate))
        for own, file in zip(parts, files, strict=True)
    ):
        found = "other keypoints, units or rates"
        raise MismatchError(source, "files of one recording", found, "give them one by one")
    frames = np.unique(np.concatenate([part.frames for part in parts]))
    arrays: dict[str, Any] = {}
    for name in ("positions", "error", "views", "confidence", "covariance", "raw", "source"):
        each = [_spread(getattr(part, name), part.frames, frames) for part in parts]
        arrays[name] = np.concatenate(each, axis=1)
    return PoseFile(
        replace(parts[0], frames=frames, **arrays),
        first.rate,
        _join_names(files),
        tuple(note for file in files for note in file.notes),
        first.edges,
        joints=first.joints,
    )


def _spread(values: Reals, frames: Ints, all_frames: Ints) -> Reals:
    """Return `[frame, ...]` on all frames, NaN or 0 on those that it lacks."""
    missing = np.nan if values.dtype.kind == "f" else 0
    found = np.full((len(all_frames), *values.shape[1:]), missing, values.dtype)
    found[np.searchsorted(all_frames, frames)] = values
    return found


def _join_names(files: Sequence[PoseFile]) -> tuple[str, ...]:
    """Return the names of all individuals; nothing where two are alike.

    Mere numbers (`individual_0`) are counted on from file to file.
    """
    given = [name for file in files for name in file.individuals]
    names = (f"individual_{k}" if UNNAMED.fullmatch(name) else name for k, name in enumerate(given))
    unique = tuple(dict.fromkeys(names))
    return unique if len(unique) == len(given) else ()


def _sniff(document: Document) -> str:
    """Return the name of the format that the content shows. Raises FormatError."""
    return POSE_FORMATS.sniff(document)


def _read(document: Document, format: str | None) -> tuple[str, PoseFile]:
    """Return the name of the format, and the poses. Raises FormatError."""
    known = POSE_FORMATS.require(document, format, "export one of these, or name it")
    return known.name, check_poses(known.reader()(document), document.source)


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
    files = {
        own.name: write(_select_individual(file, individual), title or own.name)
        for individual, own in enumerate(individual_files(path, len(file.individuals)))
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
