"""poses3d_0.csv, poses3d_1.csv, ...: the 3D poses of one individual each, in anipose's columns."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.errors import MismatchError
from mocap_calib.io.atomic import (
    check_no_further_individual,
    individual_files,
    replace_folder,
    write_pieces,
)
from mocap_calib.io.results.csv_text import format_csv_line, format_lines, slice_frames
from mocap_calib.results import Poses3D
from mocap_calib.types import Floats

_FIELDS = ("x", "y", "z", "error", "ncams", "score")  # of each keypoint


def check_poses_csv(path: Path, individuals: int) -> None:
    """Raise MismatchError where `write_poses_csv` should not write so many individuals.

    That is where there is none, and where a file there would pass for one more.
    """
    if not individuals:
        raise MismatchError(path, "at least one individual", "none", "nothing to write")
    check_no_further_individual(path, individuals)


def write_poses_csv(path: Path, poses: Poses3D) -> None:
    """Write one individual to `path`, several to NAME_0.csv, NAME_1.csv, ..., all or none."""
    with replace_folder(path.absolute().parent) as work:
        for individual, own in enumerate(individual_files(path, poses.positions.shape[1])):
            write_pieces(work / own.name, poses_csv(poses, individual))


def poses_csv(poses: Poses3D, individual: int) -> Iterator[bytes]:
    """Yield the poses of one individual as CSV in pieces of UTF-8, a row per frame.

    Cells are empty where something is missing. The columns M and center are anipose's later change
    of axes: none here.
    """
    header = [f"{name}_{field}" for name in poses.keypoints for field in _FIELDS]
    header += [f"M_{row}{column}" for row in range(3) for column in range(3)]
    header += [f"center_{axis}" for axis in range(3)]
    yield format_csv_line([*header, "fnum"]).encode()
    no_change = [*np.eye(3).ravel().tolist(), 0.0, 0.0, 0.0]
    axes = "".join(f",{number}" for number in no_change) + ","

    def lines(piece: slice) -> bytes:
        table = _stack_columns(poses, individual, piece)
        return format_lines("", table, axes, poses.frames[piece, None])

    yield from map_in_threads(lines, slice_frames(len(poses.frames), len(header)))


def _stack_columns(poses: Poses3D, individual: int, piece: slice) -> Floats:
    """Return `[frame, 6 keypoint]` x, y, z, error, ncams, score of each keypoint."""
    own = (piece, individual)
    quality = [poses.error[own], poses.views[own].astype(np.float64), poses.confidence[own]]
    table = np.concatenate([poses.positions[own], np.stack(quality, axis=-1)], axis=-1)
    return table.reshape(len(table), -1) + 0.0  # which takes the sign from zeros
