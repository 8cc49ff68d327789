"""Anipose's pose-3d CSV: one individual a file.

* A keypoint has six columns: NAME_x, NAME_y, NAME_z, NAME_error, NAME_ncams, NAME_score.
* Behind them stand columns M_ij and center_k (how the axes of the file came from those of the
  cameras, which is not undone here) and `fnum`, the frame number.
* An empty cell is missing. There is no unit of length and no rate.
"""

from collections.abc import Iterator

import numpy as np

from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.io.document import Document
from mocap_calib.io.file import are_whole
from mocap_calib.io.format import Format
from mocap_calib.io.poses import COVARIANCES, INDIVIDUALS, MOST_VIEWS, UNIT, PoseFile, mark_missing
from mocap_calib.io.table import format_csv_line, format_lines, read_rows, read_table, slice_frames
from mocap_calib.io.units import ARBITRARY
from mocap_calib.results import Poses3D
from mocap_calib.types import Floats

_FIELDS = ("x", "y", "z", "error", "ncams", "score")
_FRAME = "fnum"
_REMEDY = "export them again"


def sniff(document: Document) -> bool:
    """Return whether the first line has the names of the columns."""
    header = document.start.split(b"\n", 1)[0]
    return b"_ncams" in header and b"_x" in header and _FRAME.encode() in header


# --- reading


def read(document: Document) -> PoseFile:
    """Read the poses in the axes of the file. Raises FormatError."""
    _, header = next(read_rows(document), (0, []))
    names = [name.removesuffix("_ncams") for name in header if name.endswith("_ncams")]
    wanted = [f"{name}_{field}" for name in names for field in _FIELDS] + [_FRAME]
    columns = set(header)
    missing = [column for column in wanted if column not in columns]
    if missing or not names:
        expected = f"columns {', '.join(_FIELDS)} of each keypoint, and fnum"
        raise document.refuse(expected, f"no {', '.join(missing) or 'such names'}", _REMEDY)
    numbers = read_table(document, texts=(), numbers=wanted).numbers
    frames = numbers[:, -1]
    if not are_whole(frames):
        raise document.refuse("a whole number fnum in each row", "others", _REMEDY)
    values = numbers[:, :-1].reshape(len(frames), 1, len(names), len(_FIELDS))
    views = np.nan_to_num(values[..., 4], nan=0.0, posinf=0.0, neginf=0.0).clip(0, MOST_VIEWS)
    poses = Poses3D(
        keypoints=tuple(names),
        frames=frames.astype(np.int64),
        positions=mark_missing(values[..., :3]),
        error=values[..., 3],
        views=views.astype(np.int64),
        confidence=values[..., 5],
        unit=ARBITRARY,
    )
    return PoseFile(poses)


# --- writing


def write(file: PoseFile, title: str) -> bytes:
    """Write the one individual."""
    return b"".join(poses_csv(file.poses, 0))


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
    name="anipose-csv",
    title="Anipose CSV",
    sniff=sniff,
    read=read,
    write=write,
    endings=(".csv",),
    single=True,
    loses=(UNIT, COVARIANCES, INDIVIDUALS),
)
