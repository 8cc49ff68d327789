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
    triples,
    view_of_frames,
)
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.types import Bools, Floats, Keypoints2D

# the only layouts of their length of OpenPose, AlphaPose, and what Pose2Sim writes in this format
_LAYOUTS = (
    *("coco_18", "mpi_15", "body_135", "halpe_136", "coco_wholebody_133"),
    *("blazepose_33", "openpose_134"),
)
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
        frames = {each.path.name: (each.records(_Frame), each) for each in document.documents()}
    else:
        by_image = document.records(dict[str, _Frame])
        frames = {image: (frame, document) for image, frame in by_image.items()}
    people = [_people(*frame) for frame in frames.values()]
    return (view_of_frames(document, options, list(frames), people, unambiguous=_LAYOUTS),)


def _people(frame: _Frame, document: Document) -> list[Floats]:
    """Return `[keypoint, 3]` of each person, `[0, 3]` where one has none. Raises FormatError."""
    people = frame.bodies if frame.people is None else frame.people
    if people is None:
        raise document.refuse("an object with a list `people`", "none")
    return [
        triples(person.pose_keypoints_2d or person.joints, document.source, "pose_keypoints_2d")
        for person in people
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
        points = np.nan_to_num(np.concatenate([view.positions, view.confidence[..., None]], -1))
        is_there: Bools = np.asarray(np.isfinite(view.positions[..., 0]).any(-1))
        for index, number in enumerate(view.frames):
            name = f"{view.camera}_json/{view.camera}_{number:0{_DIGITS}d}_keypoints.json"
            # a person without any point has no numbers, which keeps the place of the others
            people = [
                {
                    "person_id": [-1],
                    "pose_keypoints_2d": points[index, person].ravel().tolist() if there else [],
                }
                for person, there in enumerate(np.trim_zeros(is_there[index], "b"))
            ]
            files[name] = json.dumps({"version": _VERSION, "people": people}).encode()
    return files


FORMAT = Format(
    name="openpose",
    title="OpenPose .json, a folder per camera",
    sniff=sniff,
    read=read,
    passed_over=("version", "person_id"),
    write=write,
    per_frame=True,
    loses=(NAMES, FOLLOWED, SIZES, SCORES),
)
