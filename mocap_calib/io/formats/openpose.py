"""Read and write OpenPose's JSON: a folder per camera, a file per frame.

Traps: people come in any order, and one without numbers keeps the place; keypoints have no names,
and 75 numbers are BODY_25 or BODY_25B; missing points are (0, 0, 0). AlphaPose writes the same,
also with all frames in one file, and CMU Panoptic with other keys.
"""

import json
from collections.abc import Iterable
from typing import Any

import numpy as np

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.io.document import Document
from mocap_calib.io.file import make_view, stack_detections
from mocap_calib.io.format import Format
from mocap_calib.io.keypoints.layouts import choose_layout
from mocap_calib.io.keypoints.losses import FOLLOWED, NAMES, SCORES, SIZES
from mocap_calib.io.keypoints.options import ReadOptions
from mocap_calib.io.keypoints.per_frame import frame_numbers, frames_of, json_frames, triples
from mocap_calib.types import Keypoints2D, Reals

# OpenPose's, or AlphaPose's, only layouts of their length
_LAYOUTS = ("coco_18", "mpi_15", "body_135", "halpe_136", "coco_wholebody_133")
# the list of a frame, and the list of a person: OpenPose; CMU Panoptic, which AlphaPose also writes
_LISTS = {"people": "pose_keypoints_2d", "bodies": "joints"}
_VERSION = 1.3
_DIGITS = 12  # of a frame number in a file name


def sniff(document: Document) -> bool:
    """Return whether this is an object with a list of people, or one of such objects by image."""
    content = document.json
    if _is_frame(content):
        return True
    return isinstance(content, dict) and bool(content) and all(map(_is_frame, content.values()))


def _is_frame(content: Any) -> bool:
    return isinstance(content, dict) and any(isinstance(content.get(key), list) for key in _LISTS)


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read the people of one camera. Raises FormatError."""
    source = document.source
    file_names, numbers, frames = _frames(document)
    people = [_people(frame, frame_source) for frame, frame_source in frames]
    count = _count_keypoints(people, source)
    keypoints = choose_layout(count, given=options.layout, source=source, unambiguous=_LAYOUTS)
    values = stack_detections(people, count, source)
    return (make_view(document.origin, keypoints, numbers, values, tracked=False, rows=file_names),)


def _frames(document: Document) -> tuple[list[str], list[int], Iterable[tuple[Any, str]]]:
    """Return the names, the numbers, and the content of the frames with what messages call it."""
    if document.members or _is_frame(document.json):
        names, numbers = frames_of(document)
        return names, numbers, json_frames(document)
    source, content = document.source, document.json
    names = list(content)
    return names, frame_numbers(names, source), [(frame, source) for frame in content.values()]


def _people(frame: Any, source: str) -> list[Any]:
    """Return `[keypoint, 3]` of each person in a frame, `[0, 3]` of one without numbers.

    Raises FormatError.
    """
    if not _is_frame(frame):
        raise FormatError(
            source,
            "an object with a list `people`",
            type(frame).__name__,
            "the file is damaged: export it again",
        )
    key = next(key for key in _LISTS if isinstance(frame.get(key), list))
    people = []
    for number, person in enumerate(frame[key]):
        points = person.get(_LISTS[key]) if isinstance(person, dict) else None
        people.append(triples(points or [], f"{source}: person {number}", named=_LISTS[key]))
    return people


def _count_keypoints(people: list[list[Any]], source: str) -> int:
    """Return the number of keypoints of the first person that has any. Raises FormatError."""
    for people_of_frame in people:
        for points in people_of_frame:
            if len(points):
                return len(points)
    raise FormatError(
        source,
        "people in one of its frames",
        f"none in {len(people)} frames",
        "check the detector's output",
    )


def write(views: tuple[Keypoints2D, ...]) -> dict[str, bytes]:
    """Write a folder per camera, a file per frame; the names of keypoints have no place in it.

    Raises MismatchError.
    """
    files = {}
    for view in views:
        _check_frame_numbers(view)
        for index, number in enumerate(view.frames):
            name = f"{view.camera}_json/{view.camera}_{number:0{_DIGITS}d}_keypoints.json"
            content = {"version": _VERSION, "people": _people_of_frame(view, index)}
            files[name] = json.dumps(content).encode()
    return files


def _check_frame_numbers(view: Keypoints2D) -> None:
    """Raise MismatchError where a frame number has more digits than file names have."""
    if view.frames.max(initial=0) >= 10**_DIGITS:
        raise MismatchError(
            view.source,
            f"frame numbers of at most {_DIGITS} digits",
            view.frames.max(),
            "choose another format",
        )


def _people_of_frame(view: Keypoints2D, frame: int) -> list[dict[str, Any]]:
    """Return the people of a frame (an index), up to the last that is seen."""
    seen = np.flatnonzero(np.isfinite(view.positions[frame, ..., 0]).any(-1))
    return [
        _person(view.positions[frame, instance], view.confidence[frame, instance])
        for instance in range(seen.max(initial=-1) + 1)
    ]


def _person(positions: Reals, confidence: Reals) -> dict[str, Any]:
    """Return a person of `[keypoint, 2]` positions and `[keypoint]` confidences.

    A person without any point has no numbers, which keeps the place of the others.
    """
    if not np.isfinite(positions).any():
        return {"person_id": [-1], "pose_keypoints_2d": []}
    values = np.nan_to_num(np.column_stack([positions, confidence]))
    return {"person_id": [-1], "pose_keypoints_2d": values.ravel().tolist()}


FORMAT = Format(
    kind="keypoints",
    name="openpose",
    title="OpenPose .json, a folder per camera",
    sniff=sniff,
    read=read,
    write=write,
    per_frame=True,
    loses=(NAMES, FOLLOWED, SIZES, SCORES),
)
