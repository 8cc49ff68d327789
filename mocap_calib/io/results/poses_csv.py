"""poses3d_0.csv, poses3d_1.csv, ...: the 3D poses of one individual each, in anipose's columns."""

from collections.abc import Iterator

import numpy as np

from mocap_calib.io.results.csv_text import format_csv_line, slice_frames
from mocap_calib.types import Floats, Poses3D

_FIELDS = ("x", "y", "z", "error", "ncams", "score")  # of each keypoint


def poses_csv(poses: Poses3D, individual: int) -> Iterator[str]:
    """Yield the poses of one individual as CSV in pieces, a row per frame.

    Cells are empty where something is missing. The columns M and center are anipose's later change
    of axes: none here.
    """
    header = [f"{name}_{field}" for name in poses.keypoints for field in _FIELDS]
    header += [f"M_{row}{column}" for row in range(3) for column in range(3)]
    header += [f"center_{axis}" for axis in range(3)]
    yield format_csv_line([*header, "fnum"])
    no_change = [*np.eye(3).ravel().tolist(), 0.0, 0.0, 0.0]
    axes = ",".join(map(str, no_change))
    for piece in slice_frames(len(poses.frames)):
        rows = _stack_columns(poses, individual, piece).tolist()
        frames = poses.frames[piece].tolist()
        yield "".join(
            f"{_format_row(row)},{axes},{frame}\n" for row, frame in zip(rows, frames, strict=True)
        )


def _format_row(row: list[float]) -> str:
    """Return exact numbers with commas between them, nothing for NaN.

    A list prints its floats with repr, which is exact, and much faster than a call each.
    """
    return str(row)[1:-1].replace(" ", "").replace("nan", "")


def _stack_columns(poses: Poses3D, individual: int, piece: slice) -> Floats:
    """Return `[frame, 6 keypoint]` x, y, z, error, ncams, score of each keypoint."""
    own = (piece, individual)
    quality = [poses.error[own], poses.views[own].astype(np.float64), poses.confidence[own]]
    table = np.concatenate([poses.positions[own], np.stack(quality, axis=-1)], axis=-1)
    return table.reshape(len(table), -1) + 0.0  # which takes the sign from zeros
