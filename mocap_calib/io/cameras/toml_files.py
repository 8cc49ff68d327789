"""TOML of anipose and of those who took it over: Pose2Sim, FreeMoCap, caliscope.

All have a section a camera with size, matrix, distortions, rotation (a Rodrigues vector) and translation of
cam_from_world. They differ in the unit, in the sections' names, and in who reads what.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from mocap_calib.errors import MismatchError
from mocap_calib.io.cameras.intrinsics import make_camera, make_extrinsics, one_field
from mocap_calib.io.cameras.own import (
    assignments,
    format_calibration_toml,
    plain,
    toml_fields,
    toml_key,
)
from mocap_calib.io.cameras.source import CameraFile, Source, Written, need_sizes, terms, unique
from mocap_calib.io.file import malformed
from mocap_calib.types import Camera, CameraRig

_NOT_CAMERAS = (
    "metadata",
    "capture_volume",
    "charuco",
    "checkerboard",
)  # sections that Pose2Sim passes over


def sniff_caliscope(source: Source) -> bool:
    """Cameras one level down, by number."""
    return source.has("toml", "cameras") and any(
        isinstance(c, dict) and "cam_id" in c for c in _tables(source.tree["cameras"])
    )


def sniff_freemocap(source: Source) -> bool:
    """Where the cameras stand is said twice."""
    return source.syntax == "toml" and any(
        "world_position" in fields for fields in _tables(source.tree)
    )


def sniff_pose2sim(source: Source) -> bool:
    """Sections named as their cameras, and sizes that are no whole numbers to TOML."""
    if source.syntax != "toml":
        return False
    cameras = [
        (name, fields)
        for name, fields in source.tree.items()
        if isinstance(fields, dict) and "matrix" in fields
    ]
    return bool(cameras) and all(
        fields.get("name") == name
        and "fisheye" in fields
        and isinstance(fields.get("size"), list)
        and all(isinstance(n, float) for n in fields["size"])
        for name, fields in cameras
    )


def sniff_anipose(source: Source) -> bool:
    """Any TOML."""
    return source.syntax == "toml"


def parse(source: Source) -> CameraFile:
    """Any of them. Raises FormatError."""
    data = source.mapping()
    sections = list(_sections(data))
    if not sections:
        raise malformed(
            source.path,
            "sections with a camera's size, matrix and distortions",
            one_field(data) or "nothing",
            "export anipose's calibration.toml",
        )
    cameras, extrinsics, notes = [], {}, []
    for section, fields in sections:
        name = str(fields.get("name", section))
        where = f"{source.path}: camera {name}"
        if not isinstance(fields.get("matrix"), list):
            notes.append(f"camera {name} has no intrinsics and is left out")
            continue
        cameras.append(
            make_camera(
                name,
                fields.get("size"),
                fields["matrix"],
                fields.get("distortions"),
                fields.get("fisheye", False) is True,
                where,
            )
        )
        # caliscope writes the text "null" where a camera was not placed
        if isinstance(fields.get("rotation"), list) and isinstance(fields.get("translation"), list):
            extrinsics[name] = make_extrinsics(fields["rotation"], fields["translation"], where)
        if fields.get("rotation_count", 0) != 0:
            notes.append(
                f"camera {name} is shown turned by caliscope; its matrix is of the images as they were recorded"
            )
    metadata = data.get("metadata")
    unit = metadata.get("unit", "") if isinstance(metadata, dict) else ""
    return CameraFile(unique(cameras, source.path), extrinsics, str(unit), tuple(notes))


def _tables(data: Any) -> list[dict[str, Any]]:
    return (
        [value for value in data.values() if isinstance(value, dict)]
        if isinstance(data, dict)
        else []
    )


def _sections(data: dict[str, Any]) -> Iterable[tuple[str, dict[str, Any]]]:
    """The tables with a matrix, at the top or one below ([cameras.0] of caliscope, where one may lack it)."""
    for key, value in data.items():
        if isinstance(value, dict) and isinstance(value.get("matrix"), list):
            yield key, value
        elif isinstance(value, dict):
            yield from (
                (k, v)
                for k, v in value.items()
                if isinstance(v, dict) and (isinstance(v.get("matrix"), list) or "cam_id" in v)
            )


# --- writing


def write_anipose(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Aniposelib's calibration.toml; carries all."""
    return Written({"calibration.toml": format_calibration_toml(rig, provenance).encode()})


def write_pose2sim(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Pose2Sim's Calib.toml, as its own writer spells it. Pose2Sim goes by the order of the cameras. Raises MismatchError."""
    need_sizes(rig, "pose2sim")
    lines = []
    for v, camera in enumerate(rig.cameras):
        if camera.name in _NOT_CAMERAS:
            raise MismatchError(
                f"pose2sim: expected camera names other than {', '.join(_NOT_CAMERAS)}, found {camera.name}; rename the camera"
            )
        padded = terms(camera, 8, "pose2sim")
        # its own files have four; it reads as many as there are
        used = (
            padded[:4] if not padded[4:].any() else padded[:5] if not padded[5:].any() else padded
        )
        fields = toml_fields(rig, v) | {
            "size": [float(n) for n in camera.size],
            "distortions": used.tolist(),
            "fisheye": False,
        }
        lines += [f"[{toml_key(camera.name)}]", *assignments(fields), ""]
    return Written({"Calib.toml": _with_metadata(lines, rig, provenance)})


def write_freemocap(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """FreeMoCap's calibration, in its order of fields. Raises MismatchError."""
    need_sizes(rig, "freemocap")
    lines = []
    for v, camera in enumerate(rig.cameras):
        fields = toml_fields(rig, v) | {
            "distortions": terms(camera, 5, "freemocap").tolist(),
            "id": camera.name,
            "index": v,
        }
        fields |= {
            "world_orientation": rig.rotation[v].T.tolist(),
            "world_position": rig.centres[v].tolist(),
        }
        lines += [f"[cam_{v}]", *assignments(fields), ""]
    return Written({"calibration.toml": _with_metadata(lines, rig, provenance)})


def write_caliscope(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Caliscope's camera_array.toml; its cameras have numbers, so names that are none stand beside. Raises MismatchError."""
    need_sizes(rig, "caliscope")
    numbered = all(
        name.isascii() and name.isdigit() and str(int(name)) == name for name in rig.names
    )
    lines = []
    for v, camera in enumerate(rig.cameras):
        number = camera.name if numbered else str(v)
        fields = {"cam_id": int(number), "rotation_count": 0, "ignore": False} | toml_fields(rig, v)
        fields |= {"distortions": _caliscope_terms(camera), "fisheye": camera.fisheye}
        lines += [f"[cameras.{number}]", *assignments(fields), ""]
    lost = () if numbered else ("the cameras' names, to caliscope itself: it counts them from 0",)
    return Written({"camera_array.toml": _with_metadata(lines, rig, provenance)}, lost)


def _caliscope_terms(camera: Camera) -> list[float]:
    return camera.distortion.tolist() if camera.fisheye else terms(camera, 5, "caliscope").tolist()


def _with_metadata(lines: list[str], rig: CameraRig, provenance: Mapping[str, Any]) -> bytes:
    fields = {"adjusted": False, "error": 0.0, "unit": rig.unit, "provenance": plain(provenance)}
    return "\n".join([*lines, "[metadata]", *assignments(fields)]).encode() + b"\n"
