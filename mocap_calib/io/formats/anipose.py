"""TOML of anipose and of those who took it over: Pose2Sim, FreeMoCap, caliscope.

All have a section a camera with size, matrix, distortions, rotation (a Rodrigues vector) and
translation of cam_from_world.

* anipose has cam_0, cam_1, ..., which it sorts as text, and states no unit of length.
* Pose2Sim's sections are called as the cameras, in an order that counts; sizes are floats, lengths
  metres. Sections of some names it passes over.
* FreeMoCap says where a camera stands a second time (world_position), in millimetres.
* caliscope has [cameras.0], [cameras.1], ... and goes by these numbers; lengths are metres. A
  camera may have no intrinsics, or the text "null" for its place.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import tomli_w

from mocap_calib import __version__
from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.geometry.rotation import vector_from_matrix
from mocap_calib.io.camera_checks import describe_keys, make_camera, make_extrinsics
from mocap_calib.io.cameras import (
    CameraFile,
    Extrinsics,
    PlacedCamera,
    collect_cameras,
    need_sizes,
    terms,
)
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format, Written
from mocap_calib.io.formats.own_cameras import estimated_fields
from mocap_calib.io.provenance import plain_fields, read_judgement
from mocap_calib.io.world_fields import read_world, stated_world
from mocap_calib.io.zeros import unsigned_zeros
from mocap_calib.types import Camera, CameraRig, EstimatedCamera

# sections that Pose2Sim passes over
_NOT_CAMERAS = ("metadata", "capture_volume", "charuco", "checkerboard")


def sniff_caliscope(document: Document) -> bool:
    """Return whether cameras are one level down, by number."""
    if not document.has("toml", "cameras"):
        return False
    return any("cam_id" in fields for fields in _tables(document.tree["cameras"]))


def sniff_freemocap(document: Document) -> bool:
    """Return whether the file says twice where the cameras stand."""
    if document.syntax != "toml":
        return False
    return any("world_position" in fields for fields in _tables(document.tree))


def sniff_pose2sim(document: Document) -> bool:
    """Return whether sections are named as their cameras, and sizes are no integers to TOML."""
    if document.syntax != "toml":
        return False
    cameras = [
        (name, fields)
        for name, fields in document.tree.items()
        if isinstance(fields, dict) and "matrix" in fields
    ]
    return bool(cameras) and all(_is_pose2sim_camera(name, fields) for name, fields in cameras)


def sniff_anipose(document: Document) -> bool:
    """Return whether the file is TOML of any content."""
    return document.syntax == "toml"


def parse(document: Document) -> CameraFile:
    """Read the cameras in TOML of any of the programs. Raises FormatError."""
    data = document.mapping()
    sections = list(_sections(data))
    if not sections:
        raise FormatError(
            document.source,
            "sections with a camera's size, matrix and distortions",
            describe_keys(data) or "nothing",
            "export anipose's calibration.toml",
        )
    placed: list[PlacedCamera] = []
    notes: list[str] = []
    for section, fields in sections:
        name = str(fields.get("name", section))
        if not isinstance(fields.get("matrix"), list):
            notes.append(f"camera {name} has no intrinsics and is left out")
            continue
        where = f"{document.source}: camera {name}"
        camera = _parse_camera(name, fields, where)
        placed.append((camera, _parse_extrinsics(fields, where)))
        if fields.get("rotation_count", 0) != 0:
            notes.append(
                f"camera {name} is shown turned by caliscope; its matrix is of the images as they "
                "were recorded"
            )
    metadata = _find_metadata(data)
    found = collect_cameras(
        placed, document.source, unit=str(metadata.get("unit", "")), notes=notes
    )
    return replace(
        found,
        judgement=read_judgement(metadata.get("provenance")),
        world=read_world(metadata.get("world")),
    )


def _is_pose2sim_camera(name: str, fields: Mapping[str, Any]) -> bool:
    size = fields.get("size")
    sized = isinstance(size, list) and all(isinstance(length, float) for length in size)
    return fields.get("name") == name and "fisheye" in fields and sized


def _parse_camera(name: str, fields: Mapping[str, Any], where: str) -> Camera:
    """Return a camera without its place. Raises FormatError."""
    return make_camera(
        name=name,
        size=fields.get("size"),
        matrix=fields["matrix"],
        distortion=fields.get("distortions"),
        fisheye=fields.get("fisheye", False) is True,
        source=where,
    )


def _parse_extrinsics(fields: Mapping[str, Any], where: str) -> Extrinsics | None:
    """Return the extrinsics, None where there are none. Raises FormatError.

    caliscope writes the text "null" where a camera was not placed.
    """
    rotation, translation = fields.get("rotation"), fields.get("translation")
    if not isinstance(rotation, list) or not isinstance(translation, list):
        return None
    return make_extrinsics(rotation, translation, where)


def _find_metadata(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the section `metadata`, empty where there is none."""
    metadata = data.get("metadata")
    return metadata if isinstance(metadata, dict) else {}


def _tables(data: Any) -> list[dict[str, Any]]:
    """Return the tables in a table."""
    if not isinstance(data, dict):
        return []
    return [value for value in data.values() if isinstance(value, dict)]


def _sections(data: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield (name, fields) of tables with a matrix, at the top or one below.

    Those of caliscope are one below ([cameras.0]), and one may lack its matrix.
    """
    for name, table in data.items():
        if not isinstance(table, dict):
            continue
        if isinstance(table.get("matrix"), list):
            yield name, table
            continue
        for inner_name, inner in table.items():
            if isinstance(inner, dict) and (
                isinstance(inner.get("matrix"), list) or "cam_id" in inner
            ):
                yield inner_name, inner


# --- writing


def write_anipose(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write aniposelib's calibration.toml, which carries all."""
    return Written({"calibration.toml": format_calibration_toml(rig, provenance).encode()})


def write_pose2sim(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write Pose2Sim's Calib.toml, which goes by the order of the cameras. Raises MismatchError."""
    need_sizes(rig, "pose2sim")
    sections = {}
    for view, camera in enumerate(rig.cameras):
        if camera.name in _NOT_CAMERAS:
            raise MismatchError(
                "pose2sim",
                f"camera names other than {', '.join(_NOT_CAMERAS)}",
                camera.name,
                "rename the camera",
            )
        sections[camera.name] = toml_fields(rig, view) | {
            "size": [float(length) for length in camera.size],
            "distortions": _pose2sim_terms(camera),
            "fisheye": False,
        }
    return Written({"Calib.toml": _dump_with_metadata(sections, rig, provenance)})


def _pose2sim_terms(camera: Camera) -> list[float]:
    """Return 4, 5 or 8 terms: Pose2Sim's own files have four, it reads as many as there are."""
    padded = terms(camera, 8, "pose2sim")
    if padded[5:].any():
        return padded.tolist()
    return padded[: 5 if padded[4] else 4].tolist()


def write_freemocap(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write FreeMoCap's calibration, in its order of fields. Raises MismatchError."""
    need_sizes(rig, "freemocap")
    sections = {}
    for view, camera in enumerate(rig.cameras):
        sections[f"cam_{view}"] = toml_fields(rig, view) | {
            "distortions": terms(camera, 5, "freemocap").tolist(),
            "id": camera.name,
            "index": view,
            "world_orientation": rig.rotation[view].T.tolist(),
            "world_position": rig.centres[view].tolist(),
        }
    return Written({"calibration.toml": _dump_with_metadata(sections, rig, provenance)})


def write_caliscope(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write caliscope's camera_array.toml; names that are no numbers stand beside its numbers.

    Raises MismatchError.
    """
    need_sizes(rig, "caliscope")
    numbered = all(_is_number(name) for name in rig.names)
    cameras = {}
    for view, camera in enumerate(rig.cameras):
        number = camera.name if numbered else str(view)
        own = {"cam_id": int(number), "rotation_count": 0, "ignore": False}
        cameras[number] = (
            own
            | toml_fields(rig, view)
            | {"distortions": _caliscope_terms(camera), "fisheye": camera.fisheye}
        )
    lost = () if numbered else ("the cameras' names, to caliscope itself: it counts them from 0",)
    content = _dump_with_metadata({"cameras": cameras}, rig, provenance)
    return Written({"camera_array.toml": content}, lost)


def _is_number(name: str) -> bool:
    """Return whether a name is a whole number as caliscope spells it."""
    return name.isascii() and name.isdigit() and str(int(name)) == name


def _caliscope_terms(camera: Camera) -> list[float]:
    if camera.fisheye:
        return camera.distortion.tolist()
    return terms(camera, 5, "caliscope").tolist()


def _dump_with_metadata(
    sections: Mapping[str, Any], rig: CameraRig, provenance: Mapping[str, Any]
) -> bytes:
    metadata = anipose_metadata(rig, provenance) | {"provenance": plain_fields(provenance)}
    return dump_toml({**sections, "metadata": metadata}).encode()


def format_calibration_toml(rig: CameraRig, provenance: Mapping[str, Any]) -> str:
    """Return the file of anipose; rotations are Rodrigues vectors, lengths in the rig's unit."""
    sections: dict[str, Any] = {}
    digits = len(str(len(rig.cameras) - 1))  # aniposelib sorts the sections as text
    for view, camera in enumerate(rig.cameras):
        fisheye = {"fisheye": True} if camera.fisheye else {}
        sections[f"cam_{view:0{digits}}"] = toml_fields(rig, view) | fisheye
    metadata = anipose_metadata(rig, provenance) | {"generator": f"mocap-calib {__version__}"}
    estimated = estimated_intrinsics(rig)
    if estimated:
        metadata["estimated_intrinsics"] = estimated
    if provenance:
        metadata["provenance"] = plain_fields(provenance)
    return dump_toml(sections | {"metadata": metadata})


def estimated_intrinsics(rig: CameraRig) -> dict[str, dict[str, float]]:
    """Return, by camera, how sure the intrinsics are that were estimated from the recording."""
    return {
        camera.name: estimated_fields(camera)
        for camera in rig.cameras
        if isinstance(camera, EstimatedCamera)
    }


def format_intrinsics_toml(cameras: tuple[Camera, ...]) -> str:
    """Return the file of anipose without the keys that say where cameras stand."""
    sections = {}
    for view, camera in enumerate(cameras):
        fisheye = {"fisheye": True} if camera.fisheye else {}
        sections[f"cam_{view}"] = _intrinsic_fields(camera) | fisheye
    return dump_toml(sections)


def toml_fields(rig: CameraRig, view: int) -> dict[str, Any]:
    """Return the fields of a camera that anipose and its descendants share, in their order."""
    return _intrinsic_fields(rig.cameras[view]) | {
        "rotation": vector_from_matrix(rig.rotation[view]).tolist(),
        "translation": rig.translation[view].tolist(),
    }


def anipose_metadata(rig: CameraRig, provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Return what anipose says of its cameras: adjusted to the animal's points, and the error.

    anipose calls error the median over the points of the mean reprojection error over the cameras,
    in pixels, and leaves out what it does not know (calibrate.py).
    """
    metadata: dict[str, Any] = {"adjusted": bool(provenance.get("adjusted", False))}
    if "reprojection_error_px" in provenance:
        metadata["error"] = provenance["reprojection_error_px"]
    # in here: aniposelib takes every other table of a file for a camera
    return metadata | {"unit": rig.unit, **stated_world(rig.world, rig.unit)}


def _intrinsic_fields(camera: Camera) -> dict[str, Any]:
    return {
        "name": camera.name,
        "size": list(camera.size),
        "matrix": camera.matrix.tolist(),
        "distortions": camera.distortion.tolist(),
    }


def dump_toml(document: Mapping[str, Any]) -> str:
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
    kind="cameras",
    name="caliscope",
    title="caliscope camera_array.toml",
    sniff=sniff_caliscope,
    read=parse,
    write=write_caliscope,
    unit="m",
)
FREEMOCAP = Format(
    kind="cameras",
    name="freemocap",
    title="FreeMoCap calibration.toml",
    sniff=sniff_freemocap,
    read=parse,
    write=write_freemocap,
    unit="mm",
)
POSE2SIM = Format(
    kind="cameras",
    name="pose2sim",
    title="Pose2Sim Calib.toml",
    sniff=sniff_pose2sim,
    read=parse,
    write=write_pose2sim,
    unit="m",
)
ANIPOSE = Format(
    kind="cameras",
    name="anipose",
    title="anipose calibration.toml",
    sniff=sniff_anipose,
    read=parse,
    write=write_anipose,
    endings=(".toml",),
)
