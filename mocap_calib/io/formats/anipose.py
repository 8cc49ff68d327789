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

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import tomli_w

from mocap_calib import __version__
from mocap_calib.geometry.rotation import vector_from_matrix
from mocap_calib.io.camera_checks import describe_keys
from mocap_calib.io.cameras import CameraFile, RawCamera, check_rig, collect_cameras, lens_terms
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format, Written
from mocap_calib.io.formats.own_cameras import estimated_fields
from mocap_calib.io.provenance import plain_fields
from mocap_calib.io.world_fields import read_world, stated_world
from mocap_calib.io.zeros import unsigned_zeros
from mocap_calib.types import Camera, CameraRig, EstimatedCamera

# sections that Pose2Sim passes over
_NOT_CAMERAS = ("metadata", "capture_volume", "charuco", "checkerboard")
_CAMERA_NAMES = (
    rf"(?s:(?!(?:{'|'.join(_NOT_CAMERAS)})$).*)",
    f"other words than {', '.join(_NOT_CAMERAS)}",
)


def sniff_caliscope(document: Document) -> bool:
    """Return whether cameras are one level down, by number."""
    if not document.has("toml", "cameras"):
        return False
    return any("cam_id" in fields for _, fields in _tables(document.tree["cameras"]))


def sniff_freemocap(document: Document) -> bool:
    """Return whether the file states the positions of the cameras twice."""
    if document.syntax != "toml":
        return False
    return any("world_position" in fields for _, fields in _tables(document.tree))


def sniff_pose2sim(document: Document) -> bool:
    """Return whether sections are named as their cameras, and sizes are no integers to TOML."""
    if document.syntax != "toml":
        return False
    cameras = [(name, fields) for name, fields in _tables(document.tree) if "matrix" in fields]
    return bool(cameras) and all(_is_pose2sim_camera(name, fields) for name, fields in cameras)


def _is_pose2sim_camera(name: str, fields: Mapping[str, Any]) -> bool:
    size = fields.get("size")
    sized = isinstance(size, list) and all(isinstance(length, float) for length in size)
    return fields.get("name") == name and "fisheye" in fields and sized


def sniff_anipose(document: Document) -> bool:
    """Return whether the file is TOML of any content."""
    return document.syntax == "toml"


def _tables(data: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield (name, fields) of the tables in a table."""
    if isinstance(data, dict):
        yield from ((name, table) for name, table in data.items() if isinstance(table, dict))


# --- reading


def read(document: Document) -> CameraFile:
    """Read the cameras in TOML of any of the programs. Raises FormatError."""
    data = document.mapping()
    raws: list[RawCamera] = []
    notes: list[str] = []
    sections = False
    for section, fields in _sections(data):
        sections = True
        name = str(fields.get("name", section))
        if not isinstance(fields.get("matrix"), list):
            notes.append(f"camera {name} has no intrinsics and is left out")
            continue
        if fields.get("rotation_count", 0) != 0:
            notes.append(
                f"camera {name} is shown turned by caliscope; its matrix is of the images as they "
                "were recorded"
            )
        raws.append(_raw_camera(name, fields))
    if not sections:
        expected = "sections with a camera's size, matrix and distortions"
        found = describe_keys(data) or "nothing"
        raise document.refuse(expected, found, "export anipose's calibration.toml")
    metadata = dict(_tables(data)).get("metadata", {})
    unit, provenance = metadata.get("unit", ""), metadata.get("provenance")
    found_cameras = collect_cameras(
        raws, document.source, unit=unit, notes=notes, provenance=provenance
    )
    return replace(found_cameras, world=read_world(metadata.get("world")))


def _sections(data: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield (name, fields) of tables with a matrix, at the top or one below.

    Those of caliscope are one below ([cameras.0]), and one may lack its matrix.
    """
    for name, table in _tables(data):
        if isinstance(table.get("matrix"), list):
            yield name, table
            continue
        for inner_name, inner in _tables(table):
            if isinstance(inner.get("matrix"), list) or "cam_id" in inner:
                yield inner_name, inner


def _raw_camera(name: str, fields: Mapping[str, Any]) -> RawCamera:
    """Return a camera; caliscope writes the text "null" where it has no extrinsics."""
    rotation, translation = fields.get("rotation"), fields.get("translation")
    placed = isinstance(rotation, list) and isinstance(translation, list)
    return RawCamera(
        name=name,
        size=fields.get("size"),
        matrix=fields["matrix"],
        distortion=fields.get("distortions"),
        fisheye=fields.get("fisheye", False) is True,
        rotation=rotation if placed else None,
        translation=translation,
    )


# --- writing


def write_anipose(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write aniposelib's calibration.toml, which carries all."""
    return Written({"calibration.toml": format_calibration_toml(rig, provenance).encode()})


def format_calibration_toml(rig: CameraRig, provenance: Mapping[str, Any]) -> str:
    """Return the file of anipose; rotations are Rodrigues vectors, lengths in the rig's unit."""
    digits = len(str(len(rig.cameras) - 1))  # aniposelib sorts the sections as text
    sections = {
        f"cam_{view:0{digits}}": _fields(rig, view) | ({"fisheye": True} if each.fisheye else {})
        for view, each in enumerate(rig.cameras)
    }
    metadata = _metadata(rig, provenance) | {"generator": f"mocap-calib {__version__}"}
    estimated = {
        camera.name: estimated_fields(camera)
        for camera in rig.cameras
        if isinstance(camera, EstimatedCamera)
    }
    if estimated:
        metadata["estimated_intrinsics"] = estimated
    if provenance:
        metadata["provenance"] = plain_fields(provenance)
    return _dump_toml(sections | {"metadata": metadata})


def format_intrinsics_toml(cameras: tuple[Camera, ...]) -> str:
    """Return the file of anipose without the keys of the extrinsics."""
    return _dump_toml(
        {
            f"cam_{view}": _intrinsics(camera) | ({"fisheye": True} if camera.fisheye else {})
            for view, camera in enumerate(cameras)
        }
    )


def _intrinsics(camera: Camera) -> dict[str, Any]:
    return {
        "name": camera.name,
        "size": list(camera.size),
        "matrix": camera.matrix.tolist(),
        "distortions": camera.distortion.tolist(),
    }


def _fields(rig: CameraRig, view: int) -> dict[str, Any]:
    """Return the fields of a camera that anipose and its descendants share, in their order."""
    return _intrinsics(rig.cameras[view]) | {
        "rotation": vector_from_matrix(rig.rotation[view]).tolist(),
        "translation": rig.translation[view].tolist(),
    }


def _metadata(rig: CameraRig, provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Return what anipose states of its cameras: adjusted to the animal's points, and the error.

    anipose calls error the median over the points of the mean reprojection error over the cameras,
    in pixels, and leaves out what it does not know (calibrate.py).
    """
    metadata: dict[str, Any] = {"adjusted": bool(provenance.get("adjusted", False))}
    if "reprojection_error_px" in provenance:
        metadata["error"] = provenance["reprojection_error_px"]
    # in here: aniposelib takes every other table of a file for a camera
    return metadata | {"unit": rig.unit, **stated_world(rig.world, rig.unit)}


def write_pose2sim(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write Pose2Sim's Calib.toml, which goes by the order of the cameras. Raises MismatchError."""
    lost = check_rig(rig, provenance, "pose2sim", sizes="needed", names=_CAMERA_NAMES)
    sections = {}
    for view, camera in enumerate(rig.cameras):
        terms = lens_terms(camera, 8)  # its own files have 4, it reads as many as there are
        sections[camera.name] = _fields(rig, view) | {
            "size": [float(length) for length in camera.size],
            "distortions": terms if any(terms[5:]) else terms[: 5 if terms[4] else 4],
            "fisheye": False,
        }
    return Written({"Calib.toml": _dump(sections, rig, provenance)}, lost)


def write_freemocap(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write FreeMoCap's calibration, in its order of fields. Raises MismatchError."""
    lost = check_rig(rig, provenance, "freemocap", terms=5, sizes="needed")
    sections = {}
    for view, camera in enumerate(rig.cameras):
        sections[f"cam_{view}"] = _fields(rig, view) | {
            "distortions": lens_terms(camera, 5),
            "id": camera.name,
            "index": view,
            "world_orientation": rig.rotation[view].T.tolist(),
            "world_position": rig.centres[view].tolist(),
        }
    return Written({"calibration.toml": _dump(sections, rig, provenance)}, lost)


def write_caliscope(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write caliscope's camera_array.toml; names that are no numbers stand beside its numbers.

    Raises MismatchError.
    """
    lost = check_rig(rig, provenance, "caliscope", terms=5, fisheye=True, sizes="needed")
    numbered = all(name.isascii() and name.isdigit() for name in rig.names)
    numbered = numbered and all(str(int(name)) == name for name in rig.names)
    cameras = {}
    for view, camera in enumerate(rig.cameras):
        number = camera.name if numbered else str(view)
        own = {"cam_id": int(number), "rotation_count": 0, "ignore": False}
        terms = lens_terms(camera, 4 if camera.fisheye else 5)
        lens = {"distortions": terms, "fisheye": camera.fisheye}
        cameras[number] = own | _fields(rig, view) | lens
    if not numbered:
        lost = (*lost, "the cameras' names, to caliscope itself: it counts them from 0")
    return Written({"camera_array.toml": _dump({"cameras": cameras}, rig, provenance)}, lost)


def _dump(sections: Mapping[str, Any], rig: CameraRig, provenance: Mapping[str, Any]) -> bytes:
    metadata = _metadata(rig, provenance) | {"provenance": plain_fields(provenance)}
    return _dump_toml({**sections, "metadata": metadata}).encode()


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
    kind="cameras",
    name="caliscope",
    title="caliscope camera_array.toml",
    sniff=sniff_caliscope,
    read=read,
    write=write_caliscope,
    unit="m",
)
FREEMOCAP = Format(
    kind="cameras",
    name="freemocap",
    title="FreeMoCap calibration.toml",
    sniff=sniff_freemocap,
    read=read,
    write=write_freemocap,
    unit="mm",
)
POSE2SIM = Format(
    kind="cameras",
    name="pose2sim",
    title="Pose2Sim Calib.toml",
    sniff=sniff_pose2sim,
    read=read,
    write=write_pose2sim,
    unit="m",
)
ANIPOSE = Format(
    kind="cameras",
    name="anipose",
    title="anipose calibration.toml",
    sniff=sniff_anipose,
    read=read,
    write=write_anipose,
    endings=(".toml",),
)
