"""The cameras that a file holds: made and checked for readers, and what writers share."""

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.geometry.rotation import matrix_from_vector, nearest_rotation
from mocap_calib.io.document import need, typed
from mocap_calib.io.file import unsigned_zeros
from mocap_calib.io.provenance import read_judgement
from mocap_calib.results import ObservedPoints
from mocap_calib.types import Camera, CameraClock, CameraRig, Floats, World

# what names may be that become those of files: a pattern, and words for it
FILE_NAME = (
    r"(?!\.)[^\x00-\x1f\x7f-\x9f/\\\"\u2028\u2029\ud800-\udfff]{1,80}",
    "characters that a file name may have",
)
_IMAGE_ENDINGS = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
_LONG_DISTORTION = 12  # OpenCV's thin prism and tilt, which bundle adjustment does not have
_LARGEST_SIZE = 1e6  # pixels
_NOT_A_ROTATION = 1e-2  # real files round to three or four digits
_ROUNDED = 1e-9
_UNSEEN = 0.05  # pixels, well below what any detector resolves
_SKEWED = 1e-3  # of the focal length, wherever the principal point may be
# `[3, 3]` rotation and `[3]` translation of cam_from_world
Extrinsics = tuple[Floats, Floats]


@dataclass(frozen=True)
class CameraFile:
    """What a source holds.

    lensless: names of the cameras whose lens the file does not state.
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
    lensless: tuple[str, ...] = ()


# --- for readers


@dataclass(frozen=True, kw_only=True)
class RawCamera:
    """A camera as a file has it, of which nothing is checked yet.

    Numbers are nested lists, or a mapping of `rows`, `cols` and `data` as OpenCV and ROS write it.

    matrix: 3 x 3 numbers, row after row, or fx, fy, cx and cy.
    distortion: in OpenCV's order; empty where a file states that there is none, None where it
        states nothing.
    size: (width, height) in pixels, None or (None, None) where it is not known.
    rotation: 3 x 3 numbers, or a vector of 3, of cam_from_world. translation: 3 numbers; or centre:
        3 numbers in world coordinates. There are no extrinsics where rotation, or both of these,
        are None.
    by_columns: matrix and rotation are column after column, as they are for row vectors.
    """

    name: Any
    matrix: Any = None
    distortion: Any = None
    size: Any = None
    fisheye: bool = False
    rotation: Any = None
    translation: Any = None
    centre: Any = None
    by_columns: bool = False

    def check(self, source: str) -> tuple[Camera, Extrinsics | None]:
        """Return the camera, and its extrinsics where it has some. Raises FormatError."""
        where = f"{source}: camera {self.name}"
        size = _check_size(self.size, where)
        given = numbers(self.matrix, "a 3 x 3 camera matrix", where, 4, 9).ravel()
        if len(given) == 4:
            fx, fy, cx, cy = given
            given = np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1])
        matrix = given.reshape(3, 3)
        camera = Camera(
            name=str(self.name),
            size=size,
            matrix=_check_matrix(matrix.T if self.by_columns else matrix, size, where),
            distortion=_check_distortion(self.distortion, self.fisheye, where),
            fisheye=self.fisheye,
        )
        place = self.translation if self.centre is None else self.centre
        if self.rotation is None or place is None:
            return camera, None
        rotation = _check_rotation(self.rotation, where)
        rotation = rotation.T if self.by_columns else rotation
        offset = numbers(place, "a translation of 3 numbers", where, 3).ravel()
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

    Raises FormatError.
    """
    raws = list(found)
    placed = [raw.check(source) for raw in raws]
    return CameraFile(
        cameras=tuple(camera for camera, _ in placed),
        extrinsics={camera.name: given for camera, given in placed if given is not None},
        unit=str(unit),
        notes=tuple(notes),
        judgement=read_judgement(provenance),
        points=points or ObservedPoints.none(),
        lensless=tuple(str(raw.name) for raw in raws if raw.distortion is None),
    )


def entries(tree: Any, source: str, *keys: str) -> list[tuple[str, dict[str, Any]]]:
    """Return (name or number, fields) of a mapping or a list of mappings that have the keys.

    Raises FormatError.
    """
    named = dict(enumerate(tree)) if isinstance(tree, list) else tree
    expected = f"cameras with {', '.join(keys)}"
    found = typed(named, dict[Any, dict[str, Any]], source, expected)
    for name, fields in found.items():
        need(fields, keys, f"{source}: camera {name}")
    return [(str(name), fields) for name, fields in named.items()]  # which note what is asked for


def pick(fields: Mapping[str, Any], **keys: str | tuple[str, ...]) -> dict[str, Any]:
    """Return fields by our names: each that is under its key here, or the first of its keys."""
    found = {}
    for name, known in keys.items():
        there = [key for key in (known if isinstance(known, tuple) else (known,)) if key in fields]
        found[name] = fields[there[0]] if there else None
    return found


def camera_of_image(name: str) -> str:
    """Return the name of the camera that took an image: the image's without its ending."""
    start, dot, ending = name.rpartition(".")
    return start if start and dot + ending.lower() in _IMAGE_ENDINGS else name


# --- checks


def numbers(value: Any, expected: str, source: str, *counts: int) -> Floats:
    """Return numbers as an array `[...]`: nested lists, or a matrix as OpenCV and ROS write it.

    expected: for the refusal. counts: how many finite numbers there may be; any, and NaN too, where
    there is none.

    Raises FormatError.
    """
    try:
        is_matrix = isinstance(value, dict)
        found = np.array(value["data"] if is_matrix else value, dtype=np.float64)
        if is_matrix:
            found = found.reshape(int(value["rows"]), int(value["cols"]))
    except (ValueError, TypeError, KeyError, OverflowError) as error:
        raise FormatError(source, expected, f"an error ({error})", "correct the numbers") from None
    if counts and not (found.size in counts and np.isfinite(found).all()):
        there = "none" if value is None else found.tolist()
        raise FormatError(source, expected, there, "correct the numbers")
    return found


def skew_in_pixels(matrix: Floats, height: int = 0) -> float:
    """Return by how much the skew of a `[3, 3]` camera matrix moves what is seen at the edge.

    height: of the image; 0: not known, and the principal point is taken to be in the middle.
    """
    fy, cy = matrix[1, 1:]
    with np.errstate(all="ignore"):  # numbers of a damaged file
        farthest = max(abs(cy), abs(height - cy) if height else 0.0)
        return float(abs(matrix[0, 1]) * farthest / fy)


def _check_size(value: Any, source: str) -> tuple[int, int]:
    """Return (width, height); (0, 0) where the file does not say."""
    if value is None or (isinstance(value, list) and None in value):
        return (0, 0)
    expected = "a size [width, height] in pixels"
    size = numbers(value, expected, source, 2).ravel()
    if (size != size.round()).any() or (size < 0).any() or (size > _LARGEST_SIZE).any():
        raise FormatError(source, expected, value, "correct the size")
    return int(size[0]), int(size[1])


def _check_rotation(value: Any, source: str) -> Floats:
    """Return the `[3, 3]` rotation of a vector, or of a matrix before its numbers were rounded."""
    given = numbers(value, "a rotation (3 x 3, or a vector of 3)", source, 3, 9)
    with np.errstate(all="ignore"):  # numbers of a damaged file
        matrix = matrix_from_vector(given.ravel()) if given.size == 3 else given.reshape(3, 3)
        excess = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    if not excess <= _NOT_A_ROTATION or np.linalg.det(matrix) < 0:
        expected = "a rotation (orthonormal, determinant 1)"
        remedy = "check the axes and the order of the rows"
        raise FormatError(source, expected, "another matrix", remedy)
    return nearest_rotation(matrix) if excess > _ROUNDED else matrix


def _check_matrix(matrix: Floats, size: tuple[int, int], source: str) -> Floats:
    """Return the `[3, 3]` camera matrix; a skew that nobody sees is set to 0."""
    if (matrix[2, :2] != 0).any() or matrix[2, 2] != 1 or matrix[1, 0] != 0:
        expected = "a camera matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
        advice = "transpose it if it came from MATLAB"
        raise FormatError(source, expected, matrix.tolist(), advice)
    if min(matrix[0, 0], matrix[1, 1]) <= 0:
        found = matrix[[0, 1], [0, 1]].tolist()
        raise FormatError(source, "positive focal lengths", found, "correct the camera matrix")
    # OpenCV's pinhole model drops a skew silently, and COLMAP's fisheye model has none
    moved = skew_in_pixels(matrix, size[1])
    if moved > _UNSEEN or abs(matrix[0, 1]) > _SKEWED * matrix[0, 0]:
        found = f"skew {matrix[0, 1]:.6g}, which moves pixels by up to {moved:.2g}"
        advice = "calibrate without skew, or write 0 where that is near enough"
        raise FormatError(source, "a camera matrix without skew", found, advice)
    return matrix * [[1, 0, 1], [0, 1, 1], [0, 0, 1]]


def _check_distortion(value: Any, fisheye: bool, source: str) -> Floats:
    """Return as many coefficients as the model takes, `[4 | 5 | 8]`, or `[4]` of a fisheye.

    Missing ones are 0, and zeros too many are dropped.
    """
    given = numbers([] if value is None else value, "distortion coefficients", source).ravel()
    used = int(np.flatnonzero(given).max(initial=-1)) + 1
    count = 4 if fisheye or len(given) == 4 else 5
    if not fisheye and (len(given) == 8 or len(given) >= _LONG_DISTORTION):
        count = 8
    # k1, k2 alone are clear; three may be k1 k2 k3 or k1 k2 p1
    clear = used <= count and (fisheye or len(given) != 3 or used < 3)
    if not clear or not np.isfinite(given).all():
        model = "4 distortion coefficients of the fisheye model"
        if not fisheye:
            model = "4, 5 or 8 distortion coefficients of OpenCV's model, no thin prism, no tilt"
        raise FormatError(source, model, given.tolist(), "calibrate with one of them")
    return np.pad(given, (0, 8))[:count]


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
    verdict: bool = True,
) -> tuple[str, ...]:
    """Return what of a rig a format does not hold, in words that follow "does not hold".

    name: of the format. terms: how many distortion coefficients it has. fisheye: whether it has
    cv2.fisheye's model. sizes: what it does with image sizes. names: the pattern of the names of
    cameras, and words for it. verdict: whether it holds the verdict.

    Raises MismatchError where the format cannot hold the rig.
    """
    need_names(rig.names, *names, name)
    for camera in rig.cameras:
        if sizes == "needed" and 0 in camera.size:
            expected = f"the image size of camera {camera.name}"
            raise MismatchError(name, expected, "none", "add it to the input")
        if camera.fisheye and not fisheye:
            raise cannot(name, camera.name, "a pinhole camera", "a fisheye camera")
        if not camera.fisheye and camera.distortion[terms:].any():
            expected = (
                f"{terms} distortion coefficients" if terms else "a camera without distortion"
            )
            raise cannot(name, camera.name, expected, camera.distortion.tolist())
    known = any(0 not in camera.size for camera in rig.cameras)
    lost = ("image sizes",) if sizes == "lost" and known else ()
    return lost if verdict or "verdict" not in provenance else (*lost, "the verdict on the rig")


def cannot(name: str, camera: str, expected: str, found: object) -> MismatchError:
    """Return the refusal of a format (`name`) that does not have what the camera has."""
    where, expected = f"{name}: camera {camera}", f"{expected}, which is all the format has"
    return MismatchError(where, expected, found, "write another format")


def lens_terms(camera: Camera, count: int) -> Floats:
    """Return k1 k2 p1 p2 (k3 (k4 k5 k6)), or the four of a fisheye: `[count]`, with zeros."""
    return np.pad(camera.distortion, (0, 8))[:count]


def pinhole_terms(camera: Camera) -> list[float]:
    """Return fx, fy, cx and cy."""
    return camera.matrix[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()


def need_names(
    cameras: Iterable[str],
    pattern: str,
    words: str,
    owner: str,
) -> None:
    """Raise MismatchError where a camera's name does not match the pattern.

    words: describe the pattern.
    """
    for camera in cameras:
        if not re.fullmatch(pattern, camera):
            raise MismatchError(
                owner, f"camera names of {words}", f"{camera!r}", "rename the camera"
            )


def to_json(value: Any) -> bytes:
    """Return readable JSON; floats come back exactly."""
    text = json.dumps(unsigned_zeros(value), indent=1, ensure_ascii=False, allow_nan=False)
    return (text + "\n").encode()
