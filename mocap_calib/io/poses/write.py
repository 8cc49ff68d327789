"""Write files of 3D poses in a format of `io.poses.formats`."""

from dataclasses import replace
from pathlib import Path

from mocap_calib.errors import MismatchError
from mocap_calib.io.atomic import individual_files, write_bytes, write_files
from mocap_calib.io.format import Written, find_format
from mocap_calib.io.poses.axes import turn_upright
from mocap_calib.io.poses.common import PoseFile
from mocap_calib.io.poses.formats import POSE_FORMATS


def format_poses(file: PoseFile, format: str, path: Path, title: str = "") -> Written:
    """Return the files of the poses in the format, and what they do not carry.

    path: gives the name of the file. Where a file holds one individual and there are several, the
        files are called NAME_0, NAME_1, ...
    title: of the poses, for formats that have a place for one.

    Where the poses say what is up, they are turned so that it is the axis that the format's readers
    take for up.

    Raises MismatchError where the format carries too little.
    """
    known = find_format(POSE_FORMATS, format)
    file = turn_upright(file, known.up)
    if not known.single:
        written = known.writer()(file, title)
        return Written({path.name: written.content}, written.lost)
    if not file.individuals:
        raise MismatchError(format, "at least one individual", "none", "nothing to write")
    files: dict[str, bytes] = {}
    lost: dict[str, None] = {}  # which keeps the order
    for individual, own in enumerate(individual_files(path, len(file.individuals))):
        written = known.writer()(_select_individual(file, individual), title or own.name)
        files[own.name] = written.content
        lost |= dict.fromkeys(written.lost)
    return Written(files, tuple(lost))


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
