"""Read and write OpenPose's JSON: a folder per camera, a file per frame.

Traps: people come in any order, and one without numbers keeps the place; keypoints have no names,
and 75 numbers are BODY_25 or BODY_25B; missing points are (0, 0, 0). AlphaPose writes the same,
also with all frames in one file, and CMU Panoptic with other keys.
"""

import json
from typing import Any

import msgspec
import numpy as np

from mocap_calib.errors import MismatchError
from mocap_calib.io.detections import (
    FOLLOWED,
    NAMES,
    SCORES,
    SIZES,
    frame_numbers,
    frames_of,
    triples,
    view_of_frames,
)
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.types import Floats, Keypoints2D, Reals

# OpenPose's, or AlphaPose's, only layouts of their length
_LAYOUTS = ("coco_18", "mpi_15", "body_135", "halpe_136", "coco_wholebody_133")
_VERSION = 1.3
_DIGITS = 12  # of a frame number in a file name


class _Person(msgspec.Struct):
    """x, y, c of each point, by OpenPose's key or CMU Panoptic's."""

    pose_keypoints_2d: list[float | None] | None = None
    joints: list[float | None] | None = None


class _Frame(msgspec.Struct):
    """The people of a frame, by OpenPose's key or CMU Panoptic's, which AlphaPose also writes."""

    people: list[_Person] | None = None
    bodies: list[_Person] | None = None


def sniff(document: Document) -> bool:
    """Return whether this is an object with a list of people, or one of such objects by image."""
    content = document.json
    if _is_frame(content):
        return True
    return isinstance(content, dict) and bool(content) and all(map(_is_frame, content.values()))


def _is_frame(content: Any) -> bool:
    keys = ("people", "bodies")
    return isinstance(content, dict) and any(isinstance(content.get(key), list) for key in keys)


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read the people of one camera. Raises FormatError."""
    if document.is_folder or _is_frame(document.json):
        names, numbers = frames_of(document)
        people = [_people(each.records(_Frame), each) for each in document.documents()]
    else:
        frames = document.records(dict[str, _Frame])
        names, numbers = list(frames), frame_numbers(list(frames), document.source)
        people = [_people(frame, document) for frame in frames.values()]
    view = view_of_frames(document, options, numbers, people, unambiguous=_LAYOUTS, rows=names)
    return (view,)


def _people(frame: _Frame, document: Document) -> list[Floats]:
    """Return `[keypoint, 3]` of each person, `[0, 3]` where one has none. Raises FormatError."""
    people = frame.bodies if frame.people is None else frame.people
    if people is None:
        raise document.refuse("an object with a list `people`", "none")
    return [
        triples(
            person.pose_keypoints_2d or person.joints or [],
            f"{document.source}: person {number}",
            "pose_keypoints_2d",
        )
        for number, person in enumerate(people)
    ]


def write(views: tuple[Keypoints2D, ...]) -> dict[str, bytes]:
    """Write a folder per camera, a file per frame; the names of keypoints have no place in it.

    Raises MismatchError where a frame number has more digits than file names have.
    """
    files = {}
    for view in views:
        if view.frames.max(initial=0) >= 10**_DIGITS:
            expected, remedy = f"frame numbers of at most {_DIGITS} digits", "choose another format"
            raise MismatchError(view.source, expected, view.frames.max(), remedy)
        for index, number in enumerate(view.frames):
            name = f"{view.camera}_json/{view.camera}_{number:0{_DIGITS}d}_keypoints.json"
            seen = np.flatnonzero(np.isfinite(view.positions[index, ..., 0]).any(-1))
            people = [
                _person(view.positions[index, instance], view.confidence[index, instance])
                for instance in range(seen.max(initial=-1) + 1)
            ]
            files[name] = json.dumps({"version": _VERSION, "people": people}).encode()
    return files


def _person(positions: Reals, confidence: Reals) -> dict[str, Any]:
    """Return a person of `[keypoint, 2]` positions and `[keypoint]` confidences.

    A person without any point has no numbers, which keeps the place of the others.
    """
    values = np.nan_to_num(np.column_stack([positions, confidence])).ravel().tolist()
    is_there = np.isfinite(positions).any()
    return {"person_id": [-1], "pose_keypoints_2d": values if is_there else []}


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
