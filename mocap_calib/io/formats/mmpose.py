"""Read MMPose's and RTMPose's JSON.

There are three kinds: of an image (a folder with a file per frame), of a video, and of the demo's
--save-predictions. Traps: only the demo's file has the names of keypoints; it counts frames from 1
while others count from 0; instances come in any order.
"""

from typing import Any

import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.document import Document
from mocap_calib.io.file import LARGEST_FRAME, make_view, stack_detections
from mocap_calib.io.format import Format
from mocap_calib.io.keypoints.layouts import choose_layout
from mocap_calib.io.keypoints.options import ReadOptions
from mocap_calib.io.keypoints.per_frame import (
    frames_of,
    is_list_of,
    json_frames,
    most_keypoints,
    numbers_of,
)
from mocap_calib.types import Floats, Keypoints2D

_LAYOUTS = ("coco_wholebody_133", "halpe_136")  # its only ones of their length
_DAMAGED = "the file is damaged: export it again"


def sniff_image(document: Document) -> bool:
    """Return whether this is a list of instances."""
    return is_list_of(document.json, "keypoints", "keypoint_scores")


def sniff_video(document: Document) -> bool:
    """Return whether this is a list of frames with instances, bare or beside the model's names."""
    return is_list_of(_frames(document.json), "frame_id", "instances")


def _frames(content: Any) -> Any:
    """Return the list of frames, which the demo keeps in an object."""
    return content.get("instance_info") if isinstance(content, dict) else content


def read_images(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read one camera, whose files are its frames. Raises FormatError."""
    file_names, frames = frames_of(document)
    detections = [_instances(instances, source) for instances, source in json_frames(document)]
    view = _view(document, frames, detections, layout=options.layout, rows=file_names)
    return (view,)


def read_video(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read one camera; frame numbers are those of the file. Raises FormatError."""
    source, content = document.source, document.json
    entries = _frames(content)
    frames = [_frame_id(entry, f"{source}: entry {k}") for k, entry in enumerate(entries)]
    detections = [
        _instances(entry.get("instances"), f"{source}: frame {frame}")
        for entry, frame in zip(entries, frames, strict=True)
    ]
    layout = options.layout or _names_in_file(content, source)
    return (_view(document, frames, detections, layout=layout, rows=frames),)


def _view(
    document: Document,
    frames: list[int],
    detections: list[list[Floats]],
    *,
    layout: tuple[str, ...],
    rows: list[Any],
) -> Keypoints2D:
    """Return the camera. Raises FormatError.

    frames: `[frame]` numbers. detections: the `[keypoint, 3]` detections of each frame.
    layout: names of the keypoints, where known. rows: what messages call the frames.
    """
    source = document.source
    count = most_keypoints(detections, named="instances", source=source)
    names = choose_layout(count, given=layout, source=source, unambiguous=_LAYOUTS)
    values = stack_detections(detections, count, source)
    return make_view(document.origin, names, frames, values, tracked=False, rows=rows)


def _frame_id(entry: Any, source: str) -> int:
    """Return the number of a frame. Raises FormatError."""
    number = entry.get("frame_id") if isinstance(entry, dict) else None
    if type(number) is not int or not 0 <= number < LARGEST_FRAME:
        raise FormatError(source, "frame_id to be a whole number", entry, _DAMAGED)
    return number


def _names_in_file(content: Any, source: str) -> tuple[str, ...]:
    """Return the names in the demo's file, in the order of their numbers; none in other files.

    Raises FormatError.
    """
    meta = content.get("meta_info") if isinstance(content, dict) else None
    names = meta.get("keypoint_id2name") if isinstance(meta, dict) else None
    if names is None:
        return ()
    if not isinstance(names, dict) or sorted(names) != sorted(map(str, range(len(names)))):
        raise FormatError(
            source, "keypoint_id2name to number the keypoints from 0", names, "export it again"
        )
    return tuple(str(names[str(k)]) for k in range(len(names)))


def _instances(entries: Any, source: str) -> list[Floats]:
    """Return `[keypoint, 3]` of each instance of a frame. Raises FormatError."""
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise FormatError(source, "a list of instances", type(entries).__name__, _DAMAGED)
    return [_points(entry, f"{source}: instance {k}") for k, entry in enumerate(entries)]


def _points(entry: dict[str, Any], source: str) -> Floats:
    """Return `[keypoint, 3]` x, y, score of an instance. Raises FormatError."""
    positions = numbers_of(entry.get("keypoints"), source, named="keypoints")
    scores = numbers_of(entry.get("keypoint_scores"), source, named="keypoint_scores")
    is_2d = positions.ndim == 2 and positions.shape[1] == 2
    if not is_2d or scores.shape != positions.shape[:1]:
        raise FormatError(
            source,
            "`keypoints` [keypoint, 2] and as many keypoint_scores",
            f"{list(positions.shape)} with {list(scores.shape)} scores",
            "give 2D keypoints",
        )
    return np.column_stack([positions, scores])


IMAGES = Format(
    kind="keypoints",
    name="mmpose-images",
    title="MMPose .json of images, a folder per camera",
    sniff=sniff_image,
    read=read_images,
    per_frame=True,
)


VIDEO = Format(
    kind="keypoints",
    name="mmpose",
    title="MMPose and RTMPose .json of a video",
    sniff=sniff_video,
    read=read_video,
)
