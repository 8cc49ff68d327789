"""The cameras that a file holds: made and checked for readers, and what writers share."""

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.io.camera_checks import make_extrinsics
from mocap_calib.io.document import Document
from mocap_calib.io.file import find_repeated
from mocap_calib.io.zeros import unsigned_zeros
from mocap_calib.results import ObservedPoints
from mocap_calib.types import Camera, CameraClock, CameraRig, Floats, World

_REMEDY = "export the cameras again"
# what names may be that become those of files: a pattern, and words for it
FILE_NAME = (
    r"(?!\.)[^\x00-\x1f\x7f-\x9f/\\\"\u2028\u2029\ud800-\udfff]{1,80}",
    "characters that a file name may have",
)


@dataclass(frozen=True)
class CameraFile:
    """What a source says.

    extrinsics: camera name -> `[3, 3]` rotation and `[3]` translation of cam_from_world, for the
        cameras that have them.
    unit: of the lengths, "" where the file does not say.
    notes: what a user should know of what was left out.
    judgement: how far the cameras can be trusted, as `provenance.judgement` has it, where the file
        says so.
    points: that the cameras see, in their order; none in most formats.
    clocks: of the cameras whose frames are not numbered by the clock of the others.
    world: what the axes are, where the file says so.
    """

    cameras: tuple[Camera, ...]
    extrinsics: Mapping[str, tuple[Floats, Floats]]
    unit: str = ""
    notes: tuple[str, ...] = ()
    judgement: Mapping[str, Any] = field(default_factory=dict)
    points: ObservedPoints = field(default_factory=ObservedPoints.none)
    clocks: tuple[CameraClock, ...] = ()
    world: World = field(default_factory=World)


# --- for readers


def unique(cameras: Iterable[Camera], source: str) -> tuple[Camera, ...]:
    """Return the cameras as they are.

    Raises FormatError where there is none, or two have one name.
    """
    kept = tuple(cameras)
    twice = find_repeated(camera.name for camera in kept)
    if twice:
        found = f"{', '.join(twice)} twice"
        raise FormatError(source, "each camera name once", found, "rename one of them")
    if not kept:
        raise FormatError(source, "at least one camera", "none", _REMEDY)
    return kept


def entries(value: Any, what: str, source: str) -> list[tuple[str, dict[str, Any]]]:
    """Return (name or number, fields) of a mapping or a list of mappings.

    what: was expected, for the complaint.

    Raises FormatError.
    """
    pairs: list[tuple[Any, Any]] = []
    if isinstance(value, dict):
        pairs = list(value.items())
    elif isinstance(value, list):
        pairs = list(enumerate(value))
    if not pairs:
        raise FormatError(source, what, "none", _REMEDY)
    if not all(isinstance(fields, dict) for _, fields in pairs):
        raise FormatError(source, what, f"{type(value).__name__} of something else", _REMEDY)
    return [(str(name), fields) for name, fields in pairs]


def whole(value: Any, expected: str, source: str) -> int:
    """Return a whole number. Raises FormatError."""
    try:
        number = float(value)
        if number == int(number):
            return int(number)
    except (TypeError, ValueError, OverflowError):
        pass
    raise FormatError(source, expected, value, "mend it")


def join_camera_files(found: CameraFile, more: CameraFile, source: str) -> CameraFile:
    """Join the cameras of two files.

    Raises FormatError where they share a name or differ in their unit.
    """
    if found.unit != more.unit:
        units = sorted(unit or "none said" for unit in (found.unit, more.unit))
        both = " and ".join(units)
        raise FormatError(source, "files in one unit of length", both, "convert one of them")
    return CameraFile(
        cameras=unique((*found.cameras, *more.cameras), source),
        extrinsics={**found.extrinsics, **more.extrinsics},
        unit=found.unit,
        notes=(*found.notes, *more.notes),
        judgement=found.judgement if found.judgement == more.judgement else {},
    )


# --- for writers


def cannot(name: str, camera: str, expected: str, found: object, remedy: str) -> MismatchError:
    """Return the complaint of a format (`name`) that does not have what the camera has."""
    return MismatchError(
        f"{name}: camera {camera}", f"{expected}, which is all the format has", found, remedy
    )


def terms(camera: Camera, count: int, name: str, remedy: str = "write another format") -> Floats:
    """Return `[count]` k1 k2 p1 p2 (k3 (k4 k5 k6)), padded with zeros.

    name: of the format that is written.

    Raises MismatchError where the camera has more coefficients or is a fisheye's.
    """
    if camera.fisheye:
        raise cannot(name, camera.name, "a pinhole camera", "a fisheye camera", remedy)
    padded: Floats = np.concatenate([camera.distortion, np.zeros(8)])[:8]
    if (padded[count:] != 0).any():
        found = f"more ({camera.distortion.tolist()})"
        raise cannot(name, camera.name, f"{count} distortion coefficients", found, remedy)
    return padded[:count]


def need_names(
    cameras: Iterable[str],
    pattern: str,
    words: str,
    owner: str,
    remedy: str = "rename the camera",
) -> None:
    """Raise MismatchError where a camera's name does not match the pattern.

    words: describe the pattern.
    """
    for camera in cameras:
        if not re.fullmatch(pattern, camera):
            raise MismatchError(owner, f"camera names of {words}", f"{camera!r}", remedy)


def need_sizes(rig: CameraRig, name: str) -> None:
    """Raise MismatchError where a camera's image size is not known."""
    for camera in rig.cameras:
        if 0 in camera.size:
            raise MismatchError(
                name, f"the image size of camera {camera.name}", "none", "add it to the input"
            )


def without_sizes(rig: CameraRig) -> tuple[str, ...]:
    """Return what is lost by a format that has no image sizes."""
    return ("image sizes",) if any(0 not in camera.size for camera in rig.cameras) else ()


def without_verdict(provenance: Mapping[str, Any]) -> tuple[str, ...]:
    """Return what is lost by a format that has no place for what is said of a rig."""
    return ("the verdict on the rig",) if "verdict" in provenance else ()


def to_json(value: Any) -> bytes:
    """Return readable JSON; floats come back exactly."""
    text = json.dumps(unsigned_zeros(value), indent=1, ensure_ascii=False, allow_nan=False)
    return (text + "\n").encode()


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
