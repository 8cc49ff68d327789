"""Read DeepLabCut's SuperAnimal JSON: a list of frames, a list of individuals in each.

Traps: individuals come in any order; keypoints have no names (the .h5 beside it has them); the
frame number is the place in the list.
"""

from typing import Any

from mocap_calib.errors import FormatError
from mocap_calib.io.document import Document
from mocap_calib.io.file import make_view, stack_detections
from mocap_calib.io.format import Format
from mocap_calib.io.keypoints.layouts import choose_layout
from mocap_calib.io.keypoints.options import ReadOptions
from mocap_calib.io.keypoints.per_frame import is_list_of, most_keypoints, numbers_of
from mocap_calib.types import Floats, Keypoints2D


def sniff(document: Document) -> bool:
    """Return whether this is a list of objects with `bodyparts`."""
    return is_list_of(document.json, "bodyparts")


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read one camera. Raises FormatError."""
    source = document.source
    detections = [
        _individuals(frame, f"{source}: frame {number}")
        for number, frame in enumerate(document.json)
    ]
    count = most_keypoints(detections, named="individuals", source=source)
    names = choose_layout(count, given=options.layout, source=source)
    values = stack_detections(detections, count, source)
    return (make_view(document.origin, names, range(len(detections)), values, tracked=False),)


def _individuals(frame: Any, source: str) -> list[Floats]:
    """Return `[keypoint, 3]` x, y, likelihood of each individual. Raises FormatError."""
    entries = frame.get("bodyparts") if isinstance(frame, dict) else None
    if not isinstance(entries, list):
        raise FormatError(
            source,
            "an object with a list `bodyparts`",
            type(frame).__name__,
            "the file is damaged: export it again",
        )
    found = [
        numbers_of(entry, f"{source}, individual {k}", named="bodyparts")
        for k, entry in enumerate(entries)
    ]
    for points in found:
        if points.ndim != 2 or points.shape[1] != 3:
            raise FormatError(
                source,
                "x, y, likelihood for each body part",
                f"shape {list(points.shape)}",
                "export it again",
            )
    return found


FORMAT = Format(
    kind="keypoints",
    name="superanimal",
    title="DeepLabCut SuperAnimal .json",
    sniff=sniff,
    read=read,
)
