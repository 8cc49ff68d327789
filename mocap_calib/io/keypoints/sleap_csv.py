"""SLEAP's analysis .csv: a row per detection, `track,frame_idx,instance.score,<node>.x,<node>.y,<node>.score`."""

from collections.abc import Iterator, Sequence

import numpy as np

from mocap_calib.io.file import malformed
from mocap_calib.io.keypoints.document import Document, Item, ReadOptions
from mocap_calib.io.keypoints.long_table import Points, cells_of, views_of
from mocap_calib.types import Keypoints2D


def sniff(document: Document) -> bool:
    """A header that begins with track and frame_idx."""
    return {"track", "frame_idx"} <= set(document.header)


def read(item: Item, options: ReadOptions) -> tuple[Keypoints2D, ...]:  # noqa: ARG001 - a reader's signature
    """One camera. Frames without detections are absent from the file; tracks are individuals where all rows have one. Raises FormatError."""
    source, header = item.origin.source, item.document.header
    nodes = [name.removesuffix(".x") for name in header if name.endswith(".x")]
    if not nodes or not all(f"{node}.y" in header for node in nodes):
        raise malformed(
            source,
            "columns <node>.x and <node>.y",
            ",".join(header),
            "export the analysis .csv from SLEAP again",
        )
    cells = cells_of(item)
    frames, tracks = cells.columns["frame_idx"], cells.columns["track"]
    tracked = all(tracks)
    who = tracks if tracked else tuple(_places(frames))
    values = np.concatenate(
        [
            np.column_stack([cells.numbers(f"{node}.{part}") for part in ("x", "y", "score")])
            for node in nodes
        ]
    )
    names = [node for node in nodes for _ in frames]
    points = Points(
        (item.camera,) * len(names),
        frames * len(nodes),
        who * len(nodes),
        names,
        values,
        np.tile(cells.lines, len(nodes)),
    )
    return views_of(points, item, tracked, ("frames without a detection are not in the file",))


def _places(frames: Sequence[str]) -> Iterator[str]:
    """The number of each row among those of its frame."""
    seen: dict[str, int] = {}
    for frame in frames:
        yield str(seen.get(frame, 0))
        seen[frame] = seen.get(frame, 0) + 1
