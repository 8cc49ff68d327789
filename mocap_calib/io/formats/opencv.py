"""YAML of matrices: what people write with cv2.FileStorage (also EasyMocap, JARVIS), ROS, Kalibr.

* OpenCV fixes no names of fields, so that each has several that are in use. Matrices are those of
  FileStorage (rows, cols, data), or nine numbers as ROS lists them. A file has one camera, named by
  `camera_name` or the file's name. There is no unit of length; a field `unit` states ours.
* ROS' camera_info: R and P rectify images and are not the pose of the camera; it has no extrinsics.
* EasyMocap: a folder of intri.yml and extri.yml. Both list the cameras under `names`; the name of a
  camera is part of the keys of its fields (K_01, dist_01, Rot_01, ...), so that names are what
  FileStorage takes for keys. R_01 is a rotation vector, Rot_01 the same rotation as a matrix.
  Lengths are metres. intri.yml often has more cameras than extri.yml: these have no extrinsics.
* JARVIS: a file for each camera, which the file's name names. intrinsicMatrix and R are those of
  row vectors, x = [X 1] [R; T] K: the transpose of ours. JARVIS itself uses k1 and k2 alone.
  Lengths are millimetres; there are no image sizes.
* Kalibr's camchain: the cameras cam0, cam1, ... of a chain. The transform T_cn_cnm1 of a camera is
  from the camera before it, so that transforms are multiplied along the chain; cam0 is the world.
  Where a link is missing, the cameras behind it have no extrinsics. Read only.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Literal

import msgspec
import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.geometry.rotation import vector_from_matrix
from mocap_calib.io.camera_checks import describe_keys, make_extrinsics, numbers
from mocap_calib.io.cameras import (
    FILE_NAME,
    CameraFile,
    RawCamera,
    check_rig,
    collect_cameras,
    entries,
    lens_terms,
    pinhole_matrix,
)
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
_KEY = r"[A-Za-z_][\w-]*"  # what FileStorage takes for a key
_INTRINSICS = "intri.yml"
_EXTRINSICS = "extri.yml"


# --- OpenCV and ROS


def sniff_ros(document: Document) -> bool:
    """Return whether this is a camera_info file, or what `rostopic echo` prints of the topic."""
    return _has_line(document, r"^distortion_model\s*:") and (
        _FILE_STORAGE_MATRIX not in document.text
    )


def sniff_opencv(document: Document) -> bool:
    """Return whether FileStorage's header or matrices, or the name of a matrix, are there."""
    return _has_line(document, _OPENCV)


def _has_line(document: Document, pattern: str) -> bool:
    """Return whether the document is YAML with a line that the pattern finds."""
    return document.syntax == "yaml" and re.search(pattern, document.text, re.M) is not None


def read_ros(document: Document) -> CameraFile:
    """Read the intrinsics of a camera_info. Raises FormatError."""
    return _read_camera(document, (), ())


def read_opencv(document: Document) -> CameraFile:
    """Read one camera, under any of the names that people give to its fields.

    Raises FormatError.
    """
    return _read_camera(document, _ROTATION, _TRANSLATION)


def _read_camera(
    document: Document, rotation: tuple[str, ...], translation: tuple[str, ...]
) -> CameraFile:
    """Read one camera, its extrinsics under one of these keys. Raises FormatError."""
    data = document.mapping()
    matrix = _first(data, _MATRIX)
    if matrix is None or "M2" in data:
        expected = f"one camera with its matrix under {', '.join(_MATRIX)}"
        found = "a stereo pair (M1, M2)" if "M2" in data else describe_keys(data)
        raise document.refuse(expected, found, "give one file per camera")
    model = str(data.get("distortion_model", data.get("model", ""))).lower()
    if model not in (*_FISHEYE_MODELS, *_PINHOLE_MODELS):
        expected = "the distortion model plumb_bob, rational_polynomial or equidistant"
        raise document.refuse(expected, model, "calibrate with one of them")
    width, height = _first(data, _WIDTH), _first(data, _HEIGHT)
    raw = RawCamera(
        name=str(data.get("camera_name") or document.stem),
        size=None if width is None or height is None else [width, height],
        matrix=matrix,
        distortion=_first(data, _DISTORTION),
        fisheye=model in _FISHEYE_MODELS or data.get("fisheye") in (True, 1),
        rotation=_first(data, rotation),
        translation=_first(data, translation),
    )
    return collect_cameras([raw], document.source, unit=data.get("unit", ""))


def _first(data: Mapping[str, Any], keys: tuple[str, ...]) -> Any:
    """Return the field under the first of the keys that is there, None where none is."""
    return next((data[key] for key in keys if key in data), None)


def write_opencv(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write a file for each camera, which cv2.FileStorage reads and which carries all.

    Raises MismatchError.
    """
    lost = check_rig(rig, provenance, "opencv", fisheye=True, names=FILE_NAME)
    files = {}
    for view, camera in enumerate(rig.cameras):
        width, height = camera.size
        lines = [
            f'camera_name: "{camera.name}"',
            f"image_width: {width}",
            f"image_height: {height}",
            *_format_matrix("camera_matrix", camera.matrix),
            f'distortion_model: "{_model(camera)}"',
            *_format_matrix("distortion_coefficients", camera.distortion[None]),
            *_format_matrix("R", rig.rotation[view]),
            *_format_matrix("T", rig.translation[view][:, None]),
            f'unit: "{rig.unit}"',
        ]
        files[f"{camera.name}.yml"] = _format_file(lines)
    return Written(files, lost)


def _model(camera: Camera) -> str:
    """Return the camera's distortion model in the words of ROS."""
    if camera.fisheye:
        return "equidistant"
    return "rational_polynomial" if len(camera.distortion) > 5 else "plumb_bob"


def _format_file(lines: Iterable[str]) -> bytes:
    """Return a file of these lines below the header of FileStorage."""
    return "\n".join(["%YAML:1.0", "---", *lines, ""]).encode()


def _format_matrix(key: str, matrix: Floats) -> list[str]:
    """Return the lines of a `[row, column]` matrix; every float comes back exactly."""
    assert re.fullmatch(_KEY, key)
    rows, columns = matrix.shape
    data = ", ".join(_format_number(float(value)) for value in np.ravel(matrix))
    shape = [f"   rows: {rows}", f"   cols: {columns}", "   dt: d"]
    return [f"{key}: {_FILE_STORAGE_MATRIX}", *shape, f"   data: [ {data} ]"]


def _format_number(value: float) -> str:
    """Return a number with a point, without which YAML 1.1 takes `1e-05` for text."""
    text = repr(value + 0.0)  # which takes the sign from a zero
    if "." in text:
        return text
    return text.replace("e", ".0e") if "e" in text else f"{text}."


# --- EasyMocap


def sniff_easymocap(document: Document) -> bool:
    """Return whether this is a folder with intri.yml, or one of the two with its list of names."""
    if document.is_folder:
        return _INTRINSICS in document.names
    return _has_line(document, r"^names\s*:")


def read_easymocap(document: Document) -> CameraFile:
    """Read the cameras of both files, or of intri.yml alone. Raises FormatError."""
    intrinsics = document.of(_INTRINSICS) if document.is_folder else document
    fields = intrinsics.mapping("names")
    names = fields["names"]
    if not isinstance(names, list):
        raise intrinsics.refuse("a list of names", type(names).__name__)
    places = document.of(_EXTRINSICS).mapping() if _EXTRINSICS in document.names else {}
    raws = [_easymocap_camera(str(name), fields, places, intrinsics) for name in names]
    return collect_cameras(raws, document.source, unit=fields.get("unit", ""))


def _easymocap_camera(
    name: str, fields: Mapping[str, Any], places: Mapping[str, Any], document: Document
) -> RawCamera:
    """Return the camera of that name. Raises FormatError."""
    if f"K_{name}" not in fields:
        remedy = "correct the list"
        if any(str(key).startswith("R_") for key in fields):
            remedy = f"give a folder in which it is called {_EXTRINSICS}, beside its {_INTRINSICS}"
        raise document.refuse(f"the matrix K_{name} of the camera {name} in names", "none", remedy)
    size = [fields.get(f"W_{name}"), fields.get(f"H_{name}")]
    return RawCamera(
        name=name,
        size=None if None in size else size,
        matrix=fields[f"K_{name}"],
        distortion=_first(fields, (f"dist_{name}", f"D_{name}")),
        rotation=_first(places, (f"Rot_{name}", f"R_{name}")),
        translation=places.get(f"T_{name}"),
    )


def write_easymocap(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write both files. Raises MismatchError."""
    words = (r"[A-Za-z0-9_-]{1,80}", "letters, digits, - and _")
    lost = check_rig(rig, provenance, "easymocap", terms=5, names=words)
    intrinsics = ["names:", *(f'  - "{name}"' for name in rig.names)]
    extrinsics = list(intrinsics)
    for camera, rotation, translation in zip(
        rig.cameras, rig.rotation, rig.translation, strict=True
    ):
        name, distortion = camera.name, np.array([lens_terms(camera, 5)])
        intrinsics += _format_matrix(f"K_{name}", camera.matrix)
        intrinsics += _format_matrix(f"dist_{name}", distortion)
        if 0 not in camera.size:
            width, height = camera.size
            intrinsics += [f"H_{name}: {height}", f"W_{name}: {width}"]
        extrinsics += _format_matrix(f"R_{name}", vector_from_matrix(rotation)[:, None])
        extrinsics += _format_matrix(f"Rot_{name}", rotation)
        extrinsics += _format_matrix(f"T_{name}", translation[:, None])
    files = {_INTRINSICS: _format_file(intrinsics), _EXTRINSICS: _format_file(extrinsics)}
    return Written(files, lost)


# --- JARVIS


def sniff_jarvis(document: Document) -> bool:
    """Return whether the camera matrix has the name that JARVIS gives it."""
    return _has_line(document, r"^intrinsicMatrix\s*:")


def read_jarvis(document: Document) -> CameraFile:
    """Read the camera. Raises FormatError."""
    data = document.mapping("intrinsicMatrix")
    rotation = data.get("R")
    if rotation is not None:
        rotation = numbers(rotation, "a 3 x 3 rotation R", document.source).T
    raw = RawCamera(
        name=document.stem,
        matrix=numbers(data["intrinsicMatrix"], "a 3 x 3 intrinsicMatrix", document.source).T,
        distortion=data.get("distortionCoefficients"),
        rotation=rotation,
        translation=data.get("T"),
    )
    return collect_cameras([raw], document.source, unit=data.get("unit", ""))


def write_jarvis(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write a file for each camera. Raises MismatchError."""
    lost = check_rig(rig, provenance, "jarvis", terms=5, sizes="lost", names=FILE_NAME)
    files = {}
    for view, camera in enumerate(rig.cameras):
        lines = [
            *_format_matrix("intrinsicMatrix", camera.matrix.T),
            *_format_matrix("distortionCoefficients", np.array([lens_terms(camera, 5)])),
            *_format_matrix("R", rig.rotation[view].T),
            *_format_matrix("T", rig.translation[view][:, None]),
        ]
        files[f"{camera.name}.yaml"] = _format_file(lines)
    more = ", ".join(camera.name for camera in rig.cameras if camera.distortion[2:].any())
    if more:
        unused = f"the tangential terms and k3 of {more}, to JARVIS itself: it uses k1 and k2"
        lost = (*lost, unused)
    return Written(files, lost)


# --- Kalibr


class _KalibrCamera(msgspec.Struct):
    camera_model: Literal["pinhole"]
    intrinsics: tuple[float, float, float, float]
    distortion_model: Literal["radtan", "equidistant", "none"]
    distortion_coeffs: Any
    resolution: Any
    T_cn_cnm1: Any = None


def sniff_kalibr(document: Document) -> bool:
    """Return whether this is YAML of cameras, all with intrinsics."""
    if document.syntax != "yaml" or "intrinsics" not in document.text:
        return False
    if not isinstance(document.tree, dict) or not document.tree:
        return False
    cameras = document.tree.values()
    return all(isinstance(fields, dict) and "intrinsics" in fields for fields in cameras)


def read_kalibr(document: Document) -> CameraFile:
    """Read the cameras in the order of the chain. Raises FormatError."""
    expected = "cameras cam0, cam1, ... of the models pinhole and radtan, equidistant or none"
    found = entries(_KalibrCamera, document.tree, document.source, expected)
    found.sort(key=lambda camera: (len(camera[0]), camera[0]))  # cam2 before cam10
    return collect_cameras(_follow_chain(found, document), document.source)


def _follow_chain(
    found: list[tuple[str, _KalibrCamera]], document: Document
) -> Iterator[RawCamera]:
    """Yield the cameras of a chain. Raises FormatError."""
    from_world: Floats | None = None
    for k, (name, camera) in enumerate(found):
        if k == 0:
            from_world = np.eye(4)
        elif camera.T_cn_cnm1 is None or from_world is None:
            from_world = None
        else:
            from_world = _transform(camera.T_cn_cnm1, f"{document.source}: camera {name}") @ (
                from_world
            )
        yield RawCamera(
            name=name,
            size=camera.resolution,
            matrix=pinhole_matrix(*camera.intrinsics),
            distortion=camera.distortion_coeffs,
            fisheye=camera.distortion_model == "equidistant",
            rotation=None if from_world is None else from_world[:3, :3],
            translation=None if from_world is None else from_world[:3, 3],
        )


def _transform(value: Any, where: str) -> Floats:
    """Return a `[4, 4]` transform of a rotation and a translation. Raises FormatError."""
    step = numbers(value, "a 4 x 4 transform T_cn_cnm1", where)
    if step.shape != (4, 4) or not np.isfinite(step).all():
        expected = "a finite 4 x 4 transform T_cn_cnm1"
        raise FormatError(where, expected, f"shape {step.shape}", "correct it")
    make_extrinsics(step[:3, :3], step[:3, 3], where)  # which refuses what is no rotation
    return step


JARVIS = Format(
    kind="cameras",
    name="jarvis",
    title="JARVIS YAML",
    sniff=sniff_jarvis,
    read=read_jarvis,
    write=write_jarvis,
    unit="mm",
    folder=True,
)
EASYMOCAP = Format(
    kind="cameras",
    name="easymocap",
    title="EasyMocap intri.yml and extri.yml",
    sniff=sniff_easymocap,
    read=read_easymocap,
    write=write_easymocap,
    unit="m",
    folder=True,
)
KALIBR = Format(
    kind="cameras",
    name="kalibr",
    title="Kalibr camchain",
    sniff=sniff_kalibr,
    read=read_kalibr,
    unit="m",
)
ROS = Format(
    kind="cameras",
    name="ros",
    title="ROS camera_info",
    sniff=sniff_ros,
    read=read_ros,
)
OPENCV = Format(
    kind="cameras",
    name="opencv",
    title="OpenCV YAML",
    sniff=sniff_opencv,
    read=read_opencv,
    write=write_opencv,
    folder=True,
)
