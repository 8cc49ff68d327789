"""nerfstudio's transforms.json: one frame an image, which is a camera here.

* transform_matrix is camera_to_world in OpenGL's axes: x right, y up, z back.
* Pixels have their corners at integers, so that cx and cy are half a pixel more than ours.
* What a frame does not state (intrinsics, camera model) stands at the top and holds for all.
* There is no unit of length; `unit` at the top states ours.
"""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from mocap_calib.config import CORNER_OFFSET
from mocap_calib.errors import FormatError
from mocap_calib.io.cameras import (
    CameraFile,
    RawCamera,
    camera_of_image,
    check_rig,
    collect_cameras,
    entries,
    lens_terms,
    numbers,
    pinhole_matrix,
    pinhole_terms,
    to_json,
)
from mocap_calib.io.document import Document, need
from mocap_calib.io.format import Format, Written
from mocap_calib.io.provenance import plain_fields
from mocap_calib.types import CameraRig

_OPENGL_AXES = np.array([1.0, -1.0, -1.0])
_PINHOLE_TERMS = ("k1", "k2", "p1", "p2", "k3")
_TERMS = {  # of each camera model
    **dict.fromkeys(("OPENCV", "PINHOLE", "SIMPLE_PINHOLE"), _PINHOLE_TERMS),
    "OPENCV_FISHEYE": ("k1", "k2", "k3", "k4"),
}
_FOLDER = "images/"


def read(document: Document) -> CameraFile:
    """Read the frames as cameras, called after their images. Raises FormatError."""
    shared = dict(document.mapping("frames"))
    raws = [
        _read_frame(shared | {"file_path": number} | frame, f"{document.source}: frame {number}")
        for number, frame in entries(shared["frames"], document.source, "transform_matrix")
    ]
    unit, provenance = shared.get("unit", ""), shared.get("provenance")
    return collect_cameras(raws, document.source, unit=unit, provenance=provenance)


def _read_frame(fields: Mapping[str, Any], where: str) -> RawCamera:
    """Return the camera of a frame. Raises FormatError."""
    need(fields, ("fl_x", "cx", "cy"), where)
    model = str(fields.get("camera_model", "OPENCV"))
    if model not in _TERMS:
        expected = f"the camera_model {', '.join(_TERMS)}"
        raise FormatError(where, expected, model, "undistort, or choose another model")
    if "k4" not in _TERMS[model] and fields.get("k4"):
        expected = "k1, k2, k3, p1, p2 of OpenCV's model"
        raise FormatError(where, expected, "a k4", "calibrate without it")
    middle = numbers([fields["cx"], fields["cy"]], "numbers cx and cy", where, 2) - CORNER_OFFSET
    # world_from_cam: its translation is the camera's centre
    transform = numbers(fields["transform_matrix"], "a 4 x 4 transform_matrix", where, 12, 16)
    turned, centre = np.split(transform.reshape(-1, 4)[:3], [3], axis=1)
    name = str(fields["file_path"]).removeprefix("./").removeprefix(_FOLDER)
    return RawCamera(
        name=camera_of_image(name),
        size=[fields.get("w"), fields.get("h")],
        matrix=pinhole_matrix(fields["fl_x"], fields.get("fl_y") or fields["fl_x"], *middle),
        distortion=[fields.get(key, 0.0) for key in _TERMS[model]],
        fisheye=model == "OPENCV_FISHEYE",
        rotation=(turned * _OPENGL_AXES).T,
        centre=centre,
    )


def write(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write one frame a camera; its image is called images/NAME.png. Raises MismatchError."""
    lost = check_rig(rig, provenance, "nerfstudio", terms=5, fisheye=True, sizes="needed")
    frames = []
    for camera in rig:
        model = "OPENCV_FISHEYE" if camera.fisheye else "OPENCV"
        fx, fy, cx, cy = pinhole_terms(camera)
        keys = _TERMS[model]
        turned = np.column_stack([camera.rotation.T * _OPENGL_AXES, camera.centre])
        frames.append(
            {
                "file_path": f"{_FOLDER}{camera.name}.png",
                "camera_model": model,
                **{"fl_x": fx, "fl_y": fy, "cx": cx + CORNER_OFFSET, "cy": cy + CORNER_OFFSET},
                **dict(zip("wh", camera.size, strict=True)),
                **dict(zip(keys, lens_terms(camera, len(keys)).tolist(), strict=True)),
                "transform_matrix": np.vstack([turned, [0.0, 0.0, 0.0, 1.0]]),
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
    name="nerfstudio",
    title="nerfstudio transforms.json",
    sniff=partial(Document.has_entry, keys=["transform_matrix"]),
    read=read,
    write=write,
)
