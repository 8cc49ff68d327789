"""nerfstudio's transforms.json: one frame an image, which is a camera here.

* transform_matrix is camera_to_world in OpenGL's axes: x right, y up, z back.
* Pixels have their corners at integers, so that cx and cy are half a pixel more than ours.
* What a frame does not state (intrinsics, camera model) stands at the top and holds for all.
* There is no unit of length; `unit` at the top states ours.
"""

from collections.abc import Mapping
from typing import Any, Literal

import msgspec
import numpy as np

from mocap_calib.config import CORNER_OFFSET
from mocap_calib.errors import FormatError
from mocap_calib.io.camera_checks import make_extrinsics, numbers
from mocap_calib.io.cameras import (
    CameraFile,
    RawCamera,
    camera_of_image,
    check_rig,
    collect_cameras,
    entries,
    has_json_entry,
    lens_terms,
    pinhole_matrix,
    to_json,
)
from mocap_calib.io.document import Document, typed
from mocap_calib.io.format import Format, Written
from mocap_calib.io.provenance import plain_fields
from mocap_calib.types import CameraRig

_OPENGL_AXES = np.array([1.0, -1.0, -1.0])
_PINHOLE_TERMS = ("k1", "k2", "p1", "p2", "k3")
_FISHEYE_TERMS = ("k1", "k2", "k3", "k4")
_FOLDER = "images/"
_MODELS = "OPENCV, PINHOLE, SIMPLE_PINHOLE or OPENCV_FISHEYE"
_EXPECTED = f"a frame with fl_x, cx, cy, transform_matrix and a camera_model of {_MODELS}"


class _Frame(msgspec.Struct):
    fl_x: float
    cx: float
    cy: float
    transform_matrix: Any
    file_path: str = ""
    fl_y: float | None = None
    w: Any = None
    h: Any = None
    camera_model: Literal["OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "OPENCV_FISHEYE"] = "OPENCV"
    k1: Any = 0.0
    k2: Any = 0.0
    k3: Any = 0.0
    k4: Any = 0.0
    p1: Any = 0.0
    p2: Any = 0.0


def sniff(document: Document) -> bool:
    """Return whether there are frames with a transform_matrix."""
    return document.has("json", "frames") and has_json_entry(document, "transform_matrix")


def read(document: Document) -> CameraFile:
    """Read the frames as cameras, called after their images. Raises FormatError."""
    shared = dict(document.mapping("frames"))
    frames = entries(dict[str, Any], shared.pop("frames"), document.source, "a list of frames")
    raws = [
        _read_frame(shared | {"file_path": number} | frame, f"{document.source}: frame {number}")
        for number, frame in frames
    ]
    unit, provenance = shared.get("unit", ""), shared.get("provenance")
    return collect_cameras(raws, document.source, unit=unit, provenance=provenance)


def _read_frame(fields: Mapping[str, Any], where: str) -> RawCamera:
    """Return the camera of a frame. Raises FormatError."""
    frame = typed(fields, _Frame, where, _EXPECTED)
    fisheye = frame.camera_model == "OPENCV_FISHEYE"
    if not fisheye and frame.k4 != 0:
        expected = "k1, k2, k3, p1, p2 of OpenCV's model"
        raise FormatError(where, expected, "a k4", "calibrate without it")
    matrix = numbers(frame.transform_matrix, "a 4 x 4 transform_matrix", where)
    if matrix.shape not in ((4, 4), (3, 4)):
        raise FormatError(where, "a 4 x 4 transform_matrix", f"shape {matrix.shape}", "correct it")
    # world_from_cam: its translation is the camera's centre
    rotation, centre = make_extrinsics(matrix[:3, :3] * _OPENGL_AXES, matrix[:3, 3], where)
    return RawCamera(
        name=camera_of_image(frame.file_path.removeprefix("./").removeprefix(_FOLDER)),
        size=None if frame.w is None or frame.h is None else [frame.w, frame.h],
        matrix=pinhole_matrix(
            frame.fl_x,
            frame.fl_x if frame.fl_y is None else frame.fl_y,
            frame.cx - CORNER_OFFSET,
            frame.cy - CORNER_OFFSET,
        ),
        distortion=[getattr(frame, k) for k in (_FISHEYE_TERMS if fisheye else _PINHOLE_TERMS)],
        fisheye=fisheye,
        rotation=rotation.T,
        centre=centre,
    )


def write(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write one frame a camera; its image is called images/NAME.png. Raises MismatchError."""
    lost = check_rig(rig, provenance, "nerfstudio", terms=5, fisheye=True, sizes="needed")
    frames = []
    for view, camera in enumerate(rig.cameras):
        keys = _FISHEYE_TERMS if camera.fisheye else _PINHOLE_TERMS
        (fx, _, cx), (_, fy, cy), _ = camera.matrix.tolist()
        width, height = camera.size
        world_from_cam = np.eye(4)
        world_from_cam[:3, :3] = rig.rotation[view].T * _OPENGL_AXES
        world_from_cam[:3, 3] = rig.centres[view]
        frames.append(
            {
                "file_path": f"{_FOLDER}{camera.name}.png",
                "camera_model": "OPENCV_FISHEYE" if camera.fisheye else "OPENCV",
                **{"fl_x": fx, "fl_y": fy},
                **{"cx": cx + CORNER_OFFSET, "cy": cy + CORNER_OFFSET},
                **{"w": width, "h": height},
                **dict(zip(keys, lens_terms(camera, len(keys)), strict=True)),
                "transform_matrix": world_from_cam.tolist(),
            }
        )
    document = {
        "camera_model": frames[0]["camera_model"],
        "unit": rig.unit,
        "provenance": plain_fields(provenance),
        "frames": frames,
    }
    return Written({"transforms.json": to_json(document)}, lost)


FORMAT = Format(
    kind="cameras",
    name="nerfstudio",
    title="nerfstudio transforms.json",
    sniff=sniff,
    read=read,
    write=write,
)
