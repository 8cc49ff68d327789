"""Read flat lists of detections: COCO results and AlphaPose.

The two differ in what they call an image: COCO a number, AlphaPose a file name. Traps: frames
without a detection are absent; names of keypoints are absent; the third number of a point is a
score or COCO's visibility; one list may hold several cameras, which only the images tell apart.
"""

import re

import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.document import Document
from mocap_calib.io.file import (
    Origin,
    make_view,
    stack_detections,
    visibility_as_confidence,
)
from mocap_calib.io.format import Format
from mocap_calib.io.keypoints.layouts import choose_layout
from mocap_calib.io.keypoints.options import ReadOptions
from mocap_calib.io.keypoints.per_frame import (
    cameras_by_pattern,
    frame_numbers,
    is_list_of,
    triples,
)
from mocap_calib.types import Floats, Keypoints2D

# AlphaPose's only layouts of their length
_ALPHAPOSE_LAYOUTS = ("halpe_26", "halpe_136", "coco_wholebody_133")
_ABSENT_FRAMES = "frames without a detection are not in the file"


def sniff_coco(document: Document) -> bool:
    """Return whether this is a list of detections in numbered images, without AlphaPose's keys."""
    return _is_list_of_detections(document) and all(
        str(entry["image_id"]).isdigit() and not {"box", "idx"} & entry.keys()
        for entry in document.json[:20]
    )


def sniff_alphapose(document: Document) -> bool:
    """Return whether this is a list of detections."""
    return _is_list_of_detections(document)


def _is_list_of_detections(document: Document) -> bool:
    return is_list_of(document.json, "image_id", "keypoints")


def read_alphapose(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read the cameras of an AlphaPose file. Raises FormatError."""
    return _read(document, options, unambiguous=_ALPHAPOSE_LAYOUTS)


def read_coco(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read the cameras of COCO results.

    Frames are the image ids, or what the camera pattern's group `frame` finds in them.
    Raises FormatError.
    """
    return _read(document, options, unambiguous=())


def _read(
    document: Document, options: ReadOptions, *, unambiguous: tuple[str, ...]
) -> tuple[Keypoints2D, ...]:
    """Read the cameras of a list of detections. Raises FormatError."""
    source = document.source
    images = _images(document)
    points = [
        triples(entry.get("keypoints") or [], f"{source}: entry {k}")
        for k, entry in enumerate(document.json)
    ]
    count = max(map(len, points))
    if count == 0:
        raise FormatError(
            source, "numbers in one of its `keypoints`", "none", "export the keypoints too"
        )
    names = choose_layout(count, given=options.layout, source=source, unambiguous=unambiguous)
    views = []
    for camera, entries in _entries_by_camera(images, document, options).items():
        detections_of: dict[str, list[Floats]] = {}
        for entry in entries:
            detections_of.setdefault(images[entry], []).append(points[entry])
        views.append(_view(Origin(camera, source), detections_of, names, options))
    return tuple(views)


def _images(document: Document) -> list[str]:
    """Return the image of each entry, as text. Raises FormatError."""
    images = []
    for k, entry in enumerate(document.json):
        if not isinstance(entry, dict) or not isinstance(entry.get("image_id"), str | int):
            raise FormatError(
                f"{document.source}: entry {k}",
                "an object with image_id and keypoints",
                entry,
                "the file is damaged: export it again",
            )
        images.append(str(entry["image_id"]))
    return images


def _entries_by_camera(
    images: list[str], document: Document, options: ReadOptions
) -> dict[str, list[int]]:
    """Return the entries (indices) of each camera, as the user's pattern finds it in the images.

    All are of the file's camera where the pattern finds none. Raises FormatError where it finds
    some only.
    """
    cameras = cameras_by_pattern(
        images, options.camera_pattern, named="image_id", source=document.source
    )
    if not cameras:
        return {document.camera: list(range(len(images)))}
    entries_of: dict[str, list[int]] = {}
    for entry, camera in enumerate(cameras):
        entries_of.setdefault(camera, []).append(entry)
    return entries_of


def _view(
    origin: Origin,
    detections_of: dict[str, list[Floats]],
    names: tuple[str, ...],
    options: ReadOptions,
) -> Keypoints2D:
    """Return one camera. Raises FormatError.

    detections_of: image -> its `[keypoint, 3]` detections.
    """
    images = list(detections_of)
    values = stack_detections(list(detections_of.values()), len(names), origin.source)
    values[..., 2] = visibility_as_confidence(values[..., 2])
    texts = [_frame_text(image, options.camera_pattern) for image in images]
    frames = np.array(frame_numbers(texts, origin.source), dtype=np.int64)
    return make_view(
        origin, names, frames, values, tracked=False, rows=images, remarks=(_ABSENT_FRAMES,)
    )


def _frame_text(image: str, pattern: str) -> str:
    """Return what the pattern's group `frame` finds in an image; the image where it finds none."""
    if "(?P<frame>" not in pattern:
        return image
    found = re.search(pattern, image)
    return str(found["frame"]) if found else image


RESULTS = Format(
    kind="keypoints",
    name="coco-results",
    title="COCO results .json",
    sniff=sniff_coco,
    read=read_coco,
)


ALPHAPOSE = Format(
    kind="keypoints",
    name="alphapose",
    title="AlphaPose .json",
    sniff=sniff_alphapose,
    read=read_alphapose,
)
