"""nerfstudio's transforms.json: one frame an image, which is a camera here.

* transform_matrix is camera_to_world in OpenGL's axes: x right, y up, z back.
* Pixels have their corners at integers, so that cx and cy are half a pixel more than ours.
* What a frame does not say (intrinsics, camera model) stands at the top and holds for all.
* There is no unit of length; `unit` at the top says ours.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mocap_calib.config import CORNER_OFFSET
from mocap_calib.errors import FormatError
from mocap_calib.io.camera_checks import make_camera, make_extrinsics, numbers
from mocap_calib.io.cameras import (
    CameraFile,
    Extrinsics,
    PlacedCamera,
    camera_of_image,
    collect_cameras,
    entries,
    has_json_item,
    need_sizes,
    pinhole_matrix,
    terms,
    to_json,
)
from mocap_calib.io.document import Document, need
from mocap_calib.io.format import Format, Written
from mocap_calib.io.provenance import plain_fields, read_judgement
from mocap_calib.types import Camera, CameraRig, Floats

_OPENGL_AXES = np.array([1.0, -1.0, -1.0])
# camera model -> whether it is a fisheye's
_MODELS = {"OPENCV": False, "PINHOLE": False, "SIMPLE_PINHOLE": False, "OPENCV_FISHEYE": True}
_PINHOLE_TERMS = ("k1", "k2", "p1", "p2", "k3")
_FISHEYE_TERMS = ("k1", "k2", "k3", "k4")
_FOLDER = "images/"


def sniff(document: Document) -> bool:
    """Return whether there are frames with a transform_matrix."""
    return has_json_item(document, "frames", "transform_matrix")


# --- reading


def parse(document: Document) -> CameraFile:
    """Read the frames as cameras, called after their images. Raises FormatError."""
    data = document.mapping("frames")
    shared = {key: value for key, value in data.items() if key != "frames"}
    placed: list[PlacedCamera] = []
    for number, frame in entries(data["frames"], "a list of frames", document.source):
        where = f"{document.source}: frame {number}"
        fields = shared | frame
        path = str(fields.get("file_path", number)).removeprefix("./").removeprefix(_FOLDER)
        camera = _parse_camera(camera_of_image(path), fields, where)
        placed.append((camera, _parse_extrinsics(fields, where)))
    found = collect_cameras(placed, document.source, unit=str(data.get("unit", "")))
    return replace(found, judgement=read_judgement(data.get("provenance")))


def _parse_camera(name: str, fields: Mapping[str, Any], where: str) -> Camera:
    """Return the camera of a frame without its place. Raises FormatError."""
    model = str(fields.get("camera_model", "OPENCV"))
    if model not in _MODELS:
        expected = f"a camera_model of {', '.join(_MODELS)}"
        raise FormatError(where, expected, model, "export with one of them")
    need(fields, ("fl_x", "cx", "cy"), where)
    fisheye = _MODELS[model]
    fx, fy, cx, cy = _parse_pinhole(fields, where)
    if not fisheye and fields.get("k4", 0) != 0:
        expected = "k1, k2, k3, p1, p2 of OpenCV's model"
        raise FormatError(where, expected, "a k4", "calibrate without it")
    terms_of_model = _FISHEYE_TERMS if fisheye else _PINHOLE_TERMS
    return make_camera(
        name=name,
        size=[fields["w"], fields["h"]] if {"w", "h"} <= fields.keys() else None,
        matrix=pinhole_matrix(fx, fy, cx - CORNER_OFFSET, cy - CORNER_OFFSET),
        distortion=[fields.get(key, 0.0) for key in terms_of_model],
        fisheye=fisheye,
        source=where,
    )


def _parse_pinhole(fields: Mapping[str, Any], where: str) -> list[float]:
    """Return fx, fy, cx, cy; zeros, which no camera matrix has, where one is no single number.

    Raises FormatError.
    """
    fl_y = fields.get("fl_y", fields["fl_x"])
    given = [fields["fl_x"], fl_y, fields["cx"], fields["cy"]]
    values = numbers(given, "numbers fl_x, fl_y, cx, cy", where)
    return values.tolist() if values.shape == (4,) else [0.0] * 4


def _parse_extrinsics(fields: Mapping[str, Any], where: str) -> Extrinsics:
    """Return the extrinsics of a frame. Raises FormatError."""
    need(fields, ("transform_matrix",), where)
    matrix = numbers(fields["transform_matrix"], "a 4 x 4 transform_matrix", where)
    if matrix.shape not in ((4, 4), (3, 4)):
        raise FormatError(where, "a 4 x 4 transform_matrix", f"shape {matrix.shape}", "mend it")
    # world_from_cam: its translation is the camera's centre
    rotation, centre = make_extrinsics(matrix[:3, :3] * _OPENGL_AXES, matrix[:3, 3], where)
    return rotation.T, -rotation.T @ centre


# --- writing


def write(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write one frame a camera; its image is called images/NAME.png. Raises MismatchError."""
    need_sizes(rig, "nerfstudio")
    frames = [
        _frame(camera, rotation=rig.rotation[view], centre=rig.centres[view])
        for view, camera in enumerate(rig.cameras)
    ]
    document = {
        "camera_model": frames[0]["camera_model"],
        "unit": rig.unit,
        "provenance": plain_fields(provenance),
        "frames": frames,
    }
    return Written({"transforms.json": to_json(document)})


def _frame(camera: Camera, *, rotation: Floats, centre: Floats) -> dict[str, Any]:
    """Return the fields of a frame. Raises MismatchError.

    rotation: `[3, 3]` of cam_from_world. centre: `[3]` in world coordinates.
    """
    if camera.fisheye:
        lens = dict(zip(_FISHEYE_TERMS, camera.distortion.tolist(), strict=True))
    else:
        lens = dict(zip(_PINHOLE_TERMS, terms(camera, 5, "nerfstudio").tolist(), strict=True))
    (fx, _, cx), (_, fy, cy), _ = camera.matrix.tolist()
    width, height = camera.size
    world_from_cam = np.eye(4)
    world_from_cam[:3, :3] = rotation.T * _OPENGL_AXES
    world_from_cam[:3, 3] = centre
    return {
        "file_path": f"{_FOLDER}{camera.name}.png",
        "camera_model": "OPENCV_FISHEYE" if camera.fisheye else "OPENCV",
        "fl_x": fx,
        "fl_y": fy,
        "cx": cx + CORNER_OFFSET,
        "cy": cy + CORNER_OFFSET,
        "w": width,
        "h": height,
        **lens,
        "transform_matrix": world_from_cam.tolist(),
    }


FORMAT = Format(
    kind="cameras",
    name="nerfstudio",
    title="nerfstudio transforms.json",
    sniff=sniff,
    read=parse,
    write=write,
)
