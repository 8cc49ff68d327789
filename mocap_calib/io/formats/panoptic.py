"""CMU Panoptic's calibration JSON: a list of cameras in centimetres.

`distCoef` has k1 k2 p1 p2 k3; a camera may lack its resolution, or its place (R and t).
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from mocap_calib.io.camera_checks import make_camera
from mocap_calib.io.cameras import (
    CameraFile,
    PlacedCamera,
    collect_cameras,
    entries,
    extrinsics_if_given,
    has_json_item,
    need_sizes,
    terms,
    to_json,
)
from mocap_calib.io.document import Document, need
from mocap_calib.io.format import Format, Written
from mocap_calib.io.provenance import plain_fields, read_judgement
from mocap_calib.types import CameraRig


def sniff(document: Document) -> bool:
    """Return whether there is a list of cameras with distCoef."""
    return has_json_item(document, "cameras", "distCoef")


def parse(document: Document) -> CameraFile:
    """Read the cameras. Raises FormatError."""
    data = document.mapping("cameras")
    placed: list[PlacedCamera] = []
    for number, fields in entries(data["cameras"], "a list of cameras", document.source):
        name = str(fields.get("name", number))
        where = f"{document.source}: camera {name}"
        need(fields, ("K", "distCoef"), where)
        camera = make_camera(
            name=name,
            size=fields.get("resolution"),
            matrix=fields["K"],
            distortion=fields["distCoef"],
            fisheye=False,
            source=where,
        )
        placed.append((camera, extrinsics_if_given(fields, where)))
    found = collect_cameras(placed, document.source)
    return replace(found, judgement=read_judgement(data.get("provenance")))


def write(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write the fields that the data set's cameras have. Raises MismatchError."""
    need_sizes(rig, "panoptic")
    cameras = [
        {
            "name": camera.name,
            "type": "hd",
            "resolution": list(camera.size),
            "panel": 0,
            "node": view,
            "K": camera.matrix.tolist(),
            "distCoef": terms(camera, 5, "panoptic").tolist(),
            "R": rig.rotation[view].tolist(),
            "t": rig.translation[view][:, None].tolist(),
        }
        for view, camera in enumerate(rig.cameras)
    ]
    about = {"calibDataSource": "mocap-calib", "provenance": plain_fields(provenance)}
    document = {**about, "cameras": cameras}
    return Written({"calibration.json": to_json(document)})


FORMAT = Format(
    kind="cameras",
    name="panoptic",
    title="CMU Panoptic JSON",
    sniff=sniff,
    read=parse,
    write=write,
    unit="cm",
)
