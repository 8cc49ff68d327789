"""Read MMPose's and RTMPose's JSON.

There are three kinds: of an image (a folder with a file per frame), of a video, and of the demo's
--save-predictions. Traps: only the demo's file has the names of keypoints; it counts frames from 1
while others count from 0; instances come in any order.
"""

from dataclasses import replace
from typing import Annotated, Any

import msgspec

from mocap_calib.io.detections import is_list_of, view_of_frames
from mocap_calib.io.document import Document
from mocap_calib.io.file import LARGEST_FRAME
from mocap_calib.io.format import Format
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.types import Keypoints2D

_LAYOUTS = ("coco_wholebody_133", "halpe_136")  # its only ones of their length

_PASSED_OVER = ("bbox", "bbox_score", "bbox_scores", "meta_info")


class _Instance(msgspec.Struct):
    keypoints: list[tuple[float | None, float | None]]
    keypoint_scores: list[float | None]


class _Frame(msgspec.Struct):
    frame_id: Annotated[int, msgspec.Meta(ge=0, lt=LARGEST_FRAME)]
    instances: list[_Instance]


class _Meta(msgspec.Struct):
    keypoint_id2name: dict[str, str] | None = None


class _Demo(msgspec.Struct):
    instance_info: list[_Frame]
    meta_info: _Meta | None = None


def sniff_image(document: Document) -> bool:
    """Return whether this is a list of instances."""
    return is_list_of(document.json, "keypoints", "keypoint_scores")


def sniff_video(document: Document) -> bool:
    """Return whether this is a list of frames with instances, bare or beside the model's names."""
    content = document.json
    frames: Any = content.get("instance_info") if isinstance(content, dict) else content
    return is_list_of(frames, "frame_id", "instances")


def read_images(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read one camera, whose files are its frames. Raises FormatError."""
    frames = {
        each.path.name: _points(each.records(list[_Instance]), each)
        for each in document.documents()
    }
    found = list(frames.values())
    return (view_of_frames(document, options, list(frames), found, unambiguous=_LAYOUTS),)


def read_video(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read one camera; frame numbers are those of the file. Raises FormatError."""
    is_demo = isinstance(document.json, dict)
    demo = document.records(_Demo) if is_demo else _Demo(document.records(list[_Frame]))
    names = demo.meta_info.keypoint_id2name if demo.meta_info else None
    if names is not None and not options.layout:
        numbers = [str(number) for number in range(len(names))]
        if names.keys() != set(numbers):
            raise document.refuse("keypoint_id2name to number the keypoints from 0", names)
        options = replace(options, layout=tuple(names[number] for number in numbers))
    frames = [frame.frame_id for frame in demo.instance_info]
    detections = [_points(frame.instances, document) for frame in demo.instance_info]
    return (view_of_frames(document, options, frames, detections, unambiguous=_LAYOUTS),)


def _points(instances: list[_Instance], document: Document) -> list[list[tuple[Any, ...]]]:
    """Return x, y, score of each keypoint of each instance. Raises FormatError."""
    for each in instances:
        if len(each.keypoints) != len(each.keypoint_scores):
            found = f"{len(each.keypoints)} with {len(each.keypoint_scores)}"
            raise document.refuse("as many keypoint_scores as keypoints", found)
    return [
        [(*xy, score) for xy, score in zip(each.keypoints, each.keypoint_scores, strict=True)]
        for each in instances
    ]


IMAGES = Format(
    name="mmpose-images",
    title="MMPose .json of images, a folder per camera",
    sniff=sniff_image,
    read=read_images,
    passed_over=_PASSED_OVER,
    per_frame=True,
)
VIDEO = Format(
    name="mmpose",
    title="MMPose and RTMPose .json of a video",
    sniff=sniff_video,
    read=read_video,
    passed_over=_PASSED_OVER,
)
