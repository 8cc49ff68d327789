"""DeepLabCut's SuperAnimal JSON: a list of frames, individuals in any order, no names of keypoints. The .h5 beside it has them."""

from typing import Any

from mocap_calib.io.file import make_view, malformed, stack_detections
from mocap_calib.io.keypoints.document import Document, Item, ReadOptions
from mocap_calib.io.keypoints.layouts import layout_for
from mocap_calib.io.keypoints.per_frame import numbers_of
from mocap_calib.types import Floats, Keypoints2D


def sniff(document: Document) -> bool:
    """A list of objects with `bodyparts`."""
    frames = document.json
    return (
        isinstance(frames, list)
        and bool(frames)
        and all(isinstance(frame, dict) and "bodyparts" in frame for frame in frames[:20])
    )


def read(item: Item, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """One camera; the frame number is the place in the list. Raises FormatError."""
    source = item.origin.source
    frames = [
        list(_individuals(frame, f"{source}: frame {k}"))
        for k, frame in enumerate(item.document.json)
    ]
    count = max((len(points) for found in frames for points in found), default=0)
    if count == 0:
        raise malformed(
            source,
            "individuals in one of its frames",
            f"none in {len(frames)} frames",
            "check the detector's output",
        )
    names = layout_for(count, options.layout, source)
    return (
        make_view(
            item.origin,
            names,
            range(len(frames)),
            stack_detections(frames, count, source),
            tracked=False,
        ),
    )


def _individuals(frame: Any, source: str) -> list[Floats]:
    entries = frame.get("bodyparts") if isinstance(frame, dict) else None
    if not isinstance(entries, list):
        raise malformed(
            source,
            "an object with a list `bodyparts`",
            type(frame).__name__,
            "the file is damaged: export it again",
        )
    found = [
        numbers_of(entry, f"{source}, individual {k}", "bodyparts")
        for k, entry in enumerate(entries)
    ]
    wrong = [points for points in found if points.ndim != 2 or points.shape[1] != 3]
    if wrong:
        raise malformed(
            source,
            "x, y, likelihood for each body part",
            f"shape {list(wrong[0].shape)}",
            "export it again",
        )
    return found
