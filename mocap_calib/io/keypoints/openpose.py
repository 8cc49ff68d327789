"""OpenPose's JSON: a folder per camera, a file per frame, people in any order; AlphaPose writes it too, and all frames in one file."""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from mocap_calib.errors import MismatchError
from mocap_calib.io.file import make_view, malformed, stack_detections
from mocap_calib.io.keypoints.document import Document, Item, ReadOptions
from mocap_calib.io.keypoints.layouts import layout_for
from mocap_calib.io.keypoints.per_frame import frame_numbers, frames_of, json_frames, triples
from mocap_calib.types import Floats, Keypoints2D

# 75 numbers are BODY_25 or BODY_25B, which is not told apart; the others are OpenPose's, or AlphaPose's, only ones of their length
_SURE = ("coco_18", "mpi_15", "body_135", "halpe_136", "coco_wholebody_133")
_LISTS = {
    "people": "pose_keypoints_2d",
    "bodies": "joints",
}  # OpenPose; CMU Panoptic, which AlphaPose also writes


def sniff(document: Document) -> bool:
    """An object with a list of people, or of such objects by image."""
    content = document.json
    return _is_frame(content) or (
        isinstance(content, dict) and bool(content) and all(map(_is_frame, content.values()))
    )


def _is_frame(content: Any) -> bool:
    return isinstance(content, dict) and any(isinstance(content.get(key), list) for key in _LISTS)


def read(item: Item, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """The people of one camera; a person without numbers keeps the place. Raises FormatError."""
    if not item.members and not _is_frame(item.document.json):
        content = item.document.json
        names, frames = list(content), [(frame, item.origin.source) for frame in content.values()]
        numbers = frame_numbers(names, item.origin.source)
    else:
        names, numbers = frames_of(item)
        frames = json_frames(item)
    people = [list(_people(frame, source)) for frame, source in frames]
    count = next((len(points) for found in people for points in found if len(points)), 0)
    if count == 0:
        raise malformed(
            item.origin.source,
            "people in one of its frames",
            f"none in {len(people)} frames",
            "check the detector's output",
        )
    keypoints = layout_for(count, options.layout, item.origin.source, _SURE)
    values = stack_detections(people, count, item.origin.source)
    return (make_view(item.origin, keypoints, numbers, values, tracked=False, rows=names),)


def _people(frame: Any, source: str) -> Iterator[Floats]:
    """`[keypoint, 3]` of each person in a frame, `[0, 3]` of one without numbers."""
    if not _is_frame(frame):
        raise malformed(
            source,
            "an object with a list `people`",
            type(frame).__name__,
            "the file is damaged: export it again",
        )
    key = next(key for key in _LISTS if isinstance(frame.get(key), list))
    for number, person in enumerate(frame[key]):
        points = person.get(_LISTS[key]) if isinstance(person, dict) else None
        yield triples(points or [], f"{source}: person {number}", named=_LISTS[key])


def write(views: tuple[Keypoints2D, ...]) -> dict[str, bytes]:
    """A folder per camera, a file per frame; the names of the keypoints have no place in it. Raises MismatchError."""
    files = {}
    for view in views:
        if view.frames.max(initial=0) >= 10**12:
            raise MismatchError(
                f"{view.source}: expected frame numbers of at most 12 digits, found {view.frames.max()}; choose another format"
            )
        for k, frame in enumerate(view.frames):
            seen = np.flatnonzero(np.isfinite(view.positions[k, ..., 0]).any(-1))
            people = [
                _person(view.positions[k, i], view.confidence[k, i])
                for i in range(seen.max(initial=-1) + 1)
            ]
            content = json.dumps({"version": 1.3, "people": people})
            files[f"{view.camera}_json/{view.camera}_{frame:012d}_keypoints.json"] = (
                content.encode()
            )
    return files


def _person(positions: Floats, confidence: Floats) -> dict[str, Any]:
    values = (
        np.nan_to_num(np.column_stack([positions, confidence])).ravel().tolist()
        if np.isfinite(positions).any()
        else []
    )
    return {"person_id": [-1], "pose_keypoints_2d": values}
