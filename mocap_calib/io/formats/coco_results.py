"""Read flat lists of detections: COCO results and AlphaPose.

The two differ in what they call an image: COCO a number, AlphaPose a file name. Traps: frames
without a detection are absent; names of keypoints are absent; the third number of a point is a
score or COCO's visibility; one list may hold several cameras, which only the images tell apart.
"""

import re
from dataclasses import replace

import msgspec

from mocap_calib.io.detections import (
    ABSENT_FRAMES,
    cameras_by_pattern,
    frame_numbers,
    is_list_of,
    triples,
    view_of_frames,
)
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.types import Floats, Keypoints2D

# AlphaPose's only layouts of their length
_ALPHAPOSE_LAYOUTS = ("halpe_26", "halpe_136", "coco_wholebody_133")


class _Detection(msgspec.Struct):
    image_id: int | str
    keypoints: list[float | None] | None = None


def sniff_coco(document: Document) -> bool:
    """Return whether this is a list of detections in numbered images, without AlphaPose's keys."""
    return sniff_alphapose(document) and all(
        str(entry["image_id"]).isdigit() and not {"box", "idx"} & entry.keys()
        for entry in document.json[:20]
    )


def sniff_alphapose(document: Document) -> bool:
    """Return whether this is a list of detections."""
    return is_list_of(document.json, "image_id", "keypoints")


def read_alphapose(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read the cameras of an AlphaPose file. Raises FormatError."""
    return read_coco(document, options, unambiguous=_ALPHAPOSE_LAYOUTS)


def read_coco(
    document: Document, options: ReadOptions, unambiguous: tuple[str, ...] = ()
) -> tuple[Keypoints2D, ...]:
    """Read the cameras of COCO results, as the user's pattern finds them in the image ids.

    Frames are the image ids, or what the pattern's group `frame` finds in them. All are of the
    file's camera where there is no pattern. Raises FormatError.
    """
    entries, pattern = document.records(list[_Detection]), options.camera_pattern
    images = [str(entry.image_id) for entry in entries]
    cameras = cameras_by_pattern(images, pattern, named="image_id", source=document.source)
    detections_of: dict[str, dict[str, list[Floats]]] = {}
    for k, camera in enumerate(cameras or [document.camera] * len(entries)):
        points = triples(entries[k].keypoints or [], f"{document.source}: entry {k}", "keypoints")
        detections_of.setdefault(camera, {}).setdefault(images[k], []).append(points)
    return tuple(
        view_of_frames(
            replace(document, camera=camera),
            options,
            frame_numbers([_frame_text(image, pattern) for image in by_image], document.source),
            list(by_image.values()),
            unambiguous=unambiguous,
            rows=list(by_image),
            remarks=(ABSENT_FRAMES,),
            visibility=True,
        )
        for camera, by_image in detections_of.items()
    )


def _frame_text(image: str, pattern: str) -> str:
    """Return what the pattern's group `frame` finds in an image; the image where it finds none."""
    found = re.search(pattern, image) if "(?P<frame>" in pattern else None
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
