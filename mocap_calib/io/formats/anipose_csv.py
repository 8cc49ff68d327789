"""Anipose's pose-3d CSV: one individual a file.

* A keypoint has six columns: NAME_x, NAME_y, NAME_z, NAME_error, NAME_ncams, NAME_score.
* Behind them stand columns M_ij and center_k (how the axes of the file came from those of the
  cameras, which is not undone here) and `fnum`, the frame number.
* An empty cell is missing. There is no unit of length and no rate.
"""

import csv
import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.io.atomic import (
    check_no_further_individual,
    individual_files,
    replace_folder,
    write_pieces,
)
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.poses import (
    COVARIANCES,
    INDIVIDUALS,
    UNIT,
    PoseFile,
    mark_missing,
)
from mocap_calib.io.results.csv_text import format_csv_line, format_lines, slice_frames
from mocap_calib.io.units import ARBITRARY
from mocap_calib.results import Poses3D
from mocap_calib.types import Floats, Ints

_FIELDS = ("x", "y", "z", "error", "ncams", "score")
_FRAME = "fnum"
_LONGEST_HEADER = 1_000_000  # bytes
_MOST_VIEWS = 1e6  # what no file has
_REMEDY = "export them again"


def sniff(document: Document) -> bool:
    """Return whether the first line has the names of the columns."""
    header = document.start[:_LONGEST_HEADER].split(b"\n", 1)[0]
    return b"_ncams" in header and b"_x" in header and _FRAME.encode() in header


# --- reading


def read(document: Document) -> PoseFile:
    """Read the poses in the axes of the file. Raises FormatError."""
    header, rows = _split_rows(document)
    names = _find_keypoints(header, document.source)
    columns = {name: index for index, name in enumerate(header)}
    table = _parse_table(rows, len(header), document.source)
    frames = _parse_frames(table[:, columns[_FRAME]], document.source)
    wanted = [columns[f"{name}_{field}"] for name in names for field in _FIELDS]
    values = table[:, wanted].reshape(len(table), 1, len(names), len(_FIELDS))
    views = np.nan_to_num(values[..., 4], nan=0.0, posinf=0.0, neginf=0.0).clip(0, _MOST_VIEWS)
    poses = Poses3D(
        keypoints=tuple(names),
        frames=frames,
        positions=mark_missing(values[..., :3]),
        error=values[..., 3],
        views=views.astype(np.int64),
        confidence=values[..., 5],
        unit=ARBITRARY,
    )
    return PoseFile(poses)


def _split_rows(document: Document) -> tuple[list[str], list[list[str]]]:
    """Return the cells of the header and of each row that is not empty. Raises FormatError."""
    text = io.StringIO(document.text, newline="")
    try:
        rows = [row for row in csv.reader(text) if row]
    except (csv.Error, ValueError) as error:
        raise document.refuse("comma-separated values", error, _REMEDY) from None
    if not rows:
        raise document.refuse("comma-separated values", "no row", _REMEDY)
    return rows[0], rows[1:]


def _find_keypoints(header: list[str], source: str) -> list[str]:
    """Return the names of the keypoints, which have all their columns. Raises FormatError."""
    names = [name.removesuffix("_ncams") for name in header if name.endswith("_ncams")]
    wanted = [f"{name}_{field}" for name in names for field in _FIELDS]
    columns = set(header)
    missing = [column for column in wanted if column not in columns]
    if missing or not names or _FRAME not in columns or len(columns) < len(header):
        expected = f"columns {', '.join(_FIELDS)} of each keypoint, and fnum, each once"
        found = f"no {', '.join(missing) or 'such names'}"
        raise FormatError(f"{source}: line 1", expected, found, _REMEDY)
    return names


def _parse_table(rows: list[list[str]], width: int, source: str) -> Floats:
    """Return the numbers `[row, column]`, NaN where a cell is empty. Raises FormatError."""
    table = np.full((len(rows), width), np.nan)
    for index, row in enumerate(rows):
        try:
            if len(row) != width:
                raise ValueError(f"{len(row)} cells")
            table[index] = [float(cell) if cell.strip() else np.nan for cell in row]
        except ValueError as error:
            where = f"{source}: row {index + 2}"
            expected = f"{width} numbers or empty cells"
            raise FormatError(where, expected, error, "mend the row") from None
    return table


def _parse_frames(numbers: Floats, source: str) -> Ints:
    """Return `[frame]` numbers. Raises FormatError."""
    whole = np.isfinite(numbers) & (numbers == np.round(numbers)) & (np.abs(numbers) < 2**53)
    if not whole.all():
        raise FormatError(source, "a whole number fnum in each row", "others", _REMEDY)
    return numbers.astype(np.int64)


# --- writing


def write(file: PoseFile, title: str) -> bytes:
    """Write the one individual."""
    return b"".join(poses_csv(file.poses, 0))


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


POSES = Format(
    kind="poses",
    name="anipose-csv",
    title="Anipose CSV",
    sniff=sniff,
    read=read,
    write=write,
    endings=(".csv",),
    single=True,
    loses=(UNIT, COVARIANCES, INDIVIDUALS),
)
