"""TOML of anipose and of its descendants: Pose2Sim, FreeMoCap, caliscope.

All have a section a camera with size, matrix, distortions, rotation (a Rodrigues vector) and
translation of cam_from_world.

* anipose has cam_0, cam_1, ..., which it sorts as text, and states no unit of length.
* Pose2Sim's sections are called as the cameras, in an order that counts; sizes are floats, lengths
  metres. Sections of some names it passes over.
* FreeMoCap states the position of a camera a second time (world_position), in millimetres.
* caliscope has [cameras.0], [cameras.1], ... and goes by these numbers; lengths are metres. A
  camera may have no intrinsics, or the text "null" for its extrinsics.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import tomli_w

from mocap_calib import __version__
from mocap_calib.geometry.rotation import vector_from_matrix
from mocap_calib.io.camera_fields import camera_fields, has_matrix
from mocap_calib.io.cameras import (
    CameraFile,
    RawCamera,
    check_rig,
    collect_cameras,
    lens_terms,
)
from mocap_calib.io.document import Document, describe_names
from mocap_calib.io.file import unsigned_zeros
from mocap_calib.io.format import Format, Written
from mocap_calib.io.formats.own_cameras import estimated_fields
from mocap_calib.io.provenance import plain_fields
from mocap_calib.io.world_fields import read_world, stated_world
from mocap_calib.types import Camera, CameraRig, EstimatedCamera, PosedCamera

# sections that Pose2Sim passes over
_NOT_CAMERAS = ("metadata", "capture_volume", "charuco", "checkerboard")
# beside the cameras, and of a camera: caliscope's, and FreeMoCap's pose a second time
_PASSED_OVER = (
    *(*_NOT_CAMERAS, "cam_id", "port", "ignore", "error", "grid_count", "exposure"),
    *("index", "world_orientation", "world_position"),
)
_CAMERA_NAMES = (
    rf"(?s:(?!(?:{'|'.join(_NOT_CAMERAS)})$).*)",
    f"other words than {', '.join(_NOT_CAMERAS)}",
)


def _has_section(document: Document, key: str, below: str = "") -> bool:
    """Return whether any section of TOML, or of its section `below`, has the key."""
    tree = document.tree if document.syntax == "toml" else {}
    return any(key in fields for _, fields in _tables(tree.get(below) if below else tree))


def sniff_pose2sim(document: Document) -> bool:
    """Return whether sections are named as their cameras, and sizes are no integers to TOML."""
    tree = document.tree if document.syntax == "toml" else {}
    cameras = [(name, fields) for name, fields in _tables(tree) if "matrix" in fields]
    return bool(cameras) and all(_is_pose2sim_camera(name, fields) for name, fields in cameras)


def _is_pose2sim_camera(name: str, fields: Mapping[str, Any]) -> bool:
    size = fields.get("size")
    sized = isinstance(size, list) and all(isinstance(length, float) for length in size)
    return fields.get("name") == name and "fisheye" in fields and sized


def _tables(data: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield (name, fields) of the tables in a table."""
    if isinstance(data, dict):
        yield from ((name, table) for name, table in data.items() if isinstance(table, dict))


# --- reading


def read(document: Document) -> CameraFile:
    """Read the cameras in TOML of any of the programs. Raises FormatError."""
    data = document.mapping()
    sections = list(_sections(data))
    if not sections:
        expected, remedy = (
            "sections with a camera's size, matrix and distortions",
            "export it again",
        )
        raise document.refuse(expected, describe_names(data), remedy)
    raws: list[RawCamera] = []
    notes: list[str] = []
    for section, fields in sections:
        name = str(fields.get("name", section))
        if not has_matrix(fields):
            notes.append(f"camera {name} has no intrinsics and is left out")
            continue
        if fields.get("rotation_count", 0) != 0:
            notes.append(
                f"camera {name} is shown turned by caliscope; its matrix is of the images as they "
                "were recorded"
            )
        found = camera_fields(fields, f"{document.source}: camera {name}")
        # caliscope writes the text "null" where it has no extrinsics
        found = {key: None if value == "null" else value for key, value in found.items()}
        raws.append(RawCamera(name=name, **found))
    metadata = dict(_tables(data)).get("metadata", {})
    unit, provenance = metadata.get("unit", ""), metadata.get("provenance")
    cameras = collect_cameras(raws, document.source, unit=unit, notes=notes, provenance=provenance)
    return replace(cameras, world=read_world(metadata.get("world")))


def _sections(data: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield (name, fields) of tables with a matrix, at the top or one below.

    Those of caliscope are one below ([cameras.0]), and one may lack its matrix.
    """
    for name, table in _tables(data):
        if has_matrix(table):
            yield name, table
            continue
        for inner_name, inner in _tables(table):
            if has_matrix(inner) or "cam_id" in inner:
                yield inner_name, inner


# --- writing


def write_anipose(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write aniposelib's calibration.toml, which carries all."""
    return Written({"calibration.toml": format_calibration_toml(rig, provenance).encode()})


def format_calibration_toml(rig: CameraRig, provenance: Mapping[str, Any]) -> str:
    """Return the file of anipose; rotations are Rodrigues vectors, lengths in the rig's unit."""
    digits = len(str(len(rig.cameras) - 1))  # aniposelib sorts the sections as text
    sections = {
        f"cam_{view:0{digits}}": _fields(camera) | {"fisheye": camera.fisheye or None}
        for view, camera in enumerate(rig)
    }
    estimated = {
        camera.name: estimated_fields(camera)
        for camera in rig.cameras
        if isinstance(camera, EstimatedCamera)
    }
    more = {"generator": f"mocap-calib {__version__}", "estimated_intrinsics": estimated or None}
    return _format(sections, rig, provenance, more)


def format_intrinsics_toml(cameras: tuple[Camera, ...]) -> str:
    """Return the file of anipose without the keys of the extrinsics."""
    return _dump_toml(
        {
            f"cam_{view}": _intrinsics(camera) | {"fisheye": camera.fisheye or None}
            for view, camera in enumerate(cameras)
        }
    )


def write_pose2sim(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write Pose2Sim's Calib.toml, which goes by the order of the cameras. Raises MismatchError."""
    lost = check_rig(rig, provenance, "pose2sim", sizes="needed", names=_CAMERA_NAMES)
    sections = {}
    for camera in rig:
        terms = lens_terms(camera, 8)  # its own files have 4, it reads as many as there are
        count = max(4, int(terms.nonzero()[0].max(initial=0)) + 1)
        sections[camera.name] = _fields(camera) | {
            "size": [float(length) for length in camera.size],
            "distortions": terms[: count if count < 6 else 8],
            "fisheye": False,
        }
    return Written({"Calib.toml": _format(sections, rig, provenance).encode()}, lost)


def write_freemocap(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write FreeMoCap's calibration, in its order of fields. Raises MismatchError."""
    lost = check_rig(rig, provenance, "freemocap", terms=5, sizes="needed")
    sections = {
        f"cam_{view}": _fields(camera)
        | {
            "distortions": lens_terms(camera, 5),
            "id": camera.name,
            "index": view,
            "world_orientation": camera.rotation.T,
            "world_position": camera.centre,
        }
        for view, camera in enumerate(rig)
    }
    return Written({"calibration.toml": _format(sections, rig, provenance).encode()}, lost)


def write_caliscope(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write caliscope's camera_array.toml; names that are no numbers stand beside its numbers.

    Raises MismatchError.
    """
    lost = check_rig(rig, provenance, "caliscope", terms=5, fisheye=True, sizes="needed")
    numbered = all(re.fullmatch("0|[1-9][0-9]*", name) for name in rig.names)
    cameras = {}
    for view, camera in enumerate(rig):
        number = int(camera.name) if numbered else view
        cameras[str(number)] = {
            **{"cam_id": number, "rotation_count": 0, "ignore": False},
            **_fields(camera),
            "distortions": lens_terms(camera, 4 if camera.fisheye else 5),
            "fisheye": camera.fisheye,
        }
    if not numbered:
        lost = (*lost, "the cameras' names, to caliscope itself: it counts them from 0")
    content = _format({"cameras": cameras}, rig, provenance).encode()
    return Written({"camera_array.toml": content}, lost)


def _intrinsics(camera: Camera) -> dict[str, Any]:
    return {
        "name": camera.name,
        "size": camera.size,
        "matrix": camera.matrix,
        "distortions": camera.distortion,
    }


def _fields(camera: PosedCamera) -> dict[str, Any]:
    """Return the fields of a camera that anipose and its descendants share, in their order."""
    rotation = vector_from_matrix(camera.rotation)
    return _intrinsics(camera) | {"rotation": rotation, "translation": camera.translation}


def _format(
    sections: Mapping[str, Any],
    rig: CameraRig,
    provenance: Mapping[str, Any],
    more: Mapping[str, Any] | None = None,
) -> str:
    """Return a file of the sections and of what anipose states of its cameras (`metadata`).

    That is whether they were adjusted to the animal's points, and the error: the median over the
    points of the mean reprojection error over the cameras, in pixels, which anipose leaves out
    where it does not know it (calibrate.py).

    more: further metadata.
    """
    # in here: aniposelib takes every other table of a file for a camera
    metadata = {
        "adjusted": bool(provenance.get("adjusted", False)),
        "error": provenance.get("reprojection_error_px"),
        "unit": rig.unit,
        **stated_world(rig.world, rig.unit),
        **(more or {}),
        "provenance": plain_fields(provenance) or None,
    }
    return _dump_toml({**sections, "metadata": metadata})


def _dump_toml(document: Mapping[str, Any]) -> str:
    """Return a document as TOML: of each table its values first, then the tables in it.

    TOML has no null: fields and entries that are None are left out.
    """
    return tomli_w.dumps(_without_none(unsigned_zeros(document)))


def _without_none(value: Any) -> Any:
    """Return the value without the fields and entries that are None, at any depth."""
    if isinstance(value, Mapping):
        return {key: _without_none(each) for key, each in value.items() if each is not None}
    if isinstance(value, list):
        return [_without_none(each) for each in value if each is not None]
    return value


CALISCOPE = Format(
    name="caliscope",
    title="caliscope camera_array.toml",
    sniff=partial(_has_section, key="cam_id", below="cameras"),
    read=read,
    passed_over=_PASSED_OVER,
    write=write_caliscope,
    unit="m",
)
FREEMOCAP = Format(
    name="freemocap",
    title="FreeMoCap calibration.toml",
    sniff=partial(_has_section, key="world_position"),
    read=read,
    passed_over=_PASSED_OVER,
    write=write_freemocap,
    unit="mm",
)
POSE2SIM = Format(
    name="pose2sim",
    title="Pose2Sim Calib.toml",
    sniff=sniff_pose2sim,
    read=read,
    passed_over=_PASSED_OVER,
    write=write_pose2sim,
    unit="m",
)
ANIPOSE = Format(
    name="anipose",
    title="anipose calibration.toml",
    sniff=partial(Document.has, syntax="toml"),
    read=read,
    passed_over=_PASSED_OVER,
    write=write_anipose,
    endings=(".toml",),
)
