"""Hold what formats with an entry per frame or per image share.

Frame numbers and cameras from names, points from lists.
"""

import re
from collections.abc import Iterator, Sequence
from typing import Any, TypeVar

import msgspec
import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.document import Document
from mocap_calib.io.file import find_camera, frame_number, make_view, stack_detections
from mocap_calib.io.keypoints.layouts import choose_layout
from mocap_calib.io.keypoints.options import ReadOptions
from mocap_calib.types import Floats, Keypoints2D

T = TypeVar("T")


def frames_of(document: Document) -> tuple[list[str], list[int]]:
    """Return the names and numbers of the frames in a folder with a file per frame.

    Raises FormatError.
    """
    names = [path.name for path in document.members or (document.path,)]
    return names, frame_numbers(names, document.source)


def json_frames(document: Document) -> Iterator[tuple[Any, str]]:
    """Return the JSON of each file of a folder, a frame each, and the file as messages name it.

    Raises FormatError where a file is no JSON.
    """
    for each in document.documents():
        if each.json is None:
            found = each.describe()[0]
            raise each.refuse("JSON of a frame", found, "export it again, or remove it")
        yield each.json, each.source


def frame_numbers(names: Sequence[str], source: str) -> list[int]:
    """Return the integer at the end of each name, before its suffix and `_keypoints`.

    Where a name has none there, the last integer of each name is taken. Raises FormatError.
    """
    stems = [_without_addition(name) for name in names]
    numbers = [frame_number(stem) for stem in stems]
    if min(numbers, default=0) < 0:
        numbers = [_last_integer(stem) for stem in stems]
    if min(numbers, default=0) < 0:
        raise FormatError(
            source,
            "a frame number in each file name",
            stems[numbers.index(min(numbers))],
            "rename or remove it",
        )
    return numbers


def _without_addition(name: str) -> str:
    """Return a file name without its folders and without OpenPose's `_keypoints`."""
    file_name = re.split(r"[/\\]", name)[-1]
    return re.sub(r"_keypoints(?=(\.\w+)?$)", "", file_name)


def _last_integer(name: str) -> int:
    integers = re.findall(r"[0-9]+", name)
    return frame_number(integers[-1]) if integers else -1


def cameras_by_pattern(names: Sequence[str], pattern: str, *, named: str, source: str) -> list[str]:
    """Return the camera of each name as the user's pattern finds it.

    named: what the format calls a name. Nothing is returned where there is no pattern, or where it
    finds no camera at all; FormatError is raised where it finds some only.
    """
    cameras = [find_camera(name, pattern) for name in names] if pattern else []
    if not any(cameras):
        return []
    if not all(cameras):
        raise FormatError(
            source,
            f"a camera in each {named} by the pattern {pattern}",
            names[cameras.index("")],
            "change it",
        )
    return cameras


def most_keypoints(detections: Sequence[Sequence[Floats]], *, named: str, source: str) -> int:
    """Return the length of the longest `[keypoint, 3]` detection of all frames.

    named: what the format calls a detection. Raises FormatError where there is none.
    """
    count = max((len(points) for frame in detections for points in frame), default=0)
    if count == 0:
        raise FormatError(
            source,
            f"{named} in one of its frames",
            f"none in {len(detections)} frames",
            "check the detector's output",
        )
    return count


def triples(points: Any, source: str, *, named: str = "keypoints") -> Floats:
    """Return `[keypoint, 3]` of a flat list x, y, c; `named` is what messages call it.

    Raises FormatError.
    """
    if not isinstance(points, list) or len(points) % 3:
        found = f"{len(points)} numbers" if isinstance(points, list) else type(points).__name__
        raise FormatError(source, f"`{named}` to be a list of x, y, c", found, "export it again")
    return numbers_of(points, source, named=named).reshape(-1, 3)


def numbers_of(values: Any, source: str, *, named: str) -> Floats:
    """Return the array `[...]` of what JSON holds; null is NaN. Raises FormatError."""
    try:
        return np.asarray(values, dtype=np.float64)
    except (ValueError, TypeError, OverflowError) as error:
        raise FormatError(source, f"`{named}` to hold numbers", error, "export it again") from None


def is_list_of(entries: Any, *keys: str) -> bool:
    """Return whether this is a list whose first entries are objects with these keys."""
    if not isinstance(entries, list) or not entries:
        return False
    return all(isinstance(entry, dict) and set(keys) <= entry.keys() for entry in entries[:20])


def typed(document: Document, kind: type[T]) -> T:
    """Return the JSON of a document as records. Raises FormatError with the place in the file."""
    try:
        return msgspec.convert(document.json, kind)
    except (msgspec.ValidationError, OverflowError) as error:
        said = re.fullmatch(r"Expected (.+), got (.+?) - at `(.+)`", str(error))
        if said is None:
            raise document.refuse("JSON as the format has it", error) from None
        raise document.refuse(f"{said[1]} at {said[3]}", said[2]) from None


def view_of_frames(
    document: Document,
    options: ReadOptions,
    frames: Sequence[int],
    detections: Sequence[Sequence[Any]],
    *,
    unambiguous: tuple[str, ...] = (),
    rows: Sequence[object] | None = None,
) -> Keypoints2D:
    """Return the camera of detections in any order whose keypoints have no names.

    frames: `[frame]` numbers.
    detections: `[keypoint, 3]` x, y and confidence of each detection of each frame.
    unambiguous: see `choose_layout`. rows: see `make_view`.

    Raises FormatError.
    """
    count = max((len(points) for frame in detections for points in frame), default=0)
    if count == 0:
        found, remedy = f"none in {len(detections)} frames", "check the detector's output"
        raise document.refuse("detections in one of its frames", found, remedy)
    names = choose_layout(
        count, given=options.layout, source=document.source, unambiguous=unambiguous
    )
    values = stack_detections(detections, count, document.source)
    return make_view(document.origin, names, frames, values, tracked=False, rows=rows)
