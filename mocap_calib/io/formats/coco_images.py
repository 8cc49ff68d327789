"""Find the cameras, the frame numbers and the size of the images of a COCO file.

Traps: frame numbers stand in the file names, in a field of the images, or nowhere; one file may
hold several cameras, told by a field or by the folders of the file names; Roboflow adds to the
file names.
"""

import re
from typing import Any

import numpy as np

from mocap_calib.errors import FormatError, argument
from mocap_calib.io.document import Document
from mocap_calib.io.file import frame_number
from mocap_calib.io.keypoints.options import ReadOptions
from mocap_calib.io.keypoints.per_frame import cameras_by_pattern
from mocap_calib.types import Ints

_CAMERA_FIELDS = ("camera", "cam_id", "camera_id", "cam")
_ROBOFLOW = re.compile(r"(_(?:png|jpe?g|bmp))?\.rf\.[0-9a-f]{8,}(?=\.\w+$)")  # what it adds
_MISSING_NUMBER = -1

Entry = dict[str, Any]  # of one of the lists of a COCO file


def images_by_camera(
    images: list[Entry], document: Document, options: ReadOptions
) -> dict[str, list[Entry]]:
    """Return the images of each camera. Raises FormatError.

    The user's pattern tells it, else a field of the images, else their folders; all images are of
    the file's camera where none of them tells.
    """
    by_pattern = cameras_by_pattern(
        _file_names(images), options.camera_pattern, named="file name", source=document.source
    )
    cameras = by_pattern or _cameras_by_field(images) or _cameras_by_folder(images, document)
    if len(set(cameras)) <= 1 and not by_pattern:
        return {document.camera: images}
    images_of: dict[str, list[Entry]] = {}
    for image, camera in zip(images, cameras, strict=True):
        images_of.setdefault(camera, []).append(image)
    return images_of


def _cameras_by_field(images: list[Entry]) -> list[str]:
    """Return each image's camera as its fields say it; nothing where one does not."""
    cameras = [_camera_field(image) for image in images]
    return cameras if all(cameras) else []


def _camera_field(image: Entry) -> str:
    for name in _CAMERA_FIELDS:
        if isinstance(image.get(name), str | int):
            return str(image[name])
    return ""


def _cameras_by_folder(images: list[Entry], document: Document) -> list[str]:
    """Return each image's camera: the part of the folders that differs.

    Where several parts differ, it is the one that tells images of one frame number apart. Nothing
    where there is one folder, or where the user has named the camera and the numbers do not
    contradict. Raises FormatError.
    """
    names = _file_names(images)
    folders = [re.split(r"[/\\]", name)[:-1] for name in names]
    numbers = [frame_number(name) for name in names]
    numbers_differ = len(set(numbers)) == len(numbers)
    if len(set(map(tuple, folders))) == 1 or (document.named and numbers_differ):
        return []
    parts = _parts_that_differ(folders)
    if len(parts) == 1:
        return parts[0]
    if not numbers_differ:
        for part in parts:
            if len(set(zip(part, numbers, strict=True))) == len(names):
                return part
    other = next(name for name, folder in zip(names, folders, strict=True) if folder != folders[0])
    raise FormatError(
        document.source,
        "folders that tell the cameras",
        f"{names[0]} and {other}",
        f"say which part is the camera with {argument('camera_regex')}",
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


def frame_numbers(images: list[Entry], source: str) -> Ints:
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
        raise FormatError(
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


def image_size(images: list[Entry], source: str) -> tuple[int, int]:
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
        raise FormatError(
            source, "width and height of images to be numbers", error, "export it again"
        ) from None
    if len(sizes) > 1:
        found = " and ".join(f"{width} x {height}" for width, height in sorted(sizes)[:2])
        raise FormatError(source, "images of one size", found, "give one file per camera")
    return sizes.pop() if sizes else (0, 0)
