"""YAML of matrices: what people write with cv2.FileStorage (also EasyMocap, JARVIS), ROS, Kalibr.

* OpenCV fixes no names of fields, so that each has several that are in use (`camera_fields`).
  Its own calibration program states a fisheye by `fisheye_model: 1`. Matrices are those of
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

import json
import re
from collections.abc import Mapping
from functools import partial
from typing import Any, Literal

import msgspec
import numpy as np

from mocap_calib.geometry.rotation import vector_from_matrix
from mocap_calib.io.camera_fields import camera_fields, has_matrix
from mocap_calib.io.cameras import (
    FILE_NAME,
    CameraFile,
    RawCamera,
    check_rig,
    collect_cameras,
    lens_terms,
    numbers,
    pick,
)
from mocap_calib.io.document import Document, describe_names, need, typed
from mocap_calib.io.format import Format, Written
from mocap_calib.types import Camera, CameraRig, Floats

# what OpenCV's calibration program and scripts say of how they calibrated
_OF_CALIBRATION = (
    *("nframes", "nr_of_frames", "board_width", "board_height", "square_size", "marker_size"),
    *("flags", "aspectRatio", "avg_reprojection_error", "per_view_reprojection_errors"),
    *("extrinsic_parameters", "image_points", "grid_points", "rms", "reprojection_error"),
)
_INTRINSICS, _EXTRINSICS = "intri.yml", "extri.yml"


# --- OpenCV and ROS


def sniff_opencv(document: Document) -> bool:
    """Return whether this is what FileStorage writes, or has a camera matrix among its fields."""
    if document.syntax == "json":
        return has_matrix(document.tree)
    if document.has_line(r"\A\s*%YAML|!!opencv-matrix"):
        return True
    lines = re.findall(r"^([\w -]+):", document.text, re.M) if document.has_line("") else ()
    return has_matrix(dict.fromkeys(lines))


def read_ros(document: Document) -> CameraFile:
    """Read the intrinsics of a camera_info. Raises FormatError."""
    return _read_camera(document, rotation=None, translation=None)


def read_opencv(document: Document) -> CameraFile:
    """Read one camera, under any of the names that people give to its fields.

    Raises FormatError.
    """
    return _read_camera(document)


def _read_camera(document: Document, **known: Any) -> CameraFile:
    """Read one camera; the others are arguments of its `RawCamera`. Raises FormatError."""
    data = document.mapping()
    found = camera_fields(data, document.source) | known
    if found["matrix"] is None or "M2" in data:
        expected = "one camera with its matrix under camera_matrix, K, M1 or the like"
        there = "a stereo pair (M1, M2)" if "M2" in data else describe_names(data)
        raise document.refuse(expected, there, "give one file per camera")
    raw = RawCamera(name=data.get("camera_name") or document.stem, **found)
    return collect_cameras([raw], document.source, unit=data.get("unit", ""))


def write_opencv(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write a file for each camera, which cv2.FileStorage reads and which carries all.

    Raises MismatchError.
    """
    lost = check_rig(rig, provenance, "opencv", fisheye=True, names=FILE_NAME)
    files = {
        f"{camera.name}.yml": _format_file(
            {
                "camera_name": camera.name,
                **dict(zip(("image_width", "image_height"), camera.size, strict=True)),
                "camera_matrix": camera.matrix,
                "distortion_model": _model(camera),
                "distortion_coefficients": camera.distortion[None],
                "R": camera.rotation,
                "T": camera.translation[:, None],
                "unit": rig.unit,
            }
        )
        for camera in rig
    }
    return Written(files, lost)


def _model(camera: Camera) -> str:
    """Return the camera's distortion model in the words of ROS."""
    if camera.fisheye:
        return "equidistant"
    return "rational_polynomial" if len(camera.distortion) > 5 else "plumb_bob"


def _format_file(fields: Mapping[str, str | int | list[str] | Floats]) -> bytes:
    """Return a file of FileStorage with texts, numbers, lists of texts, and matrices.

    Every float comes back exactly.
    """
    lines = ["%YAML:1.0", "---"]
    for key, value in fields.items():
        if isinstance(value, np.ndarray):
            rows, columns = value.shape
            data = ", ".join(map(_format_number, value.ravel().tolist()))
            lines += [f"{key}: !!opencv-matrix", f"   rows: {rows}", f"   cols: {columns}"]
            lines += ["   dt: d", f"   data: [ {data} ]"]
        elif isinstance(value, list):
            lines += [f"{key}:", *(f'  - "{each}"' for each in value)]
        else:
            lines.append(f"{key}: {json.dumps(value, ensure_ascii=False)}")
    return "\n".join([*lines, ""]).encode()


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
    return document.has_line(r"^names\s*:")


def read_easymocap(document: Document) -> CameraFile:
    """Read the cameras of both files, or of intri.yml alone. Raises FormatError."""
    intrinsics = document.of(_INTRINSICS) if document.is_folder else document
    fields = intrinsics.mapping("names")
    names = typed(fields["names"], list[str], intrinsics.source, "a list of names")
    need(fields, [f"K_{name}" for name in names], intrinsics.source)
    intrinsics.account.asked |= {f"R_{name}" for name in names}  # as Rot_ has it
    places = document.of(_EXTRINSICS).mapping() if _EXTRINSICS in document.names else {}
    raws = [
        RawCamera(
            name=name,
            **camera_fields(fields, intrinsics.source, end=f"_{name}")
            | pick(places, rotation=(f"Rot_{name}", f"R_{name}"), translation=f"T_{name}"),
        )
        for name in names
    ]
    return collect_cameras(raws, document.source, unit=fields.get("unit", ""))


def write_easymocap(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write both files. Raises MismatchError."""
    words = (r"[A-Za-z0-9_-]{1,80}", "letters, digits, - and _")  # that FileStorage takes for keys
    lost = check_rig(rig, provenance, "easymocap", terms=5, names=words)
    intrinsics: dict[str, Any] = {"names": list(rig.names)}
    extrinsics: dict[str, Any] = {"names": list(rig.names)}
    for camera in rig:
        name, (width, height) = camera.name, camera.size
        intrinsics |= {f"K_{name}": camera.matrix, f"dist_{name}": lens_terms(camera, 5)[None]}
        intrinsics |= {f"H_{name}": height, f"W_{name}": width} if 0 not in camera.size else {}
        extrinsics |= {
            f"R_{name}": vector_from_matrix(camera.rotation)[:, None],
            f"Rot_{name}": camera.rotation,
            f"T_{name}": camera.translation[:, None],
        }
    files = {_INTRINSICS: _format_file(intrinsics), _EXTRINSICS: _format_file(extrinsics)}
    return Written(files, lost)


# --- JARVIS


def read_jarvis(document: Document) -> CameraFile:
    """Read the camera. Raises FormatError."""
    data = document.mapping("intrinsicMatrix")
    found = camera_fields(data, document.source)
    raw = RawCamera(name=document.stem, by_columns=True, **found)
    return collect_cameras([raw], document.source, unit=data.get("unit", ""))


def write_jarvis(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write a file for each camera. Raises MismatchError."""
    lost = check_rig(rig, provenance, "jarvis", terms=5, sizes="lost", names=FILE_NAME)
    files = {
        f"{camera.name}.yaml": _format_file(
            {
                "intrinsicMatrix": camera.matrix.T,
                "distortionCoefficients": lens_terms(camera, 5)[None],
                "R": camera.rotation.T,
                "T": camera.translation[:, None],
            }
        )
        for camera in rig
    }
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


def read_kalibr(document: Document) -> CameraFile:
    """Read the cameras in the order of the chain. Raises FormatError."""
    expected = "cameras cam0, cam1, ... of the models pinhole and radtan, equidistant or none"
    found = typed(document.tree, dict[str, _KalibrCamera], document.source, expected)
    raws: list[RawCamera] = []
    from_world: Floats | None = np.eye(4)
    for name in sorted(found, key=lambda name: (len(name), name)):  # cam2 before cam10
        camera = found[name]
        if raws and from_world is not None:
            where, step = f"{document.source}: camera {name}", camera.T_cn_cnm1
            if step is not None:
                step = numbers(step, "a 4 x 4 transform T_cn_cnm1", where, 16).reshape(4, 4)
            from_world = None if step is None else step @ from_world
        raws.append(
            RawCamera(
                name=name,
                size=camera.resolution,
                matrix=camera.intrinsics,
                distortion=camera.distortion_coeffs,
                fisheye=camera.distortion_model == "equidistant",
                rotation=None if from_world is None else from_world[:3, :3],
                translation=None if from_world is None else from_world[:3, 3],
            )
        )
    return collect_cameras(raws, document.source)


JARVIS = Format(
    name="jarvis",
    title="JARVIS YAML",
    sniff=partial(Document.has_line, pattern=r"^intrinsicMatrix\s*:"),
    read=read_jarvis,
    write=write_jarvis,
    unit="mm",
    folder=True,
)
EASYMOCAP = Format(
    name="easymocap",
    title="EasyMocap intri.yml and extri.yml",
    sniff=sniff_easymocap,
    read=read_easymocap,
    write=write_easymocap,
    unit="m",
    folder=True,
)
KALIBR = Format(
    name="kalibr",
    title="Kalibr camchain",
    sniff=partial(Document.has_line, pattern=r"^\s+intrinsics\s*:"),
    read=read_kalibr,
    passed_over=("cam_overlaps", "T_cam_imu", "timeshift_cam_imu"),
    unit="m",
)
ROS = Format(
    name="ros",
    title="ROS camera_info",
    sniff=partial(Document.has_line, pattern=r"(?s)\A(?!.*!!opencv-matrix).*^distortion_model\s*:"),
    read=read_ros,
    passed_over=(
        *("rectification_matrix", "projection_matrix", "R", "P", "r", "p"),
        *("header", "binning_x", "binning_y", "roi"),
    ),
)
OPENCV = Format(
    name="opencv",
    title="OpenCV YAML",
    sniff=sniff_opencv,
    read=read_opencv,
    passed_over=_OF_CALIBRATION,
    write=write_opencv,
    folder=True,
)
