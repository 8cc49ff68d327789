"""Which keypoint file belongs to which camera, and whether their images are the same."""

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import OTHER_RESOLUTION, TYPICAL_PERCENTILE, ReadConfig
from mocap_calib.errors import MismatchError
from mocap_calib.types import Camera, Keypoints2D

_UNKNOWN_SIZE = (0, 0)


def pair_with_cameras(
    views: Sequence[Keypoints2D], camera_names: Sequence[str], cameras: Sequence[Camera]
) -> tuple[tuple[Keypoints2D, ...], tuple[Camera, ...]]:
    """Return the views with detections in the order of the cameras, and their cameras.

    The cameras have the image sizes of the files where they had none.

    camera_names: `[view]` camera that each view belongs to, as `match_cameras` returns them.

    Raises MismatchError where these are fewer than two, or of another size.
    """
    view_of = dict(zip(camera_names, views, strict=True))
    pairs = [
        (view_of[camera.name], camera)
        for camera in cameras
        if camera.name in view_of and _has_detections(view_of[camera.name])
    ]
    if len(pairs) < 2:
        found = ", ".join(camera.name for _, camera in pairs) or "none"
        raise MismatchError(
            "expected detections of two cameras or more, "
            f"found those of {len(pairs)} ({found}); add the other keypoint files"
        )
    sized = tuple(map_in_threads(lambda pair: _take_image_size(*pair), pairs))
    return tuple(view for view, _ in pairs), sized


def compose_name(name: str) -> str:
    """Return a name with its accents composed (Unicode's NFC), as names are compared.

    macOS takes them apart in the names of files: `é` becomes `e` and a mark.
    """
    return unicodedata.normalize("NFC", name)


def match_cameras(views: Sequence[Keypoints2D], cameras: Sequence[Camera]) -> tuple[str, ...]:
    """Return the name of the camera that each view belongs to.

    By exact name, else regardless of case and of marks (`cam01`, `Cam_01`).

    Raises MismatchError for keypoints without a camera, and for two files of one camera.
    """
    known = [camera.name for camera in cameras]
    alike = [_names_alike(view.camera, known) for view in views]
    if any(len(names) != 1 for names in alike):
        found = ", ".join(view.camera for view in views) or "none"
        raise MismatchError(
            "expected a camera of the same name for each keypoint file, "
            f"found keypoints of {found} and cameras {', '.join(known) or 'none'}; "
            f"{_naming_remedy(views, known)}"
        )
    matched = tuple(name for names in alike for name in names)
    _check_one_file_each(views, matched)
    return matched


def _naming_remedy(views: Sequence[Keypoints2D], known: Sequence[str]) -> str:
    """Return how to tell which camera each file is of, where their names do not.

    Where each path has the name of one camera in it, it is the option that finds these names.
    """
    if not views or not known:
        return "rename one side"
    pattern = "|".join(sorted(map(re.escape, known), key=len, reverse=True))
    named = [set(re.findall(pattern, view.source)) for view in views]
    cameras = {name for names in named for name in names}
    if all(len(names) == 1 for names in named) and len(cameras) == len(views):
        return f'say --camera-regex "{pattern}", which finds these names in the paths'
    nameless = next(view for view in views if len(_names_alike(view.camera, known)) != 1)
    taken = {_fold_name(view.camera) for view in views}
    camera = next((name for name in known if _fold_name(name) not in taken), known[0])
    return (
        f"say which camera each file is of, as {camera}={nameless.source}, or which part of a path "
        "is the name with --camera-regex, or rename one side"
    )


def views_named(views: Sequence[Keypoints2D], cameras: Sequence[Camera]) -> tuple[Keypoints2D, ...]:
    """Return the views whose name is one of the cameras', as `match_cameras` compares them."""
    known = {_fold_name(camera.name) for camera in cameras}
    return tuple(view for view in views if _fold_name(view.camera) in known)


def views_with_detections(views: Sequence[Keypoints2D]) -> tuple[Keypoints2D, ...]:
    """Return the views that have any detection; the others take no part in a recording."""
    return tuple(view for view in views if _has_detections(view))


def check_pixels(view: Keypoints2D) -> None:
    """Raise MismatchError where the positions are shares of the image."""
    highest = np.nanmax(view.positions, initial=0.0)
    lowest = np.nanmin(view.positions, initial=0.0)
    mapped.let_go()
    limit = ReadConfig().largest_share
    if 0 < max(highest, -lowest) <= limit:
        raise MismatchError(
            f"{view.source}: expected positions in pixels, found none above {limit}; "
            "say --image-size WIDTHxHEIGHT if they are shares of the image"
        )


def _check_one_file_each(views: Sequence[Keypoints2D], matched: Sequence[str]) -> None:
    """Raise MismatchError where two views belong to one camera, whose name `matched` has."""
    sources: dict[str, list[str]] = {}
    for view, name in zip(views, matched, strict=True):
        sources.setdefault(name, []).append(view.source)
    for name, files in sources.items():
        if len(files) > 1:
            raise MismatchError(
                "expected one keypoint file per camera, "
                f"found {' and '.join(files[:2])} for camera {name}; remove or rename one"
            )


def _has_detections(view: Keypoints2D) -> bool:
    """Return whether the view has any detection."""
    blocks = mapped.frame_slices(len(view.frames))
    return any(np.isfinite(view.positions[block]).any() for block in blocks)


def _take_image_size(view: Keypoints2D, camera: Camera) -> Camera:
    """Return the camera, with the image size of its keypoint file where it has none.

    Raises MismatchError where the sizes differ, or where the positions are not in pixels.
    """
    check_pixels(view)
    if camera.size == _UNKNOWN_SIZE:
        return replace(camera, size=view.image_size)
    found = ""
    if view.image_size == _UNKNOWN_SIZE:
        some = mapped.some_frames(view.positions)
        x, y = (np.nanpercentile(some[..., axis], TYPICAL_PERCENTILE) for axis in range(2))
        width, height = camera.size
        if x > OTHER_RESOLUTION * width or y > OTHER_RESOLUTION * height:
            found = f"detections at ({x:.0f}, {y:.0f})"
    elif view.image_size != camera.size:
        found = _size_text(view.image_size)
    mapped.let_go()
    if found:
        raise MismatchError(
            f"{view.source}: expected an image of {_size_text(camera.size)} as camera "
            f"{camera.name} has, found {found}; "
            "scale the intrinsics to the images of the keypoints"
        )
    return camera


def _size_text(size: tuple[int, int]) -> str:
    """Return `WIDTH x HEIGHT`."""
    return f"{size[0]} x {size[1]}"


def _names_alike(name: str, known: Sequence[str]) -> list[str]:
    """Return the name itself if it is known, else the known names of its letters and digits."""
    if name in known:
        return [name]
    return [each for each in known if _fold_name(each) == _fold_name(name)]


def _fold_name(name: str) -> str:
    """Return the letters and digits of a name, in small letters."""
    return "".join(letter for letter in compose_name(name).casefold() if letter.isalnum())
