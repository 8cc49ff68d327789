"""COCO keypoint annotations (`images`, `annotations`, `categories` in one JSON file)."""

import re
from collections.abc import Iterable
from typing import Any

import numpy as np

from mocap_calib.io.file import (
    Origin,
    blank,
    find_camera,
    frame_number,
    make_view,
    malformed,
    unique_names,
    visibility_as_confidence,
)
from mocap_calib.io.keypoints.document import Document, Item, ReadOptions
from mocap_calib.types import Floats, Ints, Keypoints2D

_EXPECTED = "COCO annotations (an object with the lists `images`, `annotations` and `categories`)"


def sniff(document: Document) -> bool:
    """A JSON object with the lists of COCO."""
    return isinstance(document.json, dict) and bool(
        {"images", "annotations", "categories"} & document.json.keys()
    )


def read(item: Item, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """The detections of a COCO annotations file; of several cameras where the images say so.

    All `images` are frames, also those without annotations. The instance is the position among the image's
    annotations in file order; annotations of categories without keypoints do not count. Raises FormatError.
    """
    source = item.origin.source
    data = _checked(item.document.json, source)
    images, annotations = (_objects(data, key, source) for key in ("images", "annotations"))
    if not images:
        raise malformed(
            source,
            "at least one entry in `images`",
            "none",
            "export the images together with the annotations",
        )
    names, subjects = _vocabulary(_objects(data, "categories", source), source)
    annotations = [
        a for a in annotations if "category_id" not in a or str(a["category_id"]) in subjects
    ]
    _check_ids(images, annotations, source)
    cameras = _cameras(images, item, options)
    return tuple(
        _view(Origin(camera, source), own, annotations, names) for camera, own in cameras.items()
    )


def _view(
    origin: Origin,
    images: list[dict[str, Any]],
    annotations: list[dict[str, Any]],
    names: tuple[str, ...],
) -> Keypoints2D:
    """One camera's detections."""
    source = origin.source
    place = {str(image.get("id")): row for row, image in enumerate(images)}
    annotations = [a for a in annotations if str(a["image_id"]) in place]
    row, instance = _places([place[str(a["image_id"])] for a in annotations])
    values = blank(len(images), int(instance.max(initial=-1)) + 1, len(names), source)
    values[row, instance] = _points(annotations, len(names), source)
    values[..., 2] = visibility_as_confidence(values[..., 2])
    rows = [image.get("file_name", image.get("id")) for image in images]
    return make_view(
        origin,
        names,
        _frame_numbers(images, source),
        values,
        tracked=False,
        image_size=_image_size(images, source),
        rows=rows,
    )


def _checked(data: Any, source: str) -> dict[str, Any]:
    if not isinstance(data, dict) or not {"images", "annotations", "categories"} <= data.keys():
        found = (
            f"an object with {', '.join(map(str, list(data)[:6])) or 'nothing'}"
            if isinstance(data, dict)
            else f"a {type(data).__name__}"
        )
        raise malformed(
            source,
            _EXPECTED,
            found,
            "results without images and names must be joined with their annotations file",
        )
    return data


def _check_ids(
    images: list[dict[str, Any]], annotations: list[dict[str, Any]], source: str
) -> None:
    known = {str(image.get("id")) for image in images}
    if len(known) < len(images):
        raise malformed(
            source,
            "each image id once",
            f"{len(images)} images with {len(known)} ids",
            "export it again",
        )
    stranger = next((a for a in annotations if str(a.get("image_id")) not in known), None)
    if stranger is not None:
        raise malformed(
            source,
            "each annotation's image_id among `images`",
            stranger.get("image_id"),
            "export images and annotations together",
        )


def _cameras(
    images: list[dict[str, Any]], item: Item, options: ReadOptions
) -> dict[str, list[dict[str, Any]]]:
    """The images of each camera: by the user's pattern, by a field of the images, by their folders; all are one's where the user names it."""
    names = _names(images)
    found = (
        [find_camera(name, options.camera_pattern) for name in names]
        if options.camera_pattern
        else [""]
    )
    if any(found):
        if not all(found):
            raise malformed(
                item.origin.source,
                f"a camera in each file name by the pattern {options.camera_pattern}",
                names[found.index("")],
                "change it",
            )
        own = found
    elif all(_camera_field(image) for image in images):
        own = [_camera_field(image) for image in images]
    else:
        own = _folders(names, item.named, item.origin.source)
    if len(set(own)) <= 1 and not any(found):
        return {item.camera: images}
    return {
        camera: [image for image, its in zip(images, own, strict=True) if its == camera]
        for camera in dict.fromkeys(own)
    }


def _camera_field(image: dict[str, Any]) -> str:
    return next(
        (
            str(image[key])
            for key in ("camera", "cam_id", "camera_id", "cam")
            if isinstance(image.get(key), str | int)
        ),
        "",
    )


def _names(images: list[dict[str, Any]]) -> list[str]:
    """The file names; Roboflow's without what it adds (`a_0001_png.rf.<hash>.jpg`)."""
    names = [
        image["file_name"] if isinstance(image.get("file_name"), str) else "" for image in images
    ]
    return [
        re.sub(r"(_(?:png|jpe?g|bmp))?\.rf\.[0-9a-f]{8,}(?=\.\w+$)", "", name) for name in names
    ]


def _folders(names: list[str], named: bool, source: str) -> list[str]:
    """Each image's camera: the part of the folders that differs; of several, that which tells images of one number apart.

    Nothing where there is one folder, or where the user has named the camera and the numbers do not contradict. Raises FormatError.
    """
    parts, numbers = (
        [re.split(r"[/\\]", name)[:-1] for name in names],
        [frame_number(name) for name in names],
    )
    if len(set(map(tuple, parts))) == 1 or (named and len(set(numbers)) == len(numbers)):
        return []
    columns = (
        [list(column) for column in zip(*parts, strict=True) if len(set(column)) > 1]
        if len(set(map(len, parts))) == 1
        else []
    )
    if len(columns) == 1:
        return columns[0]
    for column in columns if len(set(numbers)) < len(numbers) else []:
        if len(set(zip(column, numbers, strict=True))) == len(names):
            return column
    other = next(name for name, part in zip(names, parts, strict=True) if part != parts[0])
    raise malformed(
        source,
        "folders that tell the cameras",
        f"{names[0]} and {other}",
        "say which part is the camera with --camera-regex",
    )


def _objects(data: dict[str, Any], key: str, source: str) -> list[dict[str, Any]]:
    found = data[key]
    if not isinstance(found, list) or not all(isinstance(entry, dict) for entry in found):
        raise malformed(
            source, f"`{key}` to be a list of objects", type(found).__name__, "export it again"
        )
    return found


def _vocabulary(
    categories: Iterable[dict[str, Any]], source: str
) -> tuple[tuple[str, ...], set[str]]:
    """The keypoint names, and the ids (as text: some writers quote them) of the categories that have them."""
    named = [c for c in categories if isinstance(c.get("keypoints"), list) and c["keypoints"]]
    lists = {tuple(map(str, c["keypoints"])) for c in named}
    if len(lists) != 1:
        found = "none" if not lists else f"{len(lists)} different lists"
        raise malformed(
            source,
            "one list of keypoint names in `categories`",
            found,
            "keep the category of one kind of subject",
        )
    return unique_names(lists.pop(), source), {str(c.get("id")) for c in named}


def _frame_numbers(images: list[dict[str, Any]], source: str) -> Ints:
    """`[image]` numbers, all from the first place where every image has one of its own, else from the first where all have one.

    The places: the integer at the end of the file name, `frame`, `frame_id`, the first integer of the file name, and `id` where none of
    these counts: images whose numbers repeat are those of two cameras, which `id` would line up one behind the other. Raises FormatError.
    """
    names = _names(images)
    places = [[frame_number(name) for name in names]]
    places += [[_whole(image.get(key)) for image in images] for key in ("frame", "frame_id")]
    places += [[_first_integer(name) for name in names]]
    counting = any(min(numbers) >= 0 and len(set(numbers)) > 1 for numbers in places)
    places += [] if counting else [[_whole(image.get("id")) for image in images]]
    complete = [numbers for numbers in places if min(numbers) >= 0]
    if not complete:
        worst = images[places[-1].index(min(places[-1]))]
        raise malformed(
            source,
            "a frame number at the end of each file name",
            worst.get("file_name", worst),
            "add a field `frame` to each image",
        )
    return np.array(
        next((numbers for numbers in complete if len(set(numbers)) == len(numbers)), complete[0]),
        dtype=np.int64,
    )


def _stem(name: str) -> str:
    """The name without folders and suffix."""
    return re.sub(r"\.[A-Za-z]\w*$", "", re.split(r"[/\\]", name.strip())[-1])


def _first_integer(name: str) -> int:
    """The first integer of a file name without its folders (`a7/000012_cam1.jpg` -> 12); -1 where there is none."""
    digits = re.search(r"[0-9]+", _stem(name))
    return _whole(digits[0]) if digits else -1


def _whole(value: object) -> int:
    """A whole number that may be quoted; -1 for anything else."""
    plain = (
        isinstance(value, int | str)
        and not isinstance(value, bool)
        and re.fullmatch(r"[0-9]{1,18}", str(value))
    )
    return int(str(value)) if plain else -1


def _places(rows: list[int]) -> tuple[Ints, Ints]:
    """`[annotation]` row of its frame and `[annotation]` instance within it."""
    row = np.array(rows, dtype=np.int64)
    grouped = np.argsort(row, kind="stable")
    start = np.searchsorted(
        row[grouped], row[grouped]
    )  # where each frame's run of annotations begins
    instance = np.empty_like(row)
    instance[grouped] = np.arange(len(row)) - start
    return row, instance


def _points(annotations: list[dict[str, Any]], keypoints: int, source: str) -> Floats:
    """`[annotation, keypoint, 3]` x, y and third value; NaN for an annotation that has no points."""
    values = np.full((len(annotations), keypoints, 3), np.nan)
    lists = [a.get("keypoints") or [] for a in annotations]
    wrong = [
        entry
        for entry in lists
        if not isinstance(entry, list) or len(entry) not in (0, 3 * keypoints)
    ]
    if wrong:
        found = (
            f"{len(wrong[0])} numbers" if isinstance(wrong[0], list) else type(wrong[0]).__name__
        )
        raise malformed(
            source,
            f"{3 * keypoints} numbers (x, y, v) per annotation for {keypoints} names",
            found,
            "export it again",
        )
    full = [k for k, entry in enumerate(lists) if entry]
    try:
        values[full] = np.array([lists[k] for k in full], dtype=np.float64).reshape(
            -1, keypoints, 3
        )
    except (ValueError, TypeError, OverflowError) as error:
        raise malformed(source, "`keypoints` to hold numbers", error, "export it again") from None
    return values


def _image_size(images: list[dict[str, Any]], source: str) -> tuple[int, int]:
    """(width, height) that the images have in common, (0, 0) where none says."""
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
        found = " and ".join(f"{w} x {h}" for w, h in sorted(sizes)[:2])
        raise malformed(source, "images of one size", found, "give one file per camera")
    return sizes.pop() if sizes else (0, 0)
