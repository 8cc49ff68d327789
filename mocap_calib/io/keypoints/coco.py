"""Read COCO keypoint annotations: `images`, `annotations` and `categories` in one JSON file.

Traps: the third number of a point is a visibility (0, 1, 2) or, as many programs write it, a
score; frame numbers stand in the file names, in a field of the images, or nowhere; one file may
hold several cameras, told by a field or by the folders of the file names; Roboflow adds to the
file names; some writers quote ids; categories without keypoints (boxes) may lie beside.
"""

import re
from collections.abc import Iterable
from typing import Any

import numpy as np

from mocap_calib.io.file import (
    Origin,
    blank,
    camera_in,
    frame_number,
    make_view,
    malformed,
    unique_names,
    visibility_as_confidence,
)
from mocap_calib.io.keypoints.document import Document, Item, ReadOptions
from mocap_calib.types import Floats, Ints, Keypoints2D

_LISTS = {"images", "annotations", "categories"}
_EXPECTED = "COCO annotations (an object with the lists `images`, `annotations` and `categories`)"
_CAMERA_FIELDS = ("camera", "cam_id", "camera_id", "cam")
_ROBOFLOW = re.compile(r"(_(?:png|jpe?g|bmp))?\.rf\.[0-9a-f]{8,}(?=\.\w+$)")  # what it adds
_MISSING_NUMBER = -1

Entry = dict[str, Any]


def sniff(document: Document) -> bool:
    """Return whether the file is a JSON object with one of COCO's lists."""
    return isinstance(document.json, dict) and bool(_LISTS & document.json.keys())


def read(item: Item, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read the camera of the file, or several cameras where the images say so.

    All `images` are frames, also those without annotations. The instance is the position among the
    image's annotations in file order; annotations of categories without keypoints do not count.
    Raises FormatError.
    """
    source = item.origin.source
    data = _check_lists(item.document.json, source)
    images = _entries(data, "images", source)
    annotations = _entries(data, "annotations", source)
    if not images:
        raise malformed(
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
        for camera, images_of_camera in _images_by_camera(images, item, options).items()
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
        _frame_numbers(images, source),
        values,
        tracked=False,
        image_size=_image_size(images, source),
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
    raise malformed(
        source,
        _EXPECTED,
        found,
        "results without images and names must be joined with their annotations file",
    )


def _entries(data: Entry, key: str, source: str) -> list[Entry]:
    """Return one of the lists. Raises FormatError."""
    found = data[key]
    if not isinstance(found, list) or not all(isinstance(entry, dict) for entry in found):
        raise malformed(
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
        raise malformed(
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
        raise malformed(
            source,
            "each image id once",
            f"{len(images)} images with {len(ids)} ids",
            "export it again",
        )
    for annotation in annotations:
        if str(annotation.get("image_id")) not in ids:
            raise malformed(
                source,
                "each annotation's image_id among `images`",
                annotation.get("image_id"),
                "export images and annotations together",
            )


# Cameras


def _images_by_camera(
    images: list[Entry], item: Item, options: ReadOptions
) -> dict[str, list[Entry]]:
    """Return the images of each camera. Raises FormatError.

    The user's pattern tells it, else a field of the images, else their folders; all images are of
    the file's camera where none of them tells.
    """
    by_pattern = _cameras_by_pattern(images, item, options)
    cameras = by_pattern or _cameras_by_field(images) or _cameras_by_folder(images, item)
    if len(set(cameras)) <= 1 and not by_pattern:
        return {item.camera: images}
    images_of: dict[str, list[Entry]] = {}
    for image, camera in zip(images, cameras, strict=True):
        images_of.setdefault(camera, []).append(image)
    return images_of


def _cameras_by_pattern(images: list[Entry], item: Item, options: ReadOptions) -> list[str]:
    """Return each image's camera as the user's pattern finds it; nothing where it finds none.

    Raises FormatError where it finds some only.
    """
    if not options.camera_pattern:
        return []
    names = _file_names(images)
    cameras = [camera_in(name, options.camera_pattern) for name in names]
    if not any(cameras):
        return []
    if not all(cameras):
        raise malformed(
            item.origin.source,
            f"a camera in each file name by the pattern {options.camera_pattern}",
            names[cameras.index("")],
            "change it",
        )
    return cameras


def _cameras_by_field(images: list[Entry]) -> list[str]:
    """Return each image's camera as its fields say it; nothing where one does not."""
    cameras = [_camera_field(image) for image in images]
    return cameras if all(cameras) else []


def _camera_field(image: Entry) -> str:
    for name in _CAMERA_FIELDS:
        if isinstance(image.get(name), str | int):
            return str(image[name])
    return ""


def _cameras_by_folder(images: list[Entry], item: Item) -> list[str]:
    """Return each image's camera: the part of the folders that differs.

    Where several parts differ, it is the one that tells images of one frame number apart. Nothing
    where there is one folder, or where the user has named the camera and the numbers do not
    contradict. Raises FormatError.
    """
    names = _file_names(images)
    folders = [re.split(r"[/\\]", name)[:-1] for name in names]
    numbers = [frame_number(name) for name in names]
    numbers_differ = len(set(numbers)) == len(numbers)
    if len(set(map(tuple, folders))) == 1 or (item.named and numbers_differ):
        return []
    parts = _parts_that_differ(folders)
    if len(parts) == 1:
        return parts[0]
    if not numbers_differ:
        for part in parts:
            if len(set(zip(part, numbers, strict=True))) == len(names):
                return part
    other = next(name for name, folder in zip(names, folders, strict=True) if folder != folders[0])
    raise malformed(
        item.origin.source,
        "folders that tell the cameras",
        f"{names[0]} and {other}",
        "say which part is the camera with --camera-regex",
    )


def _parts_that_differ(folders: list[list[str]]) -> list[list[str]]:
    """Return the levels of the folders, a name per image, in which not all images agree.

    None where the folders are not of one depth.
    """
    if len(set(map(len, folders))) != 1:
        return []
    levels = [list(level) for level in zip(*folders, strict=True)]
    return [level for level in levels if len(set(level)) > 1]


def _file_names(images: list[Entry]) -> list[str]:
    """Return the file names, "" where there is none, without what Roboflow adds.

    Roboflow writes `a_0001_png.rf.<hash>.jpg` for `a_0001.jpg`.
    """
    names = [image.get("file_name") for image in images]
    return [_ROBOFLOW.sub("", name) if isinstance(name, str) else "" for name in names]


# Frame numbers


def _frame_numbers(images: list[Entry], source: str) -> Ints:
    """Return the `[image]` frame numbers. Raises FormatError.

    They all come from the first place where every image has a number of its own, else from the
    first place where all have one.

    The places: the integer at the end of the file name, `frame`, `frame_id`, the first integer of
    the file name, and `id` where none of these counts. Images whose numbers repeat are those of
    two cameras, which `id` would line up one behind the other.
    """
    names = _file_names(images)
    places = [
        [frame_number(name) for name in names],
        [_whole_number(image.get("frame")) for image in images],
        [_whole_number(image.get("frame_id")) for image in images],
        [_first_integer(name) for name in names],
    ]
    if not any(_counts(numbers) for numbers in places):
        places.append([_whole_number(image.get("id")) for image in images])
    complete = [numbers for numbers in places if min(numbers) >= 0]
    if not complete:
        image = images[places[-1].index(min(places[-1]))]
        raise malformed(
            source,
            "a frame number at the end of each file name",
            image.get("file_name", image),
            "add a field `frame` to each image",
        )
    for numbers in complete:
        if len(set(numbers)) == len(numbers):
            return np.array(numbers, dtype=np.int64)
    return np.array(complete[0], dtype=np.int64)


def _counts(numbers: list[int]) -> bool:
    """Return whether every image has a number, and not all the same one."""
    return min(numbers) >= 0 and len(set(numbers)) > 1


def _first_integer(name: str) -> int:
    """Return the first integer of a file name; -1 where there is none.

    Its folders and its suffix do not count: `a7/000012_cam1.jpg` -> 12.
    """
    file_name = re.split(r"[/\\]", name.strip())[-1]
    stem = re.sub(r"\.[A-Za-z]\w*$", "", file_name)
    digits = re.search(r"[0-9]+", stem)
    return _whole_number(digits[0]) if digits else _MISSING_NUMBER


def _whole_number(value: object) -> int:
    """Return a whole number that may be quoted; -1 for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | str):
        return _MISSING_NUMBER
    return int(value) if re.fullmatch(r"[0-9]{1,18}", str(value)) else _MISSING_NUMBER


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
        raise malformed(source, "`keypoints` to hold numbers", error, "export it again") from None
    return values


def _check_length(numbers: Any, keypoints: int, source: str) -> None:
    """Raise FormatError where an annotation's list is not empty and not of full length."""
    if isinstance(numbers, list) and len(numbers) in (0, 3 * keypoints):
        return
    is_list = isinstance(numbers, list)
    raise malformed(
        source,
        f"{3 * keypoints} numbers (x, y, v) per annotation for {keypoints} names",
        f"{len(numbers)} numbers" if is_list else type(numbers).__name__,
        "export it again",
    )


def _image_size(images: list[Entry], source: str) -> tuple[int, int]:
    """Return the (width, height) that all images have, (0, 0) where none says.

    Raises FormatError where they differ.
    """
    try:
        sizes = {
            (int(image["width"]), int(image["height"]))
            for image in images
            if image.get("width") and image.get("height")
        }
    except (ValueError, TypeError, OverflowError) as error:
        raise malformed(
            source, "width and height of images to be numbers", error, "export it again"
        ) from None
    if len(sizes) > 1:
        found = " and ".join(f"{width} x {height}" for width, height in sorted(sizes)[:2])
        raise malformed(source, "images of one size", found, "give one file per camera")
    return sizes.pop() if sizes else (0, 0)
