"""COLMAP's text model: cameras.txt, images.txt, points3D.txt. Its pixels have their corners at integers, so cx and cy are half a pixel more.

An image is a camera here: a rig that stands still has one image a camera.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mocap_calib.geometry.rotation import quaternion_from_matrix, skew
from mocap_calib.io.cameras.intrinsics import make_camera, make_extrinsics
from mocap_calib.io.cameras.source import (
    CameraFile,
    Source,
    need_names,
    need_sizes,
    terms,
    unique,
    whole,
)
from mocap_calib.io.file import malformed
from mocap_calib.io.registry import Written
from mocap_calib.types import Camera, CameraRig, Floats

HALF = 0.5
_CAMERAS, _IMAGES, _POINTS = "cameras.txt", "images.txt", "points3D.txt"
# where fx fy cx cy and k1 k2 p1 p2 k3 k4 k5 k6 stand among the parameters
_MODELS = {
    "SIMPLE_PINHOLE": ((0, 0, 1, 2), (), False),
    "PINHOLE": ((0, 1, 2, 3), (), False),
    "SIMPLE_RADIAL": ((0, 0, 1, 2), (3,), False),
    "RADIAL": ((0, 0, 1, 2), (3, 4), False),
    "OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7), False),
    "FULL_OPENCV": ((0, 1, 2, 3), tuple(range(4, 12)), False),
    "OPENCV_FISHEYE": ((0, 1, 2, 3), (4, 5, 6, 7), True),
    "SIMPLE_RADIAL_FISHEYE": ((0, 0, 1, 2), (3,), True),
    "RADIAL_FISHEYE": ((0, 0, 1, 2), (3, 4), True),
}
_PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
_REMEDY = "export the model with `colmap model_converter --output_type TXT`"


def sniff(source: Source) -> bool:
    """A folder with cameras.txt or cameras.bin, or cameras.txt itself."""
    if source.folder:
        return _CAMERAS in source.files or "cameras.bin" in source.files
    return source.syntax == "yaml" and any(
        len(row) > 1 and row[1] in _MODELS for row in map(str.split, source.text.splitlines()[:8])
    )


def parse(source: Source) -> CameraFile:
    """The images as cameras; without images.txt the cameras alone, by their numbers. Raises FormatError."""
    if source.folder and _CAMERAS not in source.files:
        raise malformed(
            source.path, f"COLMAP's text model ({_CAMERAS}, {_IMAGES})", "its binary one", _REMEDY
        )
    listed = source.of(_CAMERAS) if source.folder else source
    cameras = _cameras(listed)
    unit = next(
        (
            line.partition(":")[2].strip()
            for line in listed.text.splitlines()
            if line.startswith("# unit:")
        ),
        "",
    )
    if _IMAGES not in source.files:
        return CameraFile(unique(cameras.values(), source.path), {}, unit)
    images = _images(source.of(_IMAGES), cameras)
    found = unique((camera for camera, _, _ in images), source.path)
    return CameraFile(
        found,
        {camera.name: (rotation, translation) for camera, rotation, translation in images},
        unit,
    )


def _cameras(source: Source) -> dict[str, Camera]:
    cameras: dict[str, Camera] = {}
    for number, line in enumerate(source.text.splitlines(), 1):
        cells, where = line.split(), f"{source.path}: line {number}"
        if not cells or line.startswith("#"):
            continue
        if len(cells) < 5 or cells[1] not in _MODELS:
            found = f"the model {cells[1]}" if len(cells) > 4 else f"{len(cells)} cells"
            raise malformed(
                where,
                f"CAMERA_ID MODEL WIDTH HEIGHT PARAMS, the model one of {', '.join(_MODELS)}",
                found,
                "undistort, or choose another model",
            )
        if cells[0] in cameras:
            raise malformed(where, "each CAMERA_ID once", f"{cells[0]} twice", "remove one of them")
        cameras[cells[0]] = _camera(cells, where)
    return cameras


def _camera(cells: list[str], where: str) -> Camera:
    middle, lens, fisheye = _MODELS[cells[1]]
    values = _floats(cells[4:], where)
    if len(values) != 1 + max(*middle, *lens):
        raise malformed(
            where,
            f"{1 + max(*middle, *lens)} parameters of {cells[1]}",
            f"{len(values)}",
            "mend the line",
        )
    fx, fy, cx, cy = values[list(middle)]
    size = [whole(cell, "a whole number of pixels", where) for cell in cells[2:4]]
    matrix = [[fx, 0, cx - HALF], [0, fy, cy - HALF], [0, 0, 1]]
    return make_camera(cells[0], size, matrix, values[list(lens)] if lens else [], fisheye, where)


def _images(source: Source, cameras: Mapping[str, Camera]) -> list[tuple[Camera, Floats, Floats]]:
    """Every image takes two lines; the second has its points, and may be empty or, at the end of the file, missing."""
    found, lines = [], iter(enumerate(source.text.splitlines(), 1))
    for number, line in lines:
        cells, where = line.split(), f"{source.path}: line {number}"
        if not cells or line.startswith("#"):
            continue
        next(lines, None)
        if len(cells) < 10 or cells[8] not in cameras:
            known = f"CAMERA_ID {cells[8]}" if len(cells) > 9 else f"{len(cells)} cells"
            raise malformed(
                where,
                "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME with a camera of cameras.txt",
                known,
                _REMEDY,
            )
        values = _floats(cells[1:8], where)
        rotation, translation = make_extrinsics(_rotation(values[:4], where), values[4:], where)
        found.append(
            (replace(cameras[cells[8]], name=stem(" ".join(cells[9:]))), rotation, translation)
        )
    return found


def stem(name: str) -> str:
    """An image's name without the ending of a picture."""
    start, dot, ending = name.rpartition(".")
    return start if start and dot + ending.lower() in _PICTURES else name


def _rotation(q: Floats, where: str) -> Floats:
    """`[3, 3]` of a quaternion (w, x, y, z), of any length but none. Raises FormatError."""
    length = math.hypot(*q)  # which large numbers do not overflow
    if not 0.5 < length < 2:  # rounded digits; also NaN
        raise malformed(where, "a unit quaternion QW QX QY QZ", q.tolist(), _REMEDY)
    w, v = q[0] / length, q[1:] / length
    return (w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * skew(v)


def _floats(cells: list[str], where: str) -> Floats:
    try:
        return np.array([float(cell) for cell in cells])
    except ValueError as error:
        raise malformed(where, "numbers", error, "mend the line") from None


def write(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:  # noqa: ARG001 - the writers' signature
    """All three files, the points empty; an image is called NAME.png. Raises MismatchError."""
    need_sizes(rig, "colmap")
    need_names(rig.names, r"[^\s\x00-\x1f\x7f-\xa0\ud800-\udfff]+", "no spaces", "colmap")
    cameras = ["# Camera list: CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]", f"# unit: {rig.unit}"]
    images = [
        "# Image list, two lines each: IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME",
        "#   POINTS2D[] as (X, Y, POINT3D_ID)",
    ]
    for v, camera in enumerate(rig.cameras):
        model, lens = _model(camera)
        middle = camera.matrix[[0, 1, 0, 1], [0, 1, 2, 2]] + [0, 0, HALF, HALF]
        cameras.append(
            f"{v + 1} {model} {camera.size[0]} {camera.size[1]} {_text(np.concatenate([middle, lens]))}"
        )
        images += [
            f"{v + 1} {_text(quaternion_from_matrix(rig.rotation[v]))} {_text(rig.translation[v])} {v + 1} {camera.name}.png",
            "",
        ]
    points = (
        "# 3D point list: POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n"
    )
    return Written({_CAMERAS: _lines(cameras), _IMAGES: _lines(images), _POINTS: points.encode()})


def _model(camera: Camera) -> tuple[str, Floats]:
    """The smallest model that has what the camera has, and its distortion."""
    if camera.fisheye:
        return "OPENCV_FISHEYE", camera.distortion
    lens = terms(camera, 8, "colmap")
    return ("FULL_OPENCV", lens) if lens[4:].any() else ("OPENCV", lens[:4])


def _text(values: Floats) -> str:
    return " ".join(map(repr, values.tolist()))


def _lines(lines: list[str]) -> bytes:
    return ("\n".join(lines) + "\n").encode()
