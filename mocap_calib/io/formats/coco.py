"""Read and write COCO keypoint annotations: `images`, `annotations`, `categories` in one JSON file.

Traps: the third number of a point is a visibility (0, 1, 2) or, as many programs write it, a
score; some writers quote ids; categories without keypoints (boxes) may lie beside. Frame numbers
stand in the file names, in a field of the images, or nowhere; one file may hold several cameras,
told by a field or by the folders of the file names; Roboflow adds to the file names.

Written is a file per camera with a line per annotation; the confidence of a point stands in the
place of COCO's visibility, as the reader takes it.
"""

import json
import re
from typing import Any

import msgspec
import numpy as np

from mocap_calib.errors import FormatError, argument
from mocap_calib.io.detections import (
    FOLLOWED,
    SCORES,
    blank,
    cameras_by_pattern,
    frame_number,
    make_view,
    unique_names,
    visibility_as_confidence,
)
from mocap_calib.io.document import Document
from mocap_calib.io.file import Origin
from mocap_calib.io.format import Format
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.types import Bools, Ints, Keypoints2D

_LISTS = {"images", "annotations", "categories"}
_EXPECTED = "COCO annotations (an object with the lists `images`, `annotations` and `categories`)"
_CAMERA_FIELDS = ("camera", "cam_id", "camera_id", "cam")
_ROBOFLOW = re.compile(r"(_(?:png|jpe?g|bmp))?\.rf\.[0-9a-f]{8,}(?=\.\w+$)")  # what it adds
_MISSING_NUMBER = -1
_LOSSLESS = (9, 9)  # decimals of positions and confidences, to the last digit that matters

Id = int | float | str | None


class _Image(msgspec.Struct):
    """An image; only whole numbers, and names of cameras, count in the fields of any type."""

    id: Id = None
    file_name: str | None = None
    width: float | None = None
    height: float | None = None
    frame: Any = None
    frame_id: Any = None
    camera: Any = None
    cam_id: Any = None
    camera_id: Any = None
    cam: Any = None

    @property
    def name(self) -> str:
        """The file name without what Roboflow adds: `a_1_png.rf.<hash>.jpg` for `a_1.jpg`."""
        return _ROBOFLOW.sub("", self.file_name or "")


class _Annotation(msgspec.Struct):
    image_id: Id = None
    category_id: Id = None
    keypoints: list[float | None] | None = None


class _Category(msgspec.Struct):
    id: Id = None
    keypoints: list[str | int] | None = None


class _File(msgspec.Struct):
    images: list[_Image]
    annotations: list[_Annotation]
    categories: list[_Category]


def sniff(document: Document) -> bool:
    """Return whether the file is a JSON object with one of COCO's lists."""
    return isinstance(document.json, dict) and bool(_LISTS & document.json.keys())


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read the camera of the file, or several cameras where the images say so.

    All `images` are frames, also those without annotations. The instance is the position among the
    image's annotations in file order; annotations of categories without keypoints do not count.
    Raises FormatError.
    """
    if not document.json.keys() >= _LISTS:
        remedy = "join results without images and names with their annotations file"
        raise document.refuse(_EXPECTED, document.describe()[0], remedy)
    file = document.records(_File)
    if not file.images:
        remedy = "export the images together with the annotations"
        raise document.refuse("at least one entry in `images`", "none", remedy)
    named = [category for category in file.categories if category.keypoints]
    lists = {tuple(map(str, category.keypoints or ())) for category in named}
    if len(lists) != 1:
        found = f"{len(lists)} different lists" if lists else "none"
        remedy = "keep the category of one kind of subject"
        raise document.refuse("one list of keypoint names in `categories`", found, remedy)
    keypoints = unique_names(lists.pop(), document.source)
    categories = {"None", *(str(category.id) for category in named)}
    annotations = [each for each in file.annotations if str(each.category_id) in categories]
    _check(file.images, annotations, 3 * len(keypoints), document)
    by_camera = _images_by_camera(file.images, document, options)
    return tuple(
        _view(Origin(camera, document.source), images, annotations, keypoints)
        for camera, images in by_camera.items()
    )


def _check(
    images: list[_Image], annotations: list[_Annotation], numbers: int, document: Document
) -> None:
    """Raise FormatError for ids that repeat or are not there, and for another count of numbers."""
    ids = {str(image.id) for image in images}
    if len(ids) < len(images):
        found = f"{len(images)} images with {len(ids)} ids"
        raise document.refuse("each image id once", found)
    for annotation in annotations:
        if str(annotation.image_id) not in ids:
            expected = "each annotation's image_id among `images`"
            remedy = "export images and annotations together"
            raise document.refuse(expected, annotation.image_id, remedy)
        found_numbers = len(annotation.keypoints or ())
        if found_numbers not in (0, numbers):
            expected = f"{numbers} numbers (x, y, v) per annotation for {numbers // 3} names"
            raise document.refuse(expected, f"{found_numbers} numbers")


def _view(
    origin: Origin,
    images: list[_Image],
    annotations: list[_Annotation],
    keypoints: tuple[str, ...],
) -> Keypoints2D:
    """Return the detections of one camera, whose images these are. Raises FormatError."""
    frame_of = {str(image.id): frame for frame, image in enumerate(images)}
    points: list[list[list[float | None]]] = [[] for _ in images]
    for annotation in annotations:
        if str(annotation.image_id) in frame_of:
            points[frame_of[str(annotation.image_id)]].append(annotation.keypoints or [])
    values = blank(len(images), max(map(len, points)), len(keypoints), origin.source)
    for values_of_frame, points_of_frame in zip(values, points, strict=True):
        for target, numbers in zip(values_of_frame, points_of_frame, strict=False):
            if numbers:
                target[:] = np.array(numbers, dtype=np.float64).reshape(-1, 3)
    values[..., 2] = visibility_as_confidence(values[..., 2])
    return make_view(
        origin,
        keypoints,
        _frame_numbers(images, origin.source),
        values,
        tracked=False,
        image_size=_image_size(images, origin.source),
        rows=[image.file_name or image.id for image in images],
    )


# --- images


def _images_by_camera(
    images: list[_Image], document: Document, options: ReadOptions
) -> dict[str, list[_Image]]:
    """Return the images of each camera. Raises FormatError.

    The user's pattern tells it, else a field of the images, else their folders; all images are of
    the file's camera where none of them tells.
    """
    names, pattern = [image.name for image in images], options.camera_pattern
    by_pattern = cameras_by_pattern(names, pattern, named="file name", source=document.source)
    by_field = [_camera_field(image) for image in images]
    cameras = by_pattern or (by_field if all(by_field) else _cameras_by_folder(names, document))
    if len(set(cameras)) <= 1 and not by_pattern:
        return {document.camera: images}
    images_of: dict[str, list[_Image]] = {}
    for image, camera in zip(images, cameras, strict=True):
        images_of.setdefault(camera, []).append(image)
    return images_of


def _camera_field(image: _Image) -> str:
    values = (getattr(image, name) for name in _CAMERA_FIELDS)
    return next((str(value) for value in values if isinstance(value, str | int)), "")


def _cameras_by_folder(names: list[str], document: Document) -> list[str]:
    """Return each image's camera: the part of the folders that differs.

    Where several parts differ, it is the one that tells images of one frame number apart. Nothing
    where there is one folder, or where the user has named the camera and the numbers do not
    contradict. Raises FormatError.
    """
    folders = [re.split(r"[/\\]", name)[:-1] for name in names]
    numbers = [frame_number(name) for name in names]
    numbers_differ = len(set(numbers)) == len(numbers)
    if len(set(map(tuple, folders))) == 1 or (document.named and numbers_differ):
        return []
    same_depth = len(set(map(len, folders))) == 1
    levels = [list(level) for level in zip(*folders, strict=True)] if same_depth else []
    parts = [level for level in levels if len(set(level)) > 1]
    if len(parts) > 1 and not numbers_differ:
        parts = [part for part in parts if len({*zip(part, numbers, strict=True)}) == len(names)]
        parts = parts[:1]
    if len(parts) == 1:
        return parts[0]
    other = next(name for name, folder in zip(names, folders, strict=True) if folder != folders[0])
    remedy = f"say which part is the camera with {argument('camera_regex')}"
    raise document.refuse("folders that tell the cameras", f"{names[0]} and {other}", remedy)


def _frame_numbers(images: list[_Image], source: str) -> Ints:
    """Return the `[image]` frame numbers. Raises FormatError.

    They all come from the first place where every image has a number of its own, else from the
    first place where all have one.

    The places: the integer at the end of the file name, `frame`, `frame_id`, the first integer of
    the file name, and `id` where none of these counts. Images whose numbers repeat are those of
    two cameras, which `id` would line up one behind the other.
    """
    places = [
        [frame_number(image.name) for image in images],
        [_whole_number(image.frame) for image in images],
        [_whole_number(image.frame_id) for image in images],
        [_first_integer(image.name) for image in images],
    ]
    if not any(min(numbers) >= 0 and len(set(numbers)) > 1 for numbers in places):
        places.append([_whole_number(image.id) for image in images])
    complete = [numbers for numbers in places if min(numbers) >= 0]
    if not complete:
        image = images[places[-1].index(min(places[-1]))]
        expected, remedy = "a frame number at the end of each file name", "add a field `frame`"
        raise FormatError(source, expected, image.file_name or image.id, f"{remedy} to each image")
    unique = (numbers for numbers in complete if len(set(numbers)) == len(numbers))
    return np.array(next(unique, complete[0]), dtype=np.int64)


def _first_integer(name: str) -> int:
    """Return the first integer of a file name; -1 where there is none.

    Its folders and its suffix do not count: `a7/000012_cam1.jpg` -> 12.
    """
    file_name = re.split(r"[/\\]", name.strip())[-1]
    digits = re.search(r"[0-9]+", re.sub(r"\.[A-Za-z]\w*$", "", file_name))
    return _whole_number(digits[0]) if digits else _MISSING_NUMBER


def _whole_number(value: object) -> int:
    """Return a whole number that may be quoted; -1 for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | str):
        return _MISSING_NUMBER
    return int(value) if re.fullmatch(r"[0-9]{1,18}", str(value)) else _MISSING_NUMBER


def _image_size(images: list[_Image], source: str) -> tuple[int, int]:
    """Return the (width, height) that all images have, (0, 0) where none says.

    Raises FormatError where they differ.
    """
    sizes = {(each.width, each.height) for each in images if each.width and each.height}
    if len(sizes) > 1 or not np.isfinite([*sizes]).all():
        found = " and ".join(f"{width:g} x {height:g}" for width, height in sorted(sizes)[:2])
        raise FormatError(source, "images of one size", found, "give one file per camera")
    width, height = sizes.pop() if sizes else (0, 0)
    return int(width), int(height)


# --- writing


def write(views: tuple[Keypoints2D, ...]) -> dict[str, bytes]:
    """Write a file per camera: file name -> content."""
    return {f"{view.camera}.json": format_coco(view, decimals=_LOSSLESS).encode() for view in views}


def format_coco(view: Keypoints2D, *, decimals: tuple[int, int] = (1, 2)) -> str:
    """Return the detections of one camera as COCO annotations.

    decimals: of positions and confidences, by default those that a detector has.

    The frame numbers are the image ids, and stand in the file names. Instances without any
    keypoint keep their place with zeros; those behind the last of a frame are left out. The
    confidence of what is there is at least one of its last digit, since 0 means missing.
    """
    seen: Bools = np.asarray(np.isfinite(view.positions).all(-1))
    confidence = np.where(seen, np.clip(view.confidence, 0.1 ** decimals[1], None), 0.0)
    pixels = np.where(seen[..., None], view.positions, 0.0).astype(np.float64).round(decimals[0])
    third = confidence.astype(np.float64).round(decimals[1])[..., None]
    points = np.concatenate([pixels, third], axis=-1)
    any_seen: Bools = np.asarray(seen.any(-1))
    there = np.logical_or.accumulate(any_seen[:, ::-1], axis=1)[:, ::-1]  # or further back
    width, height = view.image_size
    images = [
        {"id": n, "file_name": f"frame_{n:06d}.jpg", "width": width, "height": height}
        for n in view.frames.tolist()
    ]
    annotations = [
        {
            "id": number,
            "image_id": int(view.frames[frame]),
            "category_id": 1,
            "num_keypoints": int(seen[frame, instance].sum()),
            # a whole number is written without its decimal point
            "keypoints": [
                int(value) if value == int(value) else value
                for value in points[frame, instance].ravel().tolist()
            ],
        }
        for number, (frame, instance) in enumerate(np.argwhere(there), start=1)
    ]
    info = {"description": f"mocap-calib keypoints of {view.camera}"}
    category = {"id": 1, "name": "person", "keypoints": list(view.keypoints)}
    lists = [
        f'"info":{_compact(info)}',
        f'"categories":{_compact([category])}',
        f'"images":{_one_per_line(images)}',
        f'"annotations":{_one_per_line(annotations)}',
    ]
    return "{" + ",\n".join(lists) + "}\n"


def _one_per_line(entries: list[dict[str, Any]]) -> str:
    return "[\n" + ",\n".join(map(_compact, entries)) + "\n]"


def _compact(value: object) -> str:
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False)


ANNOTATIONS = Format(
    kind="keypoints",
    name="coco",
    title="COCO annotations .json",
    sniff=sniff,
    read=read,
    write=write,
    endings=(".json",),
    loses=(FOLLOWED, SCORES),
)
