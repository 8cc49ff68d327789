"""COLMAP's text model: cameras.txt, images.txt and points3D.txt in a folder.

* An image is a camera here: a rig that stands still has one image a camera, called after it.
* Pixels have their corners at integers, so that cx and cy are half a pixel more than ours.
* Each camera model has its own number and order of parameters.
* An image takes two lines, the second of which (its points) may be empty.
* There is no unit of length; a comment `# unit: m` says ours.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_calib.geometry.rotation import quaternion_from_matrix, skew
from mocap_calib.io.cameras.common import (
    CORNER_OFFSET,
    PlacedCamera,
    camera_of_image,
    collect_cameras,
    pinhole_matrix,
)
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

_CAMERAS = "cameras.txt"
_IMAGES = "images.txt"
_POINTS = "points3D.txt"
_UNIT = "# unit:"
_REMEDY = "export the model with `colmap model_converter --output_type TXT`"
_LENGTHS_OF_QUATERNIONS = (0.5, 2.0)  # what rounding of a unit quaternion may leave, and more


@dataclass(frozen=True)
class _Model:
    """Where a camera model has its parameters.

    pinhole: indices of fx fy cx cy.
    lens: indices of k1 k2 p1 p2 k3 k4 k5 k6, as many as there are.
    """

    pinhole: tuple[int, ...]
    lens: tuple[int, ...]
    fisheye: bool = False

    @property
    def parameters(self) -> int:
        """Number of parameters."""
        return 1 + max(*self.pinhole, *self.lens)


_MODELS = {
    "SIMPLE_PINHOLE": _Model((0, 0, 1, 2), ()),
    "PINHOLE": _Model((0, 1, 2, 3), ()),
    "SIMPLE_RADIAL": _Model((0, 0, 1, 2), (3,)),
    "RADIAL": _Model((0, 0, 1, 2), (3, 4)),
    "OPENCV": _Model((0, 1, 2, 3), (4, 5, 6, 7)),
    "FULL_OPENCV": _Model((0, 1, 2, 3), tuple(range(4, 12))),
    "OPENCV_FISHEYE": _Model((0, 1, 2, 3), (4, 5, 6, 7), fisheye=True),
    "SIMPLE_RADIAL_FISHEYE": _Model((0, 0, 1, 2), (3,), fisheye=True),
    "RADIAL_FISHEYE": _Model((0, 0, 1, 2), (3, 4), fisheye=True),
}


def sniff(source: Source) -> bool:
    """Return whether this is a folder with cameras.txt or cameras.bin, or cameras.txt itself."""
    if source.folder:
        return _CAMERAS in source.files or "cameras.bin" in source.files
    if source.syntax != "yaml":
        return False
    rows = [line.split() for line in source.text.splitlines()[:8]]
    return any(len(row) > 1 and row[1] in _MODELS for row in rows)


# --- reading


def parse(source: Source) -> CameraFile:
    """Read the images as cameras; without images.txt the cameras alone, by their numbers.

    Raises FormatError.
    """
    if source.folder and _CAMERAS not in source.files:
        expected = f"COLMAP's text model ({_CAMERAS}, {_IMAGES})"
        raise malformed(source.path, expected, "its binary one", _REMEDY)
    camera_list = source.of(_CAMERAS) if source.folder else source
    cameras = _parse_cameras(camera_list)
    unit = _find_unit(camera_list.text)
    if _IMAGES not in source.files:
        return CameraFile(unique(cameras.values(), source.path), {}, unit)
    images = _parse_images(source.of(_IMAGES), cameras)
    return collect_cameras(images, source.path, unit=unit)


def _find_unit(text: str) -> str:
    """Return the unit in the comment that `write` makes, "" where there is none."""
    for line in text.splitlines():
        if line.startswith(_UNIT):
            return line.removeprefix(_UNIT).strip()
    return ""


def _parse_cameras(source: Source) -> dict[str, Camera]:
    """Return the cameras of cameras.txt by their numbers. Raises FormatError."""
    cameras: dict[str, Camera] = {}
    for number, line in enumerate(source.text.splitlines(), 1):
        cells = line.split()
        if not cells or line.startswith("#"):
            continue
        where = f"{source.path}: line {number}"
        if len(cells) < 5 or cells[1] not in _MODELS:
            models = ", ".join(_MODELS)
            expected = f"CAMERA_ID MODEL WIDTH HEIGHT PARAMS, the model one of {models}"
            found = f"the model {cells[1]}" if len(cells) > 4 else f"{len(cells)} cells"
            raise malformed(where, expected, found, "undistort, or choose another model")
        if cells[0] in cameras:
            raise malformed(where, "each CAMERA_ID once", f"{cells[0]} twice", "remove one of them")
        cameras[cells[0]] = _parse_camera(cells, where)
    return cameras


def _parse_camera(cells: list[str], where: str) -> Camera:
    """Return the camera of a line of cameras.txt. Raises FormatError."""
    model = _MODELS[cells[1]]
    values = _parse_floats(cells[4:], where)
    if len(values) != model.parameters:
        expected = f"{model.parameters} parameters of {cells[1]}"
        raise malformed(where, expected, f"{len(values)}", "mend the line")
    fx, fy, cx, cy = values[list(model.pinhole)]
    return make_camera(
        name=cells[0],
        size=[whole(cell, "a whole number of pixels", where) for cell in cells[2:4]],
        matrix=pinhole_matrix(fx, fy, cx - CORNER_OFFSET, cy - CORNER_OFFSET),
        distortion=[values[index] for index in model.lens],
        fisheye=model.fisheye,
        source=where,
    )


def _parse_images(source: Source, cameras: Mapping[str, Camera]) -> Iterator[PlacedCamera]:
    """Yield a camera for each image of images.txt. Raises FormatError.

    cameras: by their numbers.
    """
    lines = iter(enumerate(source.text.splitlines(), 1))
    for number, line in lines:
        cells = line.split()
        if not cells or line.startswith("#"):
            continue
        next(lines, None)  # its points, a line that may be missing at the end of the file
        where = f"{source.path}: line {number}"
        if len(cells) < 10 or cells[8] not in cameras:
            expected = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME with a camera of cameras.txt"
            found = f"CAMERA_ID {cells[8]}" if len(cells) > 9 else f"{len(cells)} cells"
            raise malformed(where, expected, found, _REMEDY)
        values = _parse_floats(cells[1:8], where)
        rotation = _rotation_from_quaternion(values[:4], where)
        extrinsics = make_extrinsics(rotation, values[4:], where)
        name = camera_of_image(" ".join(cells[9:]))
        yield replace(cameras[cells[8]], name=name), extrinsics


def _rotation_from_quaternion(quaternion: Floats, where: str) -> Floats:
    """Return the `[3, 3]` rotation of a quaternion (w, x, y, z) of rounded digits.

    Raises FormatError where its length is far from 1.
    """
    length = math.hypot(*quaternion)  # which large numbers do not overflow
    least, most = _LENGTHS_OF_QUATERNIONS
    if not least < length < most:  # nor is NaN
        expected = "a unit quaternion QW QX QY QZ"
        raise malformed(where, expected, quaternion.tolist(), _REMEDY)
    w = quaternion[0] / length
    v = quaternion[1:] / length
    return (w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * skew(v)


def _parse_floats(cells: list[str], where: str) -> Floats:
    """Return the numbers in the cells of a line. Raises FormatError."""
    try:
        return np.array([float(cell) for cell in cells])
    except ValueError as error:
        raise malformed(where, "numbers", error, "mend the line") from None


# --- writing


def write(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write all three files, the one of points empty; an image is called NAME.png.

    Raises MismatchError.
    """
    need_sizes(rig, "colmap")
    need_names(rig.names, r"[^\s\x00-\x1f\x7f-\xa0\ud800-\udfff]+", "no spaces", "colmap")
    cameras = ["# Camera list: CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]", f"{_UNIT} {rig.unit}"]
    images = [
        "# Image list, two lines each: IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME",
        "#   POINTS2D[] as (X, Y, POINT3D_ID)",
    ]
    points = [
        "# 3D point list: POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)"
    ]
    for view, camera in enumerate(rig.cameras):
        number = view + 1
        cameras.append(f"{number} {_format_camera(camera)}")
        quaternion = _format_floats(quaternion_from_matrix(rig.rotation[view]))
        translation = _format_floats(rig.translation[view])
        images.append(f"{number} {quaternion} {translation} {number} {camera.name}.png")
        images.append("")
    return Written({_CAMERAS: _join(cameras), _IMAGES: _join(images), _POINTS: _join(points)})


def _format_camera(camera: Camera) -> str:
    """Return model, size and parameters of a camera, in the smallest model that has them."""
    if camera.fisheye:
        model, lens = "OPENCV_FISHEYE", camera.distortion
    else:
        lens = terms(camera, 8, "colmap")
        model = "FULL_OPENCV" if lens[4:].any() else "OPENCV"
        lens = lens[: len(_MODELS[model].lens)]
    pinhole = camera.matrix[[0, 1, 0, 1], [0, 1, 2, 2]] + [0, 0, CORNER_OFFSET, CORNER_OFFSET]
    width, height = camera.size
    return f"{model} {width} {height} {_format_floats(np.concatenate([pinhole, lens]))}"


def _format_floats(values: Floats) -> str:
    unsigned = values + 0.0  # which takes the sign from zeros
    return " ".join(repr(value) for value in unsigned.tolist())


def _join(lines: list[str]) -> bytes:
    return ("\n".join(lines) + "\n").encode()
