"""Read SLEAP's analysis .csv: a row per detection.

The header is `track,frame_idx,instance.score,<node>.x,<node>.y,<node>.score,...`. Traps: frames
without a detection are absent; `track` is empty where nobody was followed.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.keypoints.long_table import Points, views_from_points
from mocap_calib.io.keypoints.options import ReadOptions
from mocap_calib.io.keypoints.table_cells import Cells, read_cells
from mocap_calib.types import Floats, Keypoints2D

_ABSENT_FRAMES = "frames without a detection are not in the file"


def sniff(document: Document) -> bool:
    """Return whether the header has track and frame_idx."""
    return {"track", "frame_idx"} <= set(document.header)


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read one camera; tracks are individuals where all rows have one. Raises FormatError."""
    nodes = _find_nodes(document)
    cells = read_cells(document)
    frames, tracks = cells.columns["frame_idx"], cells.columns["track"]
    tracked = all(tracks)
    identity = tracks if tracked else tuple(_count_within_frames(frames))
    points = Points(
        camera=(document.camera,) * (len(nodes) * len(cells)),
        frame=frames * len(nodes),
        identity=identity * len(nodes),
        keypoint=[node for node in nodes for _ in frames],
        values=np.concatenate([_values_of_node(cells, node) for node in nodes]),
        lines=np.tile(cells.lines, len(nodes)),
    )
    return views_from_points(points, document, tracked=tracked, remarks=(_ABSENT_FRAMES,))


def _find_nodes(document: Document) -> list[str]:
    """Return the names of the nodes in the header. Raises FormatError."""
    header = document.header
    nodes = [name.removesuffix(".x") for name in header if name.endswith(".x")]
    if not nodes or not all(f"{node}.y" in header for node in nodes):
        raise FormatError(
            document.source,
            "columns <node>.x and <node>.y",
            ",".join(header),
            "export the analysis .csv from SLEAP again",
        )
    return nodes


def _values_of_node(cells: Cells, node: str) -> Floats:
    """Return `[row, 3]` x, y and score of a node."""
    return np.column_stack([cells.numbers(f"{node}.{part}") for part in ("x", "y", "score")])


def _count_within_frames(frames: Sequence[str]) -> Iterator[str]:
    """Return the number of each row among the rows of its frame."""
    rows_of_frame: dict[str, int] = {}
    for frame in frames:
        yield str(rows_of_frame.get(frame, 0))
        rows_of_frame[frame] = rows_of_frame.get(frame, 0) + 1


TABLE = Format(
    kind="keypoints",
    name="sleap-csv",
    title="SLEAP analysis .csv",
    sniff=sniff,
    read=read,
)
