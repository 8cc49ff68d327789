"""Read and write COCO keypoint annotations; read COCO results, and AlphaPose's.

Annotations are `images`, `annotations`, `categories` in one JSON file. Traps: the third number of a
point is a visibility (0, 1, 2) or, as many programs write it, a score; some writers quote ids;
categories without keypoints (boxes) may lie beside. Frame numbers stand in the file names, in a
field of the images, or nowhere; one file may hold several cameras, told by a field or by the
folders of the file names; Roboflow adds to the file names.

Results are flat lists of detections. COCO calls an image by a number, AlphaPose by a file name.
Traps: frames without a detection are absent; names of keypoints are absent; one list may hold
several cameras, which only the images tell apart.

Written are annotations, a file per camera with a line per annotation; the confidence of a point
stands in the place of COCO's visibility, as the reader takes it.
"""

import json
import re
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np

from mocap_calib.errors import FormatError, argument
from mocap_calib.io.detections import (
    ABSENT_FRAMES,
    FOLLOWED,
    SCORES,
    cameras_by_pattern,
    frame_number,
    is_list_of,
    triples,
    view_of_frames,
)
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.types import Bools, Floats, Keypoints2D

_LISTS = {"images", "annotations", "categories"}
_EXPECTED = "COCO annotations (an object with the lists `images`, `annotations` and `categories`)"
_CAMERA_FIELDS = ("camera", "cam_id", "camera_id", "cam")
_ROBOFLOW = re.compile(r"(_(?:png|jpe?g|bmp))?\.rf\.[0-9a-f]{8,}(?=\.\w+$)")  # what it adds
# AlphaPose's only layouts of their length
_ALPHAPOSE_LAYOUTS = ("halpe_26", "halpe_136", "coco_wholebody_133")
_LOSSLESS = (9, 9)  # decimals of positions and confidences, to the last digit that matters

_PASSED_OVER = (  # boxes, outlines, and what is said of the data set
    *("info", "licenses", "license", "id", "category_id", "skeleton", "num_keypoints"),
    *("bbox", "box", "area", "segmentation", "iscrowd", "score"),
)

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


class _Result(msgspec.Struct):
    image_id: int | str
    keypoints: list[float | None] | None = None


# --- annotations


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
    (keypoints,) = lists
    categories = {"None", *(str(category.id) for category in named)}
    points_of: dict[str, list[Floats]] = {str(image.id): [] for image in file.images}
    if len(points_of) < len(file.images):
        found = f"{len(file.images)} images with {len(points_of)} ids"
        raise document.refuse("each image id once", found)
    for annotation in file.annotations:
        if str(annotation.category_id) in categories:
            if str(annotation.image_id) not in points_of:
                expected = "each annotation's image_id among `images`"
                remedy = "export images and annotations together"
                raise document.refuse(expected, annotation.image_id, remedy)
            points = triples(annotation.keypoints, document.source, "keypoints")
            points_of[str(annotation.image_id)].append(points)
    views = []
    for camera, images in _images_by_camera(file.images, document, options).items():
        labels = [image.file_name or image.id for image in images]
        view = view_of_frames(
            replace(document, camera=camera),
            options,
            _frame_numbers(images, document.source),
            [points_of[str(image.id)] for image in images],
            names=keypoints,
            image_size=_image_size(images, document.source),
            row_name=labels.__getitem__,
        )
        views.append(view)
    return tuple(views)


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
    folders = [tuple(re.split(r"[/\\]", name)[:-1]) for name in names]
    numbers = [frame_number(name) for name in names]
    numbers_differ = len(set(numbers)) == len(numbers)
    if len(set(folders)) == 1 or (document.named and numbers_differ):
        return []
    same_depth = len(set(map(len, folders))) == 1
    levels = map(list, zip(*folders, strict=True)) if same_depth else ()
    parts = [level for level in levels if len(set(level)) > 1]
    if len(parts) > 1 and not numbers_differ:
        parts = [part for part in parts if len({*zip(part, numbers, strict=True)}) == len(names)]
        parts = parts[:1]
    if len(parts) == 1:
        return parts[0]
    other = next(name for name, folder in zip(names, folders, strict=True) if folder != folders[0])
    remedy = f"say which part is the camera with {argument('camera_regex')}"
    raise document.refuse("folders that tell the cameras", f"{names[0]} and {other}", remedy)


def _frame_numbers(images: list[_Image], source: str) -> list[int]:
    """Return the `[image]` frame numbers. Raises FormatError.

    They all come from the first place where every image has a number of its own, else from the
    first place where all have one.

    The places: the integer at the end of the file name, `frame`, `frame_id`, the first integer of
    the file name, and `id` where none of these counts. Images whose numbers repeat are those of
    two cameras, which `id` would line up one behind the other.
    """
    places = [
        [frame_number(image.name) for image in images],
        *(
            [_whole_number(getattr(image, key)) for image in images]
            for key in ("frame", "frame_id")
        ),
        [_first_integer(image.name) for image in images],
    ]
    if not any(min(numbers) >= 0 and len(set(numbers)) > 1 for numbers in places):
        places.append([_whole_number(image.id) for image in images])
    complete = [numbers for numbers in places if min(numbers) >= 0]
    if not complete:
        image = images[places[-1].index(-1)]
        expected, remedy = "a frame number at the end of each file name", "add a field `frame`"
        raise FormatError(source, expected, image.file_name or image.id, f"{remedy} to each image")
    unique = (numbers for numbers in complete if len(set(numbers)) == len(numbers))
    return next(unique, complete[0])


def _first_integer(name: str) -> int:
    """Return the first integer of a file name; -1 where there is none.

    Its folders and its suffix do not count: `a7/000012_cam1.jpg` -> 12.
    """
    file_name = re.split(r"[/\\]", name.strip())[-1]
    return _whole_number(
        next(iter(re.findall("[0-9]+", re.sub(r"\.[A-Za-z]\w*$", "", file_name))), "")
    )


def _whole_number(value: object) -> int:
    """Return a whole number that may be quoted; -1 for anything else."""
    is_number = isinstance(value, int | str) and re.fullmatch("[0-9]{1,18}", str(value))
    return int(str(value)) if is_number else -1


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
    width, height = view.image_size
    images = [
        {"id": n, "file_name": f"frame_{n:06d}.jpg", "width": width, "height": height}
        for n in view.frames.tolist()
    ]
    there = [
        (frame, instance)
        for frame, found in enumerate(np.asarray(seen.any(-1)))
        for instance in range(len(np.trim_zeros(found, "b")))
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
        for number, (frame, instance) in enumerate(there, start=1)
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


def _one_per_line(entries: Iterable[dict[str, Any]]) -> str:
    return "[\n" + ",\n".join(map(_compact, entries)) + "\n]"


def _compact(value: object) -> str:
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False)


ANNOTATIONS = Format(
    name="coco",
    title="COCO annotations .json",
    sniff=sniff,
    read=read,
    write=write,
    passed_over=_PASSED_OVER,
    endings=(".json",),
    loses=(FOLLOWED, SCORES),
)


# --- results


def sniff_results(document: Document) -> bool:
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
    return read_results(document, options, unambiguous=_ALPHAPOSE_LAYOUTS)


def read_results(
    document: Document, options: ReadOptions, unambiguous: tuple[str, ...] = ()
) -> tuple[Keypoints2D, ...]:
    """Read the cameras of COCO results, as the user's pattern finds them in the image ids.

    Frames are the image ids, or what the pattern's group `frame` finds in them. All are of the
    file's camera where there is no pattern. Raises FormatError.
    """
    entries, pattern = document.records(list[_Result]), options.camera_pattern
    images = [str(entry.image_id) for entry in entries]
    cameras = cameras_by_pattern(images, pattern, named="image_id", source=document.source)
    detections_of: dict[str, dict[str, list[Floats]]] = {}
    for k, camera in enumerate(cameras or [document.camera] * len(entries)):
        points = triples(entries[k].keypoints, f"{document.source}: entry {k}", "keypoints")
        detections_of.setdefault(camera, {}).setdefault(images[k], []).append(points)
    return tuple(
        view_of_frames(
            replace(document, camera=camera),
            options,
            [_frame_text(image, pattern) for image in by_image],
            list(by_image.values()),
            unambiguous=unambiguous,
            remarks=(ABSENT_FRAMES,),
        )
        for camera, by_image in detections_of.items()
    )


def _frame_text(image: str, pattern: str) -> str:
    """Return what the pattern's group `frame` finds in an image; the image where it finds none."""
    found = re.search(pattern, image) if "(?P<frame>" in pattern else None
    return str(found["frame"]) if found else image


RESULTS = Format(
    name="coco-results",
    title="COCO results .json",
    sniff=sniff_results,
    read=read_results,
    passed_over=_PASSED_OVER,
)
ALPHAPOSE = Format(
    name="alphapose",
    title="AlphaPose .json",
    sniff=sniff_alphapose,
    read=read_alphapose,
    passed_over=_PASSED_OVER,
)
