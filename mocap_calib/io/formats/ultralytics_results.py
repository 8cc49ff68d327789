"""Read what Ultralytics' results export: to_json() and to_csv(), positions in pixels.

A detection has a name, a class, a confidence, a box, perhaps a track_id, and keypoints with lists
x, y and visible. A file of one image is a list of detections; of a video, a list of such lists.
Traps: there are no frame numbers; missing points are at (0, 0); in .csv, boxes and keypoints are
Python's dictionaries; lists of all frames that were joined to one tell frames apart only by a track
that comes again, and frames without a detection are lost.
"""

import ast
import csv
from collections.abc import Sequence
from typing import Any

import msgspec

from mocap_calib.io.detections import is_list_of, view_of_frames
from mocap_calib.io.document import Document, typed
from mocap_calib.io.format import Format
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.types import Keypoints2D

_KEYS = ("name", "class", "confidence", "keypoints")
_PERSON, _OF_PERSON = "person", ("coco_17",)  # the only layout of Ultralytics' models of people
JOINED = (
    "the file has no frame numbers: each track that comes again starts the next frame, and frames "
    "without a detection are lost"
)


class _Points(msgspec.Struct):
    x: list[float | None]
    y: list[float | None]
    visible: list[float | None] | None = None


class _Detection(msgspec.Struct):
    name: str
    keypoints: _Points
    track_id: int | None = None


def _is_joined(content: Any) -> bool:
    """Return whether a track comes twice in a list of detections."""
    tracks = [each.get("track_id") for each in content if isinstance(each, dict)]
    followed = [track for track in tracks if track is not None]
    return len(set(map(str, followed))) < len(followed)


def sniff_image(document: Document) -> bool:
    """Return whether this is a list of detections of one image, or a table of them."""
    content = document.json
    if is_list_of(content, *_KEYS):
        return not _is_joined(content)
    return {*_KEYS} <= {*document.header}


def sniff_video(document: Document) -> bool:
    """Return whether this is a list of lists of detections, or of those of several frames."""
    content = document.json
    if is_list_of(content, *_KEYS):
        return _is_joined(content)
    filled = [each for each in content if each] if isinstance(content, list) else []
    return bool(filled) and all(is_list_of(each, *_KEYS) for each in filled[:20])


def read_images(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read one camera, whose files are its frames. Raises FormatError."""
    frames = {each.path.name: _detections(each) for each in document.documents()}
    numbers = list(frames) if document.is_folder else [0]
    return (_view(document, options, numbers, list(frames.values())),)


def read_video(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read one camera; frames count from 0. Raises FormatError."""
    if not is_list_of(document.json, *_KEYS):
        frames = document.records(list[list[_Detection]])
        return (_view(document, options, range(len(frames)), frames),)
    frames, seen = [], set[int | None]()
    for each in document.records(list[_Detection]):
        if not frames or each.track_id in seen:
            frames.append([])
            seen = set()
        frames[-1].append(each)
        seen.add(each.track_id)
    return (_view(document, options, range(len(frames)), frames, remarks=(JOINED,)),)


def _detections(document: Document) -> list[_Detection]:
    """Return the detections of an image. Raises FormatError."""
    if document.json is not None:
        return document.records(list[_Detection])
    rows = []
    for row in csv.DictReader(document.lines()):
        try:
            row["keypoints"] = ast.literal_eval(row["keypoints"] or "")
        except (ValueError, SyntaxError, MemoryError, RecursionError, KeyError) as error:
            raise document.refuse("a dictionary of keypoints in each row", error) from None
        rows.append({**row, "track_id": row.get("track_id") or None})
    return typed(rows, list[_Detection], document.source, "detections")


def _view(
    document: Document,
    options: ReadOptions,
    frames: Sequence[Any],
    detections: Sequence[Sequence[_Detection]],
    **further: Any,
) -> Keypoints2D:
    """Return the camera; tracks are individuals where all detections have one.

    Raises FormatError.
    """
    every = [each for found in detections for each in found]
    tracks = sorted({each.track_id for each in every if each.track_id is not None})
    tracked = bool(tracks) and all(each.track_id is not None for each in every)
    points: list[list[Any]] = []
    for found in detections:
        if tracked:
            of_track = {each.track_id: _points(each, document) for each in found}
            points.append([of_track.get(track, ()) for track in tracks])
        else:
            points.append([_points(each, document) for each in found])
    layouts = _OF_PERSON if {each.name for each in every} == {_PERSON} else ()
    return view_of_frames(
        document, options, frames, points, unambiguous=layouts, tracked=tracked, **further
    )


def _points(detection: _Detection, document: Document) -> list[tuple[float | None, ...]]:
    """Return x, y, score of each keypoint. Raises FormatError."""
    points = detection.keypoints
    scores = points.visible or [None] * len(points.x)
    if not len(points.x) == len(points.y) == len(scores):
        found = f"{len(points.x)}, {len(points.y)} and {len(scores)}"
        raise document.refuse("as many x as y and visible", found)
    return list(zip(points.x, points.y, scores, strict=True))


IMAGES = Format(
    name="ultralytics-images",
    title="Ultralytics to_json() or to_csv() of images, a folder per camera",
    sniff=sniff_image,
    read=read_images,
    passed_over=("class", "confidence", "box"),
    per_frame=True,
)
VIDEO = Format(
    name="ultralytics-json",
    title="Ultralytics to_json() of a video",
    sniff=sniff_video,
    read=read_video,
    passed_over=("class", "confidence", "box"),
)
