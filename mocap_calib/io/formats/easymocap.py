"""EasyMocap's pair of files in a folder, which cv2.FileStorage reads: intri.yml and extri.yml.

* Both list the cameras under `names`; the name of a camera is part of the keys of its fields
  (K_01, dist_01, Rot_01, ...), so that names are what FileStorage takes for keys.
* R_01 is a rotation vector, Rot_01 the same rotation as a matrix. Lengths are metres.
* intri.yml often has more cameras than extri.yml: these have no extrinsics.
"""

import re
from collections.abc import Mapping
from typing import Any

from mocap_calib.errors import FormatError
from mocap_calib.geometry.rotation import vector_from_matrix
from mocap_calib.io.camera_checks import make_camera, make_extrinsics
from mocap_calib.io.cameras import (
    CameraFile,
    Extrinsics,
    PlacedCamera,
    collect_cameras,
    need_names,
    terms,
)
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format, Written
from mocap_calib.io.formats.opencv import format_file, format_matrix
from mocap_calib.types import Camera, CameraRig

_INTRINSICS = "intri.yml"
_EXTRINSICS = "extri.yml"


def sniff(document: Document) -> bool:
    """Return whether this is a folder with intri.yml, or one of the two with its list of names."""
    if document.is_folder:
        return _INTRINSICS in document.names
    return document.syntax == "yaml" and re.search(r"^names\s*:", document.text, re.M) is not None


# --- reading


def parse(document: Document) -> CameraFile:
    """Read the cameras of both files, or of intri.yml alone. Raises FormatError."""
    if not document.is_folder:
        return _parse(document, None)
    extrinsics = document.of(_EXTRINSICS) if _EXTRINSICS in document.names else None
    return _parse(document.of(_INTRINSICS), extrinsics)


def _parse(intrinsics: Document, extrinsics: Document | None) -> CameraFile:
    """Read the cameras of the files. Raises FormatError."""
    places = extrinsics.mapping() if extrinsics else {}
    fields = intrinsics.mapping("names")
    names = fields["names"]
    if not isinstance(names, list):
        found = type(names).__name__
        raise FormatError(intrinsics.source, "a list of names", found, "export the cameras again")
    placed: list[PlacedCamera] = []
    for name in map(str, names):
        camera = _parse_camera(name, fields, intrinsics.source)
        place = _parse_place(name, places, extrinsics.source) if extrinsics else None
        placed.append((camera, place))
    return collect_cameras(placed, intrinsics.source, unit=str(fields.get("unit", "")))


def _parse_camera(name: str, fields: Mapping[str, Any], source: str) -> Camera:
    """Return the camera of that name without its place. Raises FormatError."""
    if f"K_{name}" not in fields:
        raise _missing_matrix(name, fields, source)
    size = None
    if {f"W_{name}", f"H_{name}"} <= fields.keys():
        size = [fields[f"W_{name}"], fields[f"H_{name}"]]
    return make_camera(
        name=name,
        size=size,
        matrix=fields[f"K_{name}"],
        distortion=fields.get(f"dist_{name}", fields.get(f"D_{name}")),
        fisheye=False,
        source=f"{source}: camera {name}",
    )


def _missing_matrix(name: str, fields: Mapping[str, Any], source: str) -> FormatError:
    """Return the complaint of a camera without a matrix, such as all of an extri.yml."""
    remedy = "mend the list"
    if any(str(key).startswith("R_") for key in fields):
        remedy = f"give a folder in which it is called {_EXTRINSICS}, beside its {_INTRINSICS}"
    expected = f"the matrix K_{name} of the camera {name} in names"
    return FormatError(source, expected, "none", remedy)


def _parse_place(name: str, fields: Mapping[str, Any], source: str) -> Extrinsics | None:
    """Return the extrinsics of the camera of that name, None where there are none.

    Raises FormatError.
    """
    rotation = fields.get(f"Rot_{name}", fields.get(f"R_{name}"))
    if rotation is None or f"T_{name}" not in fields:
        return None
    return make_extrinsics(rotation, fields[f"T_{name}"], f"{source}: camera {name}")


# --- writing


def write(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write both files. Raises MismatchError."""
    need_names(rig.names, r"[A-Za-z0-9_-]{1,80}", "letters, digits, - and _", "easymocap")
    names = ["names:", *(f'  - "{name}"' for name in rig.names)]
    intrinsics = list(names)
    extrinsics = list(names)
    for view, camera in enumerate(rig.cameras):
        intrinsics += _format_intrinsics(camera)
        rotation = rig.rotation[view]
        extrinsics += format_matrix(f"R_{camera.name}", vector_from_matrix(rotation)[:, None])
        extrinsics += format_matrix(f"Rot_{camera.name}", rotation)
        extrinsics += format_matrix(f"T_{camera.name}", rig.translation[view][:, None])
    return Written({_INTRINSICS: format_file(intrinsics), _EXTRINSICS: format_file(extrinsics)})


def _format_intrinsics(camera: Camera) -> list[str]:
    """Return the lines of a camera in intri.yml. Raises MismatchError."""
    lines = format_matrix(f"K_{camera.name}", camera.matrix)
    lines += format_matrix(f"dist_{camera.name}", terms(camera, 5, "easymocap")[None])
    if 0 not in camera.size:
        width, height = camera.size
        lines += [f"H_{camera.name}: {height}", f"W_{camera.name}: {width}"]
    return lines


FORMAT = Format(
    kind="cameras",
    name="easymocap",
    title="EasyMocap intri.yml and extri.yml",
    sniff=sniff,
    read=parse,
    write=write,
    unit="m",
    folder=True,
)
