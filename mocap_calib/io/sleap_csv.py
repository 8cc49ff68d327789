"""SLEAP's analysis .csv: a row per detection, `track,frame_idx,instance.score,<node>.x,<node>.y,<node>.score`."""

from mocap_calib.io.document import Document, Item, ReadOptions
from mocap_calib.io.long_table import Row, cells_of, number, views_of
from mocap_calib.io.reading import malformed
from mocap_calib.types import Keypoints2D


def sniff(document: Document) -> bool:
    """A header that begins with track and frame_idx."""
    return {"track", "frame_idx"} <= set(document.header)


def read(item: Item, options: ReadOptions) -> tuple[Keypoints2D, ...]:  # noqa: ARG001 - a reader's signature
    """One camera. Frames without detections are absent from the file; tracks are individuals where all rows have one. Raises FormatError."""
    source, header = item.origin.source, item.document.header
    nodes = [name.removesuffix(".x") for name in header if name.endswith(".x")]
    if not nodes or not all(f"{node}.y" in header for node in nodes):
        raise malformed(source, "columns <node>.x and <node>.y", ",".join(header), "export the analysis .csv from SLEAP again")
    detections = list(cells_of(item))
    tracked = all(cells["track"] for _, cells in detections)
    seen: dict[str, int] = {}
    rows = []
    for place, cells in detections:
        frame = cells["frame_idx"]
        who = cells["track"] if tracked else str(seen.get(frame, 0))
        seen[frame] = seen.get(frame, 0) + 1
        for node in nodes:
            x, y, score = (number(cells.get(f"{node}.{part}", ""), place) for part in ("x", "y", "score"))
            rows.append(Row(item.camera, frame, who, node, x, y, score))
    return views_of(rows, item, tracked, ("frames without a detection are not in the file",))
