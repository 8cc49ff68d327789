"""Where results go: stdout, a file, or a folder.

Places are checked before the work starts; files are written whole or not at all.
"""

import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mocap_calib.errors import MismatchError

if TYPE_CHECKING:
    from mocap_calib.results import Poses3D
    from mocap_calib.types import Recording

STDIO = "-"


def write_text(output: Path, pieces: Iterable[bytes]) -> None:
    """Write text that comes in pieces of UTF-8 to stdout or to a file."""
    from mocap_calib.io.atomic import write_pieces

    if str(output) != STDIO:
        write_pieces(output, pieces)
        return
    for piece in pieces:
        click.echo(piece, nl=False)


def check_file(path: Path) -> None:
    """Raise MismatchError or OSError where a file could not be written."""
    if path.is_dir():
        raise MismatchError(path, "a file to write", "a folder", "give a name within it")
    check_place(path)


def check_poses(path: Path) -> None:
    """Raise MismatchError where the ending of a file is not one of `write_poses`."""
    if path.suffix not in (".h5", ".csv"):
        raise MismatchError(
            path, "a name that ends in .h5 or .csv", path.suffix or "no ending", "rename it"
        )


def check_individuals(path: Path, individuals: int) -> None:
    """Raise MismatchError where `write_poses` should not write the files of so many."""
    from mocap_calib.io.atomic import check_no_further_individual

    if path.suffix == ".csv" and individuals:
        check_no_further_individual(path, individuals)


def write_poses(path: Path, poses: "Poses3D", recording: "Recording", stage: str) -> None:
    """Write the poses of a recording to a .h5 file, or to a .csv file for each individual.

    stage: the command that made them.
    """
    from mocap_calib.io import pose_files
    from mocap_calib.io.formats.own_poses import write_poses_h5
    from mocap_calib.io.poses import PoseFile
    from mocap_calib.io.provenance import provenance
    from mocap_calib.lift.lifter import load_vocabulary
    from mocap_calib.recording.joints import edges_of_keypoints
    from mocap_calib.world.floor import stated_joints

    if path.suffix == ".csv":
        pose_files.write_poses(path, PoseFile(poses), "anipose-csv")
        return
    edges = edges_of_keypoints(load_vocabulary(recording.model), recording.vocabulary)
    file = PoseFile(poses, edges=edges, joints=stated_joints(recording))
    write_poses_h5(path, file, provenance(stage))


def check_folder(path: Path) -> None:
    """Raise MismatchError or OSError where a folder could not be made and filled."""
    if path.exists() and not path.is_dir():
        raise MismatchError(path, "a folder to write, or a new name", "a file", "choose another")
    check_place(path)
    if path.exists():
        check_place(path / "file")


def check_place(path: Path) -> None:
    """Raise MismatchError where nothing can be written at a path: in the nearest folder there.

    It is tried, which is the only way to know.
    """
    folder = next(each for each in path.absolute().parents if each.exists())
    if not folder.is_dir():
        raise MismatchError(folder, "a folder", "a file", "choose another path")
    try:
        with tempfile.TemporaryDirectory(dir=folder, prefix=".mocap-calib."):
            pass
    except OSError as error:
        raise MismatchError(
            folder, "a folder that can be written to", str(error.strerror), "choose another"
        ) from None
