"""The cameras that a file holds: made and checked for readers, and what writers share."""

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar

import numpy as np

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.io.camera_checks import make_camera, make_extrinsics
from mocap_calib.io.document import Document, typed
from mocap_calib.io.file import find_repeated
from mocap_calib.io.provenance import read_judgement
from mocap_calib.io.zeros import unsigned_zeros
from mocap_calib.results import ObservedPoints
from mocap_calib.types import Camera, CameraClock, CameraRig, Floats, World

REMEDY = "export the cameras again"
# what names may be that become those of files: a pattern, and words for it
FILE_NAME = (
    r"(?!\.)[^\x00-\x1f\x7f-\x9f/\\\"\u2028\u2029\ud800-\udfff]{1,80}",
    "characters that a file name may have",
)
_IMAGE_ENDINGS = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
# `[3, 3]` rotation and `[3]` translation of cam_from_world
Extrinsics = tuple[Floats, Floats]
T = TypeVar("T")


@dataclass(frozen=True)
class CameraFile:
    """What a source holds.

    extrinsics: camera name -> `[3, 3]` rotation and `[3]` translation of cam_from_world, for the
        cameras that have them.
    unit: of the lengths, "" where the file does not state it.
    notes: what a user should know of what was left out.
    judgement: how far the cameras can be trusted, as `provenance.judgement` has it, where the file
        states it.
    points: that the cameras see, in their order; none in most formats.
    clocks: of the cameras whose frames are not numbered by the clock of the others.
    world: what the axes are, where the file states it.
    """

    cameras: tuple[Camera, ...]
    extrinsics: Mapping[str, Extrinsics]
    unit: str = ""
    notes: tuple[str, ...] = ()
    judgement: Mapping[str, Any] = field(default_factory=dict)
    points: ObservedPoints = field(default_factory=ObservedPoints.none)
    clocks: tuple[CameraClock, ...] = ()
    world: World = field(default_factory=World)


# --- for readers


@dataclass(frozen=True, kw_only=True)
class RawCamera:
    """A camera as a file has it, of which nothing is checked yet.

    matrix: `[3, 3]`, or `[9]`. distortion: `[coefficient]` in OpenCV's order.
    size: (width, height) in pixels, None where it is not known.
    rotation: `[3, 3]` or a vector `[3]`, of cam_from_world. translation: `[3]`; or centre: `[3]`
        in world coordinates. There are no extrinsics where rotation, or both of these, are None.
    """

    name: str
    matrix: Any
    distortion: Any = None
    size: Any = None
    fisheye: bool = False
    rotation: Any = None
    translation: Any = None
    centre: Any = None

    def check(self, source: str) -> tuple[Camera, Extrinsics | None]:
        """Return the camera, and its extrinsics where it has some. Raises FormatError."""
        where = f"{source}: camera {self.name}"
        camera = make_camera(
            name=self.name,
            size=self.size,
            matrix=self.matrix,
            distortion=self.distortion,
            fisheye=self.fisheye,
            source=where,
        )
        offset = self.translation if self.centre is None else self.centre
        if self.rotation is None or offset is None:
            return camera, None
        rotation, offset = make_extrinsics(self.rotation, offset, where)
        return camera, (rotation, offset if self.centre is None else -rotation @ offset)


def collect_cameras(
    found: Iterable[RawCamera],
    source: str,
    *,
    unit: Any = "",
    notes: Iterable[str] = (),
    provenance: Any = None,
    points: ObservedPoints | None = None,
) -> CameraFile:
    """Return the cameras of a file, checked; the other arguments are what the file has beside them.

    Raises FormatError, also where there is no camera, or two have one name.
    """
    placed = [raw.check(source) for raw in found]
    return CameraFile(
        cameras=unique((camera for camera, _ in placed), source),
        extrinsics={camera.name: given for camera, given in placed if given is not None},
        unit=str(unit),
        notes=tuple(notes),
        judgement=read_judgement(provenance),
        points=points or ObservedPoints.none(),
    )


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
        raise FormatError(source, "at least one camera", "none", REMEDY)
    return kept


def entries(kind: type[T], tree: Any, source: str, expected: str) -> list[tuple[str, T]]:
    """Return (name or number, record) of a mapping or a list of mappings. Raises FormatError.

    expected: what they are, for the complaint.
    """
    named = dict(enumerate(tree)) if isinstance(tree, list) else tree
    found = typed(named, dict[Any, kind], source, expected)  # type: ignore[valid-type]
    if not found:
        raise FormatError(source, expected, "none", REMEDY)
    return [(str(name), record) for name, record in found.items()]


def pinhole_matrix(fx: Any, fy: Any, cx: Any, cy: Any) -> list[list[Any]]:
    """Return the `[3, 3]` camera matrix of these numbers, as nested lists."""
    return [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]


def has_json_entry(document: Document, *keys: str) -> bool:
    """Return whether a JSON mapping has an entry with the keys, at its top or in a list there."""
    if document.syntax != "json" or not isinstance(document.tree, dict):
        return False
    lists = (each if isinstance(each, list) else [each] for each in document.tree.values())
    return any(isinstance(each, dict) and each.keys() >= set(keys) for one in lists for each in one)


def camera_of_image(name: str) -> str:
    """Return the name of the camera that took an image: the image's without its ending."""
    start, dot, ending = name.rpartition(".")
    return start if start and dot + ending.lower() in _IMAGE_ENDINGS else name


# --- for writers


def check_rig(
    rig: CameraRig,
    provenance: Mapping[str, Any],
    name: str,
    *,
    terms: int = 8,
    fisheye: bool = False,
    sizes: Literal["needed", "held", "lost"] = "held",
    names: tuple[str, str] = (r"(?s:.*)", ""),
    remedy: str = "rename the camera",
    verdict: bool = True,
) -> tuple[str, ...]:
    """Return what of a rig a format does not hold, in words that follow "does not hold".

    name: of the format. terms: how many distortion coefficients it has. fisheye: whether it has
    cv2.fisheye's model. sizes: what it does with image sizes. names: the pattern of the names of
    cameras, and words for it; remedy: for other names. verdict: whether it holds the verdict.

    Raises MismatchError where the format cannot hold the rig.
    """
    need_names(rig.names, *names, name, remedy)
    for camera in rig.cameras:
        if sizes == "needed" and 0 in camera.size:
            expected = f"the image size of camera {camera.name}"
            raise MismatchError(name, expected, "none", "add it to the input")
        if camera.fisheye and not fisheye:
            raise cannot(name, camera.name, "a pinhole camera", "a fisheye camera")
        if not camera.fisheye and camera.distortion[terms:].any():
            found = f"{camera.distortion.tolist()}"
            if not terms:
                expected, advice = "a camera without distortion", "undistort the images first"
                raise cannot(name, camera.name, expected, found, advice)
            expected = f"{terms} distortion coefficients"
            raise cannot(name, camera.name, expected, f"more ({found})")
    known = any(0 not in camera.size for camera in rig.cameras)
    lost = ("image sizes",) if sizes == "lost" and known else ()
    return lost if verdict or "verdict" not in provenance else (*lost, "the verdict on the rig")


def cannot(
    name: str, camera: str, expected: str, found: object, remedy: str = "write another format"
) -> MismatchError:
    """Return the complaint of a format (`name`) that does not have what the camera has."""
    expected = f"{expected}, which is all the format has"
    return MismatchError(f"{name}: camera {camera}", expected, found, remedy)


def lens_terms(camera: Camera, count: int) -> list[float]:
    """Return k1 k2 p1 p2 (k3 (k4 k5 k6)), or the four of a fisheye: `count`, padded with zeros."""
    return np.pad(camera.distortion, (0, 8))[:count].tolist()


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


def to_json(value: Any) -> bytes:
    """Return readable JSON; floats come back exactly."""
    text = json.dumps(unsigned_zeros(value), indent=1, ensure_ascii=False, allow_nan=False)
    return (text + "\n").encode()
