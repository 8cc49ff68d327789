"""nerfstudio's transforms.json: camera_to_world in OpenGL's axes (x right, y up, z back), pixels with their corners at integers."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from mocap_calib.io.cameras.colmap import HALF, stem
from mocap_calib.io.cameras.intrinsics import make_camera, make_extrinsics, numbers
from mocap_calib.io.cameras.source import (
    CameraFile,
    Source,
    entries,
    need,
    need_sizes,
    terms,
    to_json,
    unique,
)
from mocap_calib.io.file import malformed
from mocap_calib.io.registry import Written
from mocap_calib.types import Camera, CameraRig

_FLIP = np.array([1.0, -1.0, -1.0])
_MODELS = {"OPENCV": False, "PINHOLE": False, "SIMPLE_PINHOLE": False, "OPENCV_FISHEYE": True}
_FOLDER = "images/"


def sniff(source: Source) -> bool:
    """Frames with transform_matrix."""
    frames = source.tree.get("frames") if source.has("json", "frames") else None
    return isinstance(frames, list) and any(
        isinstance(f, dict) and "transform_matrix" in f for f in frames
    )


def parse(source: Source) -> CameraFile:
    """A frame is a camera here; what a frame does not say stands at the top. Raises FormatError."""
    cameras, extrinsics = [], {}
    for number, frame in entries(
        source.mapping("frames")["frames"], "a list of frames", source.path
    ):
        where = f"{source.path}: frame {number}"
        fields = {key: value for key, value in source.tree.items() if key != "frames"} | frame
        name = stem(str(fields.get("file_path", number)).removeprefix("./").removeprefix(_FOLDER))
        cameras.append(_camera(name, fields, where))
        need(fields, ("transform_matrix",), where)
        matrix = numbers(fields["transform_matrix"], "a 4 x 4 transform_matrix", where)
        if matrix.shape not in ((4, 4), (3, 4)):
            raise malformed(where, "a 4 x 4 transform_matrix", f"shape {matrix.shape}", "mend it")
        rotation, centre = make_extrinsics(matrix[:3, :3] * _FLIP, matrix[:3, 3], where)
        extrinsics[name] = (rotation.T, -rotation.T @ centre)
    return CameraFile(unique(cameras, source.path), extrinsics, str(source.tree.get("unit", "")))


def _camera(name: str, fields: Mapping[str, Any], where: str) -> Camera:
    model = str(fields.get("camera_model", "OPENCV"))
    if model not in _MODELS:
        raise malformed(
            where, f"a camera_model of {', '.join(_MODELS)}", model, "export with one of them"
        )
    need(fields, ("fl_x", "cx", "cy"), where)
    fisheye = _MODELS[model]
    middle = numbers(
        [fields["fl_x"], fields.get("fl_y", fields["fl_x"]), fields["cx"], fields["cy"]],
        "numbers fl_x, fl_y, cx, cy",
        where,
    )
    fx, fy, cx, cy = middle.tolist() if middle.shape == (4,) else [0.0] * 4
    order = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    if not fisheye and fields.get("k4", 0) != 0:
        raise malformed(
            where, "k1, k2, k3, p1, p2 of OpenCV's model", "a k4", "calibrate without it"
        )
    size = [fields["w"], fields["h"]] if {"w", "h"} <= fields.keys() else None
    lens = [fields.get(key, 0.0) for key in order]
    return make_camera(
        name, size, [[fx, 0, cx - HALF], [0, fy, cy - HALF], [0, 0, 1]], lens, fisheye, where
    )


def write(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:  # noqa: ARG001 - the writers' signature
    """One frame a camera, images/NAME.png. Raises MismatchError."""
    need_sizes(rig, "nerfstudio")
    frames = []
    for v, camera in enumerate(rig.cameras):
        order = ("k1", "k2", "k3", "k4") if camera.fisheye else ("k1", "k2", "p1", "p2", "k3")
        lens = camera.distortion if camera.fisheye else terms(camera, 5, "nerfstudio")
        (fx, _, cx), (_, fy, cy), _ = camera.matrix.tolist()
        world_from_camera = np.eye(4)
        world_from_camera[:3, :3] = rig.rotation[v].T * _FLIP
        world_from_camera[:3, 3] = rig.centres[v]
        fields: dict[str, Any] = {
            "file_path": f"{_FOLDER}{camera.name}.png",
            "camera_model": "OPENCV_FISHEYE" if camera.fisheye else "OPENCV",
        }
        fields |= {
            "fl_x": fx,
            "fl_y": fy,
            "cx": cx + HALF,
            "cy": cy + HALF,
            "w": camera.size[0],
            "h": camera.size[1],
        }
        frames.append(
            fields
            | dict(zip(order, lens.tolist(), strict=True))
            | {"transform_matrix": world_from_camera.tolist()}
        )
    return Written(
        {
            "transforms.json": to_json(
                {"camera_model": frames[0]["camera_model"], "unit": rig.unit, "frames": frames}
            )
        }
    )
