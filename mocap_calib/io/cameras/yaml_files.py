"""YAML with one camera a file, or our own with all: OpenCV's FileStorage, ROS camera_info, JARVIS, cameras.yaml."""

import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from mocap_calib.io.cameras.intrinsics import (
    camera_from_fields,
    describe_keys,
    make_camera,
    make_extrinsics,
    numbers,
)
from mocap_calib.io.cameras.own import VERSION, format_cameras_yaml
from mocap_calib.io.cameras.source import (
    FILE_NAME,
    CameraFile,
    Source,
    need_names,
    terms,
    unique,
    without_sizes,
)
from mocap_calib.io.file import malformed
from mocap_calib.io.registry import Written
from mocap_calib.types import CameraRig, Floats

_MATRIX = ("camera_matrix", "K", "M1", "intrinsic_matrix", "k")
_DISTORTION = ("distortion_coefficients", "dist_coeffs", "distCoeffs", "dist_coeff", "D", "D1", "d")
_ROTATION = ("rvec", "R", "rotation", "rotation_matrix", "rotation_vector")
_TRANSLATION = ("tvec", "T", "t", "translation", "translation_vector")
_FISHEYE, _PINHOLE = (
    ("equidistant", "fisheye"),
    ("", "plumb_bob", "rational_polynomial", "opencv", "pinhole", "radtan", "none"),
)
_REGULAR = r"[A-Za-z_][\w-]*"  # what FileStorage takes for a key


# --- our own


def sniff_own(source: Source) -> bool:
    """By the first field."""
    return (
        source.syntax == "yaml"
        and re.search(r"^format: *[\"']?mocap-calib cameras", source.text, re.M) is not None
    )


def parse_own(source: Source) -> CameraFile:
    """Our own cameras.yaml. Raises FormatError."""
    data = source.mapping()
    if data.get("version") != VERSION:
        raise malformed(
            source.path,
            f"version {VERSION} of our cameras",
            f"version {data.get('version')}",
            "use the program that wrote it",
        )
    fields = data.get("cameras")
    if not isinstance(fields, list) or not fields:
        raise malformed(
            source.path, "a list of cameras", describe_keys(fields), "write the file again"
        )
    cameras = unique((camera_from_fields(each, source.path) for each in fields), source.path)
    placed = [
        (camera.name, each)
        for camera, each in zip(cameras, fields, strict=True)
        if {"R", "t"} <= each.keys()
    ]
    extrinsics = {
        name: make_extrinsics(each["R"], each["t"], f"{source.path}: camera {name}")
        for name, each in placed
    }
    return CameraFile(cameras, extrinsics, str(data.get("unit", "")))


def write_own(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Our own cameras.yaml; carries all."""
    return Written({"cameras.yaml": format_cameras_yaml(rig, provenance).encode()})


# --- OpenCV, ROS


def sniff_ros(source: Source) -> bool:
    """A camera_info file, or what `rostopic echo` says of the topic."""
    return (
        source.syntax == "yaml"
        and re.search(r"^distortion_model\s*:", source.text, re.M) is not None
        and "!!opencv-matrix" not in source.text
    )


def sniff_opencv(source: Source) -> bool:
    """By the header, the matrices, or the name of the camera matrix."""
    return (
        source.syntax == "yaml"
        and re.search(r"\A\s*%YAML|!!opencv-matrix|^(camera_matrix|K|M1)\s*:", source.text, re.M)
        is not None
    )


def parse_ros(source: Source) -> CameraFile:
    """Intrinsics alone: R and P of camera_info say how to rectify, not where the camera stands. Raises FormatError."""
    return _parse(source, placed=False)


def parse_opencv(source: Source) -> CameraFile:
    """One camera, under any of the names that people give to its fields. Raises FormatError."""
    return _parse(source, placed=True)


def _parse(source: Source, placed: bool) -> CameraFile:
    data = source.mapping()
    matrix = _first(data, _MATRIX)
    if matrix is None or "M2" in data:
        found = "a stereo pair (M1, M2)" if "M2" in data else ", ".join(map(str, list(data)[:8]))
        raise malformed(
            source.path,
            f"one camera with its matrix under {', '.join(_MATRIX)}",
            found,
            "give one file per camera",
        )
    if isinstance(matrix, list) and len(matrix) == 9:
        matrix = {"rows": 3, "cols": 3, "data": matrix}
    name = str(data.get("camera_name") or source.stem)
    width, height = _first(data, ("image_width", "width")), _first(data, ("image_height", "height"))
    model = str(data.get("distortion_model", data.get("model", ""))).lower()
    if model not in (*_FISHEYE, *_PINHOLE):
        raise malformed(
            source.path,
            "the distortion model plumb_bob, rational_polynomial or equidistant",
            model,
            "calibrate with one of them",
        )
    fisheye = model in _FISHEYE or data.get("fisheye") in (True, 1)
    size = None if width is None or height is None else [width, height]
    camera = make_camera(name, size, matrix, _first(data, _DISTORTION), fisheye, source.path)
    rotation, translation = _first(data, _ROTATION), _first(data, _TRANSLATION)
    there = placed and rotation is not None and translation is not None
    return CameraFile(
        (camera,),
        {name: make_extrinsics(rotation, translation, source.path)} if there else {},
        str(data.get("unit", "")),
    )


def write_opencv(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:  # noqa: ARG001 - the writers' signature
    """A file a camera, which cv2.FileStorage reads; carries all. Raises MismatchError."""
    need_names(rig.names, *FILE_NAME, "opencv")
    files = {}
    for v, camera in enumerate(rig.cameras):
        lines = [
            f'camera_name: "{camera.name}"',
            f"image_width: {camera.size[0]}",
            f"image_height: {camera.size[1]}",
        ]
        lines += opencv_matrix("camera_matrix", camera.matrix) + [
            f'distortion_model: "{_model(camera.fisheye, len(camera.distortion))}"'
        ]
        lines += opencv_matrix("distortion_coefficients", camera.distortion[None])
        lines += (
            opencv_matrix("R", rig.rotation[v])
            + opencv_matrix("T", rig.translation[v][:, None])
            + [f'unit: "{rig.unit}"']
        )
        files[f"{camera.name}.yml"] = file_storage(lines)
    return Written(files)


def _model(fisheye: bool, count: int) -> str:
    return "equidistant" if fisheye else "rational_polynomial" if count > 5 else "plumb_bob"


# --- JARVIS


def sniff_jarvis(source: Source) -> bool:
    """By the name of its camera matrix."""
    return (
        source.syntax == "yaml"
        and re.search(r"^intrinsicMatrix\s*:", source.text, re.M) is not None
    )


def parse_jarvis(source: Source) -> CameraFile:
    """K and R are stored transposed: row vectors x = [X 1] [R; T] K. Raises FormatError."""
    data = source.mapping()
    matrix = numbers(data.get("intrinsicMatrix"), "a 3 x 3 intrinsicMatrix", source.path)
    camera = make_camera(
        source.stem, None, matrix.T, data.get("distortionCoefficients"), False, source.path
    )
    if "R" not in data or "T" not in data:
        return CameraFile((camera,), {})
    rotation = numbers(data["R"], "a 3 x 3 rotation R", source.path)
    return CameraFile(
        (camera,),
        {camera.name: make_extrinsics(rotation.T, data["T"], source.path)},
        str(data.get("unit", "")),
    )


def write_jarvis(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:  # noqa: ARG001 - the writers' signature
    """A file a camera, named after it. JARVIS' own projection takes k1 and k2 alone. Raises MismatchError."""
    need_names(rig.names, *FILE_NAME, "jarvis")
    files, beyond = {}, []
    for v, camera in enumerate(rig.cameras):
        distortion = terms(camera, 5, "jarvis")
        beyond += [camera.name] if distortion[2:].any() else []
        lines = opencv_matrix("intrinsicMatrix", camera.matrix.T) + opencv_matrix(
            "distortionCoefficients", distortion[None]
        )
        files[f"{camera.name}.yaml"] = file_storage(
            lines
            + opencv_matrix("R", rig.rotation[v].T)
            + opencv_matrix("T", rig.translation[v][:, None])
        )
    unused = (
        (
            f"the tangential terms and k3 of {', '.join(beyond)}, to JARVIS itself: it uses k1 and k2",
        )
        if beyond
        else ()
    )
    return Written(files, (*without_sizes(rig), *unused))


# --- shared


def file_storage(lines: Iterable[str]) -> bytes:
    """The header that OpenCV 4 and 5 read, and the lines."""
    return "\n".join(["%YAML:1.0", "---", *lines, ""]).encode()


def opencv_matrix(key: str, matrix: Floats) -> list[str]:
    """A matrix as cv2.FileStorage writes it; every float comes back exactly."""
    assert re.fullmatch(_REGULAR, key)
    rows, cols = matrix.shape
    data = ", ".join(_number(float(value)) for value in np.ravel(matrix))
    return [
        f"{key}: !!opencv-matrix",
        f"   rows: {rows}",
        f"   cols: {cols}",
        "   dt: d",
        f"   data: [ {data} ]",
    ]


def _number(value: float) -> str:
    """With a point always: YAML 1.1 takes `1e-05` for text."""
    text = repr(value)
    return text if "." in text else text.replace("e", ".0e") if "e" in text else f"{text}."


def _first(data: Mapping[str, Any], keys: Iterable[str]) -> Any:
    return next((data[key] for key in keys if key in data), None)
