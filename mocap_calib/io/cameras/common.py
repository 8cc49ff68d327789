"""What several camera formats share: cameras with or without extrinsics, and names of images."""

from collections.abc import Iterable, Mapping
from typing import Any

from mocap_calib.io.cameras.intrinsics import make_extrinsics
from mocap_calib.io.cameras.source import CameraFile, unique
from mocap_calib.io.document import Document
from mocap_calib.results import ObservedPoints
from mocap_calib.types import Camera, Floats

# COLMAP's camera models that have a lens of ours, and whether that is cv2.fisheye's
COLMAP_LENSES = {
    "SIMPLE_PINHOLE": False,
    "PINHOLE": False,
    "SIMPLE_RADIAL": False,
    "RADIAL": False,
    "OPENCV": False,
    "FULL_OPENCV": False,
    "OPENCV_FISHEYE": True,
    "SIMPLE_RADIAL_FISHEYE": True,
    "RADIAL_FISHEYE": True,
}

# `[3, 3]` rotation and `[3]` translation of cam_from_world
Extrinsics = tuple[Floats, Floats]
PlacedCamera = tuple[Camera, Extrinsics | None]

_IMAGE_ENDINGS = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")


def collect_cameras(
    found: Iterable[PlacedCamera],
    source: str,
    *,
    unit: str = "",
    notes: Iterable[str] = (),
    points: ObservedPoints | None = None,
) -> CameraFile:
    """Return the cameras of a file, each with its extrinsics where the file has them.

    points: that these cameras see, where the file has such.

    Raises FormatError where there is no camera, or two have one name.
    """
    placed = list(found)
    return CameraFile(
        cameras=unique((camera for camera, _ in placed), source),
        extrinsics={camera.name: given for camera, given in placed if given is not None},
        unit=unit,
        notes=tuple(notes),
        points=points or ObservedPoints.none(),
    )


def extrinsics_if_given(fields: Mapping[str, Any], source: str) -> Extrinsics | None:
    """Return the extrinsics in the fields R and t, None where one is missing.

    Raises FormatError.
    """
    if not {"R", "t"} <= fields.keys():
        return None
    return make_extrinsics(fields["R"], fields["t"], source)


def extrinsics_from_centre(rotation: Any, centre: Any, source: str) -> Extrinsics:
    """Return the extrinsics of a camera that a file places by its centre.

    rotation: `[3, 3]` of cam_from_world. centre: `[3]` in world coordinates.

    Raises FormatError.
    """
    rotation, centre = make_extrinsics(rotation, centre, source)
    return rotation, -rotation @ centre


def pinhole_matrix(fx: Any, fy: Any, cx: Any, cy: Any) -> list[list[Any]]:
    """Return the `[3, 3]` camera matrix of these numbers, as nested lists."""
    return [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]


def has_json_entry(document: Document, *keys: str) -> bool:
    """Return whether a JSON mapping has an entry with the keys, at its top or in a list there."""
    if document.syntax != "json" or not isinstance(document.tree, dict):
        return False
    entries: list[Any] = []
    for value in document.tree.values():
        entries += value if isinstance(value, list) else [value]
    return any(isinstance(entry, dict) and entry.keys() >= set(keys) for entry in entries)


def has_json_item(document: Document, name: str, key: str) -> bool:
    """Return whether the list of that name, at the top of JSON, has a mapping with the key."""
    if not document.has("json", name) or not isinstance(document.tree[name], list):
        return False
    return any(isinstance(item, dict) and key in item for item in document.tree[name])


def camera_of_image(name: str) -> str:
    """Return the name of the camera that took an image: the image's without its ending."""
    start, dot, ending = name.rpartition(".")
    return start if start and dot + ending.lower() in _IMAGE_ENDINGS else name
