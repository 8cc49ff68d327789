"""Flat lists of detections: COCO results and AlphaPose, which differ in what they call an image."""

import re
from typing import Any

import numpy as np

from mocap_calib.io.file import (
    Origin,
    find_camera,
    make_view,
    malformed,
    stack_detections,
    visibility_as_confidence,
)
from mocap_calib.io.keypoints.document import Document, Item, ReadOptions
from mocap_calib.io.keypoints.layouts import layout_for
from mocap_calib.io.keypoints.per_frame import frame_numbers, triples
from mocap_calib.types import Floats, Keypoints2D

_ALPHAPOSE = ("halpe_26", "halpe_136", "coco_wholebody_133")  # its only ones of their length


def _is_list(document: Document) -> bool:
    entries = document.json
    return (
        isinstance(entries, list)
        and bool(entries)
        and all(isinstance(e, dict) and {"image_id", "keypoints"} <= e.keys() for e in entries[:20])
    )


def sniff_coco(document: Document) -> bool:
    """A list of detections with numbers of images, without what AlphaPose adds."""
    return _is_list(document) and all(
        str(e["image_id"]).isdigit() and not {"box", "idx"} & e.keys() for e in document.json[:20]
    )


def sniff_alphapose(document: Document) -> bool:
    """A list of detections."""
    return _is_list(document)


def read_alphapose(item: Item, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """The detections of AlphaPose. Frames without any are absent from the file. Raises FormatError."""
    return _read(item, options, _ALPHAPOSE)


def read_coco(item: Item, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """The detections of COCO results; frames are the image ids, or what the camera pattern's group `frame` finds in them. Raises FormatError."""
    return _read(item, options, ())


def _read(item: Item, options: ReadOptions, sure: tuple[str, ...]) -> tuple[Keypoints2D, ...]:
    source = item.origin.source
    entries = item.document.json
    wrong = next(
        (
            k
            for k, e in enumerate(entries)
            if not isinstance(e, dict) or not isinstance(e.get("image_id"), str | int)
        ),
        None,
    )
    if wrong is not None:
        raise malformed(
            f"{source}: entry {wrong}",
            "an object with image_id and keypoints",
            entries[wrong],
            "the file is damaged: export it again",
        )
    points = [
        triples(entry.get("keypoints") or [], f"{source}: entry {k}")
        for k, entry in enumerate(entries)
    ]
    count = max(map(len, points))
    if count == 0:
        raise malformed(
            source, "numbers in one of its `keypoints`", "none", "export the keypoints too"
        )
    names = layout_for(count, options.layout, source, sure)
    images = [str(entry["image_id"]) for entry in entries]
    return tuple(
        _view(
            Origin(camera, source),
            [images[k] for k in own],
            [points[k] for k in own],
            names,
            options,
        )
        for camera, own in _cameras(images, item, options).items()
    )


def _cameras(images: list[str], item: Item, options: ReadOptions) -> dict[str, list[int]]:
    """Indices of the entries of each camera, as the user's pattern finds it in the images; all are one camera's where it finds none."""
    found = (
        [find_camera(image, options.camera_pattern) for image in images]
        if options.camera_pattern
        else [""]
    )
    if not any(found):
        return {item.camera: list(range(len(images)))}
    if not all(found):
        raise malformed(
            item.origin.source,
            f"a camera in each image_id by the pattern {options.camera_pattern}",
            images[found.index("")],
            "change it",
        )
    return {
        camera: [k for k, its in enumerate(found) if its == camera]
        for camera in dict.fromkeys(found)
    }


def _view(
    origin: Origin,
    images: list[str],
    points: list[Floats],
    names: tuple[str, ...],
    options: ReadOptions,
) -> Keypoints2D:
    unique = list(dict.fromkeys(images))
    place = {image: k for k, image in enumerate(unique)}
    detections: list[list[Floats]] = [[] for _ in unique]
    for image, found in zip(images, points, strict=True):
        detections[place[image]].append(found)
    values = stack_detections(detections, len(names), origin.source)
    values[..., 2] = visibility_as_confidence(values[..., 2])
    numbers = np.array(
        frame_numbers(
            [_frame_text(image, options.camera_pattern) for image in unique], origin.source
        ),
        dtype=np.int64,
    )
    remark = "frames without a detection are not in the file"
    return make_view(origin, names, numbers, values, tracked=False, rows=unique, remarks=(remark,))


def _frame_text(image: str, pattern: str) -> str:
    found: Any = re.search(pattern, image) if pattern and "(?P<frame>" in pattern else None
    return str(found["frame"]) if found else image
