"""Read COCO keypoint annotations: `images`, `annotations` and `categories` in one JSON file.

Traps: the third number of a point is a visibility (0, 1, 2) or, as many programs write it, a
score; some writers quote ids; categories without keypoints (boxes) may lie beside; cameras and
frame numbers are told by the images in several ways (coco_images.py).
"""

from collections.abc import Iterable
from typing import Any

import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.document import Document
from mocap_calib.io.file import (
    Origin,
    blank,
    make_view,
    unique_names,
    visibility_as_confidence,
)
from mocap_calib.io.format import Format
from mocap_calib.io.formats import coco_writer
from mocap_calib.io.formats.coco_images import Entry, frame_numbers, image_size, images_by_camera
from mocap_calib.io.keypoints.losses import FOLLOWED, SCORES
from mocap_calib.io.keypoints.options import ReadOptions
from mocap_calib.types import Floats, Ints, Keypoints2D

_LISTS = {"images", "annotations", "categories"}
_EXPECTED = "COCO annotations (an object with the lists `images`, `annotations` and `categories`)"


def sniff(document: Document) -> bool:
    """Return whether the file is a JSON object with one of COCO's lists."""
    return isinstance(document.json, dict) and bool(_LISTS & document.json.keys())


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read the camera of the file, or several cameras where the images say so.

    All `images` are frames, also those without annotations. The instance is the position among the
    image's annotations in file order; annotations of categories without keypoints do not count.
    Raises FormatError.
    """
    source = document.source
    data = _check_lists(document.json, source)
    images = _entries(data, "images", source)
    annotations = _entries(data, "annotations", source)
    if not images:
        raise FormatError(
            source,
            "at least one entry in `images`",
            "none",
            "export the images together with the annotations",
        )
    keypoints, categories = _keypoints_and_categories(_entries(data, "categories", source), source)
    annotations = [entry for entry in annotations if _is_of_categories(entry, categories)]
    _check_ids(images, annotations, source)
    return tuple(
        _view(Origin(camera, source), images_of_camera, annotations, keypoints)
        for camera, images_of_camera in images_by_camera(images, document, options).items()
    )


def _view(
    origin: Origin, images: list[Entry], annotations: list[Entry], keypoints: tuple[str, ...]
) -> Keypoints2D:
    """Return the detections of one camera, whose images these are. Raises FormatError."""
    source = origin.source
    frame_of = {str(image.get("id")): frame for frame, image in enumerate(images)}
    annotations = [entry for entry in annotations if str(entry["image_id"]) in frame_of]
    frame = np.array([frame_of[str(entry["image_id"])] for entry in annotations], dtype=np.int64)
    instance = _instances(frame)
    values = blank(len(images), int(instance.max(initial=-1)) + 1, len(keypoints), source)
    values[frame, instance] = _points(annotations, len(keypoints), source)
    values[..., 2] = visibility_as_confidence(values[..., 2])
    return make_view(
        origin,
        keypoints,
        frame_numbers(images, source),
        values,
        tracked=False,
        image_size=image_size(images, source),
        rows=[image.get("file_name", image.get("id")) for image in images],
    )


# The lists and their entries


def _check_lists(data: Any, source: str) -> Entry:
    """Return the object with all lists. Raises FormatError."""
    if isinstance(data, dict) and data.keys() >= _LISTS:
        return data
    found = f"a {type(data).__name__}"
    if isinstance(data, dict):
        found = f"an object with {', '.join(map(str, list(data)[:6])) or 'nothing'}"
    raise FormatError(
        source,
        _EXPECTED,
        found,
        "results without images and names must be joined with their annotations file",
    )


def _entries(data: Entry, key: str, source: str) -> list[Entry]:
    """Return one of the lists. Raises FormatError."""
    found = data[key]
    if not isinstance(found, list) or not all(isinstance(entry, dict) for entry in found):
        raise FormatError(
            source, f"`{key}` to be a list of objects", type(found).__name__, "export it again"
        )
    return found


def _keypoints_and_categories(
    categories: Iterable[Entry], source: str
) -> tuple[tuple[str, ...], set[str]]:
    """Return the keypoint names and the ids of the categories that have them.

    Ids are text, since some writers quote them. Raises FormatError.
    """
    named = [
        entry
        for entry in categories
        if isinstance(entry.get("keypoints"), list) and entry["keypoints"]
    ]
    lists = {tuple(map(str, entry["keypoints"])) for entry in named}
    if len(lists) != 1:
        raise FormatError(
            source,
            "one list of keypoint names in `categories`",
            f"{len(lists)} different lists" if lists else "none",
            "keep the category of one kind of subject",
        )
    return unique_names(lists.pop(), source), {str(entry.get("id")) for entry in named}


def _is_of_categories(annotation: Entry, categories: set[str]) -> bool:
    """Return whether an annotation is of these categories (ids); one without any is."""
    return "category_id" not in annotation or str(annotation["category_id"]) in categories


def _check_ids(images: list[Entry], annotations: list[Entry], source: str) -> None:
    """Raise FormatError where image ids repeat, or annotations are of images that are not there."""
    ids = {str(image.get("id")) for image in images}
    if len(ids) < len(images):
        raise FormatError(
            source,
            "each image id once",
            f"{len(images)} images with {len(ids)} ids",
            "export it again",
        )
    for annotation in annotations:
        if str(annotation.get("image_id")) not in ids:
            raise FormatError(
                source,
                "each annotation's image_id among `images`",
                annotation.get("image_id"),
                "export images and annotations together",
            )


# Points


def _instances(frame: Ints) -> Ints:
    """Return each annotation's `[annotation]` place among those of its frame, in file order.

    frame: `[annotation]` index of its frame.
    """
    by_frame = np.argsort(frame, kind="stable")
    first_of_frame = np.searchsorted(frame[by_frame], frame[by_frame])
    instance = np.empty_like(frame)
    instance[by_frame] = np.arange(len(frame)) - first_of_frame
    return instance


def _points(annotations: list[Entry], keypoints: int, source: str) -> Floats:
    """Return `[annotation, keypoint, 3]` x, y and third value.

    NaN for an annotation that has no points. Raises FormatError.
    """
    values = np.full((len(annotations), keypoints, 3), np.nan)
    lists = [annotation.get("keypoints") or [] for annotation in annotations]
    for numbers in lists:
        _check_length(numbers, keypoints, source)
    full = [k for k, numbers in enumerate(lists) if numbers]
    try:
        points = np.array([lists[k] for k in full], dtype=np.float64)
        values[full] = points.reshape(-1, keypoints, 3)
    except (ValueError, TypeError, OverflowError) as error:
        raise FormatError(source, "`keypoints` to hold numbers", error, "export it again") from None
    return values


def _check_length(numbers: Any, keypoints: int, source: str) -> None:
    """Raise FormatError where an annotation's list is not empty and not of full length."""
    if isinstance(numbers, list) and len(numbers) in (0, 3 * keypoints):
        return
    is_list = isinstance(numbers, list)
    raise FormatError(
        source,
        f"{3 * keypoints} numbers (x, y, v) per annotation for {keypoints} names",
        f"{len(numbers)} numbers" if is_list else type(numbers).__name__,
        "export it again",
    )


ANNOTATIONS = Format(
    kind="keypoints",
    name="coco",
    title="COCO annotations .json",
    sniff=sniff,
    read=read,
    write=coco_writer.write,
    endings=(".json",),
    loses=(FOLLOWED, SCORES),
)
