"""YAML of one camera a file: what people write with cv2.FileStorage, and ROS' camera_info.

* OpenCV fixes no names of fields, so that each has several that are in use.
* The file's name names the camera, unless `camera_name` does.
* Matrices are those of FileStorage (rows, cols, data), or nine numbers as ROS lists them.
* R and P of camera_info say how to rectify images, not where the camera stands: it has no
  extrinsics.
* There is no unit of length; a field `unit` says ours.
"""

import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.camera_checks import describe_keys, make_camera, make_extrinsics
from mocap_calib.io.cameras import FILE_NAME, CameraFile, Extrinsics, need_names
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format, Written
from mocap_calib.types import Camera, CameraRig, Floats

_MATRIX = ("camera_matrix", "K", "M1", "intrinsic_matrix", "k")
_DISTORTION = ("distortion_coefficients", "dist_coeffs", "distCoeffs", "dist_coeff", "D", "D1", "d")
_ROTATION = ("rvec", "R", "rotation", "rotation_matrix", "rotation_vector")
_TRANSLATION = ("tvec", "T", "t", "translation", "translation_vector")
_WIDTH = ("image_width", "width")
_HEIGHT = ("image_height", "height")
_FISHEYE_MODELS = ("equidistant", "fisheye")
_PINHOLE_MODELS = ("", "plumb_bob", "rational_polynomial", "opencv", "pinhole", "radtan", "none")
_FILE_STORAGE_MATRIX = "!!opencv-matrix"
_OPENCV = rf"\A\s*%YAML|{_FILE_STORAGE_MATRIX}|^(camera_matrix|K|M1)\s*:"
_CAMERA_INFO = r"^distortion_model\s*:"


def sniff_ros(document: Document) -> bool:
    """Return whether this is a camera_info file, or what `rostopic echo` prints of the topic."""
    if document.syntax != "yaml" or _FILE_STORAGE_MATRIX in document.text:
        return False
    return re.search(_CAMERA_INFO, document.text, re.M) is not None


def sniff(document: Document) -> bool:
    """Return whether FileStorage's header or matrices, or the name of a matrix, are there."""
    return document.syntax == "yaml" and re.search(_OPENCV, document.text, re.M) is not None


# --- reading


def parse_ros(document: Document) -> CameraFile:
    """Read the intrinsics of a camera_info. Raises FormatError."""
    data = document.mapping()
    camera = _parse_camera(data, document)
    return CameraFile((camera,), {}, str(data.get("unit", "")))


def parse(document: Document) -> CameraFile:
    """Read one camera, under any of the names that people give to its fields.

    Raises FormatError.
    """
    data = document.mapping()
    camera = _parse_camera(data, document)
    extrinsics = _parse_extrinsics(data, document.source)
    placed = {} if extrinsics is None else {camera.name: extrinsics}
    return CameraFile((camera,), placed, str(data.get("unit", "")))


def _parse_camera(data: Mapping[str, Any], document: Document) -> Camera:
    """Return the camera without its place. Raises FormatError."""
    matrix = _first(data, _MATRIX)
    if matrix is None or "M2" in data:
        expected = f"one camera with its matrix under {', '.join(_MATRIX)}"
        found = "a stereo pair (M1, M2)" if "M2" in data else describe_keys(data)
        raise FormatError(document.source, expected, found, "give one file per camera")
    if isinstance(matrix, list) and len(matrix) == 9:
        matrix = {"rows": 3, "cols": 3, "data": matrix}
    model = str(data.get("distortion_model", data.get("model", ""))).lower()
    if model not in (*_FISHEYE_MODELS, *_PINHOLE_MODELS):
        expected = "the distortion model plumb_bob, rational_polynomial or equidistant"
        raise FormatError(document.source, expected, model, "calibrate with one of them")
    width, height = _first(data, _WIDTH), _first(data, _HEIGHT)
    return make_camera(
        name=str(data.get("camera_name") or document.stem),
        size=None if width is None or height is None else [width, height],
        matrix=matrix,
        distortion=_first(data, _DISTORTION),
        fisheye=model in _FISHEYE_MODELS or data.get("fisheye") in (True, 1),
        source=document.source,
    )


def _parse_extrinsics(data: Mapping[str, Any], source: str) -> Extrinsics | None:
    """Return the extrinsics, None where there are none. Raises FormatError."""
    rotation, translation = _first(data, _ROTATION), _first(data, _TRANSLATION)
    if rotation is None or translation is None:
        return None
    return make_extrinsics(rotation, translation, source)


def _first(data: Mapping[str, Any], keys: tuple[str, ...]) -> Any:
    """Return the field under the first of the keys that is there, None where none is."""
    return next((data[key] for key in keys if key in data), None)


# --- writing


def write(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write a file for each camera, which cv2.FileStorage reads and which carries all.

    Raises MismatchError.
    """
    need_names(rig.names, *FILE_NAME, "opencv")
    files = {}
    for view, camera in enumerate(rig.cameras):
        lines = _format_camera(camera)
        lines += _format_extrinsics(rig.rotation[view], rig.translation[view])
        lines.append(f'unit: "{rig.unit}"')
        files[f"{camera.name}.yml"] = format_file(lines)
    return Written(files)


def _format_camera(camera: Camera) -> list[str]:
    """Return the lines of the intrinsics."""
    width, height = camera.size
    return [
        f'camera_name: "{camera.name}"',
        f"image_width: {width}",
        f"image_height: {height}",
        *format_matrix("camera_matrix", camera.matrix),
        f'distortion_model: "{_model(camera)}"',
        *format_matrix("distortion_coefficients", camera.distortion[None]),
    ]


def _format_extrinsics(rotation: Floats, translation: Floats) -> list[str]:
    """Return the lines of the `[3, 3]` rotation and the `[3]` translation of cam_from_world."""
    return [*format_matrix("R", rotation), *format_matrix("T", translation[:, None])]


def _model(camera: Camera) -> str:
    """Return the camera's distortion model in the words of ROS."""
    if camera.fisheye:
        return "equidistant"
    return "rational_polynomial" if len(camera.distortion) > 5 else "plumb_bob"


_KEY = r"[A-Za-z_][\w-]*"  # what FileStorage takes for a key


def format_file(lines: Iterable[str]) -> bytes:
    """Return a file of these lines below the header of FileStorage."""
    return "\n".join(["%YAML:1.0", "---", *lines, ""]).encode()


def format_matrix(key: str, matrix: Floats) -> list[str]:
    """Return the lines of a `[row, column]` matrix; every float comes back exactly."""
    assert re.fullmatch(_KEY, key)
    rows, columns = matrix.shape
    data = ", ".join(_format_number(float(value)) for value in np.ravel(matrix))
    return [
        f"{key}: !!opencv-matrix",
        f"   rows: {rows}",
        f"   cols: {columns}",
        "   dt: d",
        f"   data: [ {data} ]",
    ]


def _format_number(value: float) -> str:
    """Return a number with a point, without which YAML 1.1 takes `1e-05` for text."""
    text = repr(value + 0.0)  # which takes the sign from a zero
    if "." in text:
        return text
    return text.replace("e", ".0e") if "e" in text else f"{text}."


ROS = Format(
    kind="cameras",
    name="ros",
    title="ROS camera_info",
    sniff=sniff_ros,
    read=parse_ros,
)
OPENCV = Format(
    kind="cameras",
    name="opencv",
    title="OpenCV YAML",
    sniff=sniff,
    read=parse,
    write=write,
    folder=True,
)
