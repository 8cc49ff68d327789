"""4D-Association's calibration.json: cameras by number, in metres.

K has the 9 numbers of the camera matrix and RT the 12 of [R t], row after row. There is no
distortion, as its images are undistorted, and there are no names.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.camera_checks import make_camera, make_extrinsics, numbers
from mocap_calib.io.cameras import (
    CameraFile,
    PlacedCamera,
    cannot,
    collect_cameras,
    entries,
    has_json_entry,
    need_sizes,
    terms,
    to_json,
    without_verdict,
)
from mocap_calib.io.document import Document, need
from mocap_calib.io.format import Format, Written
from mocap_calib.types import Camera, CameraRig, Floats

_KEYS = ("K", "RT", "imgSize")


def sniff(document: Document) -> bool:
    """Return whether there are cameras with K and RT."""
    return has_json_entry(document, *_KEYS)


def parse(document: Document) -> CameraFile:
    """Read the cameras, which are called by their numbers. Raises FormatError."""
    named = entries(document.tree, "cameras by number", document.source)
    placed = [_parse_camera(name, fields, document.source) for name, fields in named]
    return collect_cameras(placed, document.source)


def _parse_camera(name: str, fields: Mapping[str, Any], source: str) -> PlacedCamera:
    """Return a camera and its extrinsics. Raises FormatError."""
    where = f"{source}: camera {name}"
    need(fields, _KEYS, where)
    matrix = numbers(fields["K"], "9 numbers K", where)
    transform = numbers(fields["RT"], "12 numbers RT", where)
    if matrix.size != 9 or transform.size != 12:
        found = f"{matrix.size} and {transform.size}"
        raise FormatError(where, "9 numbers K and 12 RT", found, "mend them")
    camera = make_camera(
        name=name,
        size=fields["imgSize"],
        matrix=matrix.reshape(3, 3),
        distortion=[],
        fisheye=False,
        source=where,
    )
    transform = transform.reshape(3, 4)
    return camera, make_extrinsics(transform[:, :3], transform[:, 3], where)


def write(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write the cameras by number.

    Raises MismatchError, also where a camera has a distortion.
    """
    need_sizes(rig, "4d-association")
    cameras = {
        str(view): _fields(camera, rig.rotation[view], rig.translation[view])
        for view, camera in enumerate(rig.cameras)
    }
    numbered = rig.names == tuple(cameras)
    lost = () if numbered else ("the cameras' names: they are counted from 0",)
    return Written({"calibration.json": to_json(cameras)}, (*lost, *without_verdict(provenance)))


def _fields(camera: Camera, rotation: Floats, translation: Floats) -> dict[str, Any]:
    """Return the fields of a camera. Raises MismatchError.

    rotation: `[3, 3]` and translation: `[3]` of cam_from_world.
    """
    if terms(camera, 8, "4d-association").any():
        raise cannot(
            "4d-association",
            camera.name,
            "a camera without distortion",
            camera.distortion.tolist(),
            "undistort the images first",
        )
    return {
        "K": camera.matrix.ravel().tolist(),
        "RT": np.column_stack([rotation, translation]).ravel().tolist(),
        "imgSize": list(camera.size),
    }


FORMAT = Format(
    kind="cameras",
    name="4d-association",
    title="4D-Association JSON",
    sniff=sniff,
    read=parse,
    write=write,
    unit="m",
)
