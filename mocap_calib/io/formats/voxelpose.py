"""VoxelPose's calibration JSON (Campus, Shelf, Panoptic in its own layout), in millimetres.

* Cameras are entries by number, or the list of one sequence.
* T is the camera's centre and no translation: x = R (X - T).
* k has k1 k2 k3 and p has p1 p2; both may be missing. There are no image sizes.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.camera_checks import make_camera, numbers
from mocap_calib.io.cameras import (
    CameraFile,
    PlacedCamera,
    collect_cameras,
    entries,
    extrinsics_from_centre,
    has_json_entry,
    pinhole_matrix,
    terms,
    to_json,
    without_sizes,
    without_verdict,
)
from mocap_calib.io.document import Document, need
from mocap_calib.io.format import Format, Written
from mocap_calib.types import Camera, CameraRig, Floats

_PINHOLE = ("fx", "fy", "cx", "cy")
_KEYS = ("R", "T", *_PINHOLE)


def sniff(document: Document) -> bool:
    """Return whether there are cameras with fx and T, by number or in a sequence's list."""
    return has_json_entry(document, *_KEYS)


# --- reading


def parse(document: Document) -> CameraFile:
    """Read the cameras. Raises FormatError."""
    data: Any = document.mapping()
    sequences = [value for value in data.values() if isinstance(value, list)]
    if len(sequences) > 1:
        found = f"{len(sequences)} sequences"
        remedy = "keep one of them in the file"
        raise FormatError(document.source, "the cameras of one sequence", found, remedy)
    cameras = sequences[0] if sequences else data
    placed: list[PlacedCamera] = []
    for number, fields in entries(cameras, "cameras by number", document.source):
        name = str(fields.get("name", number))
        where = f"{document.source}: camera {name}"
        need(fields, _KEYS, where)
        camera = make_camera(
            name=name,
            size=None,
            matrix=pinhole_matrix(*(fields[key] for key in _PINHOLE)),
            distortion=_parse_distortion(fields, where),
            fisheye=False,
            source=where,
        )
        placed.append((camera, extrinsics_from_centre(fields["R"], fields["T"], where)))
    return collect_cameras(placed, document.source)


def _parse_distortion(fields: Mapping[str, Any], where: str) -> Floats:
    """Return `[5]` k1 k2 p1 p2 k3, 0 where they are missing. Raises FormatError."""
    radial = numbers(fields.get("k", []), "the distortion k", where).reshape(-1)
    tangential = numbers(fields.get("p", []), "the distortion p", where).reshape(-1)
    if len(radial) not in (0, 3) or len(tangential) not in (0, 2):
        found = f"{len(radial)} and {len(tangential)}"
        raise FormatError(where, "three k and two p", found, "mend the distortion")
    distortion = np.zeros(5)
    if len(radial):
        distortion[[0, 1, 4]] = radial
    if len(tangential):
        distortion[2:4] = tangential
    return distortion


# --- writing


def write(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write the cameras by number, as its data sets are read, with their names.

    Raises MismatchError.
    """
    cameras = {
        str(view): _fields(camera, rotation=rig.rotation[view], centre=rig.centres[view])
        for view, camera in enumerate(rig.cameras)
    }
    return Written(
        {"calibration.json": to_json(cameras)}, (*without_sizes(rig), *without_verdict(provenance))
    )


def _fields(camera: Camera, *, rotation: Floats, centre: Floats) -> dict[str, Any]:
    """Return the fields of a camera. Raises MismatchError.

    rotation: `[3, 3]` of cam_from_world. centre: `[3]` in world coordinates.
    """
    k1, k2, p1, p2, k3 = terms(camera, 5, "voxelpose").tolist()
    (fx, _, cx), (_, fy, cy), _ = camera.matrix.tolist()
    return {
        "name": camera.name,
        "R": rotation.tolist(),
        "T": centre[:, None].tolist(),
        "fx": fx,
        "fy": fy,
        "cx": cx,
        "cy": cy,
        "k": [[k1], [k2], [k3]],
        "p": [[p1], [p2]],
    }


FORMAT = Format(
    kind="cameras",
    name="voxelpose",
    title="VoxelPose JSON",
    sniff=sniff,
    read=parse,
    write=write,
    unit="mm",
)
