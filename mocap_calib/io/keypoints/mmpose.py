"""MMPose's and RTMPose's JSON: of an image (a folder with a file per frame), of a video, and of the demo's --save-predictions."""

from typing import Any

import numpy as np

from mocap_calib.io.file import make_view, malformed, stack_detections
from mocap_calib.io.keypoints.document import Document, Item, ReadOptions
from mocap_calib.io.keypoints.layouts import layout_for
from mocap_calib.io.keypoints.per_frame import frames_of, json_frames, numbers_of
from mocap_calib.types import Floats, Keypoints2D

_SURE = ("coco_wholebody_133", "halpe_136")  # its only ones of their length


def sniff_image(document: Document) -> bool:
    """A list of instances."""
    return _all(document.json, "keypoints", "keypoint_scores")


def sniff_video(document: Document) -> bool:
    """A list of frames with instances, bare or beside the model's names."""
    return _all(_frames(document.json), "frame_id", "instances")


def _all(entries: Any, *keys: str) -> bool:
    return (
        isinstance(entries, list)
        and bool(entries)
        and all(isinstance(entry, dict) and set(keys) <= entry.keys() for entry in entries[:20])
    )


def _frames(content: Any) -> Any:
    return content.get("instance_info") if isinstance(content, dict) else content


def read_images(item: Item, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """One camera, whose files are its frames. Raises FormatError."""
    names, numbers = frames_of(item)
    return _view(
        item,
        options,
        numbers,
        [_instances(instances, source) for instances, source in json_frames(item)],
        (),
        rows=names,
    )


def read_video(item: Item, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """One camera; frame numbers are those of the file (from 0, or from 1 by the demo). Raises FormatError."""
    source, content = item.origin.source, item.document.json
    frames = _frames(content)
    wrong = [
        k
        for k, frame in enumerate(frames)
        if not isinstance(frame, dict)
        or type(frame.get("frame_id")) is not int
        or not 0 <= frame["frame_id"] < 2**62
    ]
    if wrong:
        raise malformed(
            f"{source}: entry {wrong[0]}",
            "frame_id to be a whole number",
            frames[wrong[0]],
            "the file is damaged: export it again",
        )
    numbers = [frame["frame_id"] for frame in frames]
    detections = [
        _instances(frame.get("instances"), f"{source}: frame {frame['frame_id']}")
        for frame in frames
    ]
    return _view(item, options, numbers, detections, _names(content, source), rows=numbers)


def _view(
    item: Item,
    options: ReadOptions,
    numbers: list[int],
    detections: list[list[Floats]],
    own: tuple[str, ...],
    rows: list[Any],
) -> tuple[Keypoints2D]:
    source = item.origin.source
    count = max((len(points) for found in detections for points in found), default=0)
    if count == 0:
        raise malformed(
            source,
            "instances in one of its frames",
            f"none in {len(detections)} frames",
            "check the detector's output",
        )
    names = layout_for(count, options.layout or own, source, _SURE)
    return (
        make_view(
            item.origin,
            names,
            numbers,
            stack_detections(detections, count, source),
            tracked=False,
            rows=rows,
        ),
    )


def _names(content: Any, source: str) -> tuple[str, ...]:
    """The names in the demo's file, in the order of their numbers; nothing where it has none."""
    meta = content.get("meta_info") if isinstance(content, dict) else None
    names = meta.get("keypoint_id2name") if isinstance(meta, dict) else None
    if names is None:
        return ()
    if not isinstance(names, dict) or sorted(names) != sorted(map(str, range(len(names)))):
        raise malformed(
            source, "keypoint_id2name to number the keypoints from 0", names, "export it again"
        )
    return tuple(str(names[str(k)]) for k in range(len(names)))


def _instances(entries: Any, source: str) -> list[Floats]:
    """`[keypoint, 3]` of each instance."""
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise malformed(
            source,
            "a list of instances",
            type(entries).__name__,
            "the file is damaged: export it again",
        )
    return [_points(entry, f"{source}: instance {k}") for k, entry in enumerate(entries)]


def _points(entry: dict[str, Any], source: str) -> Floats:
    points = numbers_of(entry.get("keypoints"), source, "keypoints")
    scores = numbers_of(entry.get("keypoint_scores"), source, "keypoint_scores")
    if points.ndim != 2 or points.shape[1] != 2 or scores.shape != points.shape[:1]:
        found = f"{list(points.shape)} with {list(scores.shape)} scores"
        raise malformed(
            source,
            "`keypoints` [keypoint, 2] and as many keypoint_scores",
            found,
            "give 2D keypoints",
        )
    return np.column_stack([points, scores])
