"""Write cameras.yaml, our own file, and calibration.toml, which anipose and its descendants read.

Every float is written with as many digits as bring it back exactly.
"""

import json
import re
from collections.abc import Mapping
from typing import Any

import yaml

from mocap_calib import __version__
from mocap_calib.geometry.rotation import rig_size, vector_from_matrix
from mocap_calib.io.cameras.intrinsics import camera_fields, estimated_fields
from mocap_calib.io.cameras.toml_text import dump_toml
from mocap_calib.io.provenance import plain_fields, read_judgement, round_sigma
from mocap_calib.io.world_fields import stated_world
from mocap_calib.io.zeros import unsigned_zeros
from mocap_calib.types import ARBITRARY, Camera, CameraClock, CameraRig, ClockKind, EstimatedCamera

VERSION = 1
SUBFRAME = "clock_subframe_offset"  # of a camera: the part of a frame that comes to its offset
CONVENTION = "x_camera = R x_world + t; x right, y down, z forward; pixel centres are integers"
_NOT_ESCAPED = "[\x85\u2028\u2029]"  # line breaks that PyYAML reads back as spaces


def format_cameras_yaml(rig: CameraRig, provenance: Mapping[str, Any]) -> str:
    """Return our own file: plain YAML, lengths in the rig's unit.

    provenance: whatever says how the rig came about. What its field clock_subframe_offset says by
        the names of cameras is written beside each, and what its field centre_sigma_percent says
        as a length.
    """
    offsets = provenance.get(SUBFRAME, {})
    lengths = _centre_sigmas(rig, provenance)
    provenance = {key: provenance[key] for key in provenance if key != SUBFRAME}
    header = {
        "format": "mocap-calib cameras",
        "version": VERSION,
        "unit": rig.unit,
        **stated_world(rig.world, rig.unit),
        "convention": CONVENTION,
        "provenance": plain_fields(provenance),
    }
    cameras = []
    for view, camera in enumerate(rig.cameras):
        extrinsics: dict[str, Any] = {
            "R": rig.rotation[view].tolist(),
            "t": rig.translation[view].tolist(),
            "centre": rig.centres[view].tolist(),
        }
        if camera.name in lengths:
            extrinsics["centre_sigma"] = lengths[camera.name]
        part = {SUBFRAME: offsets[camera.name]} if camera.name in offsets else {}
        cameras.append(camera_fields(camera) | extrinsics | clock_fields(rig, camera.name) | part)
    # flow style (None) puts the rows of a matrix on a line each
    return _dump_yaml(header, flow=False) + _dump_yaml({"cameras": cameras}, flow=None)


def _centre_sigmas(rig: CameraRig, provenance: Mapping[str, Any]) -> dict[str, float]:
    """Return how sure centres are as lengths, by the names of cameras; nothing where nobody knows.

    Percents are those of the size of a whole rig: they say nothing of a part of it, nor of cameras
    that stood elsewhere for some time.
    """
    judged = read_judgement(provenance)
    percent = judged.get("centre_sigma_percent", {})
    if rig.unit == ARBITRARY or set(percent) != set(rig.names) or "frames" in judged:
        return {}
    size = rig_size(rig)
    return {name: round_sigma(value / 100 * size) for name, value in percent.items()}


def clock_fields(rig: CameraRig, camera: str) -> dict[str, Any]:
    """Return what is written of the clock of a camera, nothing where it is that of the others."""
    clock = next((each for each in rig.clocks if each.camera == camera), None)
    if clock is None or not clock.differs:
        return {}
    if clock.kind == "clock":
        return {"clock_offset_frames": clock.offset}
    table = [list(row) for row in clock.table]
    return {"clock_offset_frames": table, "clock_rate": float(clock.rate)}


def read_clock(fields: Mapping[str, Any], camera: str) -> CameraClock | None:
    """Return the clock that `clock_fields` wrote, None where there is none or it makes no sense."""
    offset, rate = fields.get("clock_offset_frames"), fields.get("clock_rate", 1.0)
    if type(offset) is int:
        return CameraClock(camera, "clock", offset)
    if not isinstance(offset, list) or not offset or not _is_positive(rate):
        return None
    if not all(isinstance(row, list) and list(map(type, row)) == [int, int] for row in offset):
        return None
    kind: ClockKind = "dropped" if rate == 1.0 else "rate"
    table = tuple((row[0], row[1]) for row in offset)
    return CameraClock(camera, kind, table[0][1], float(rate), table)


def _is_positive(value: Any) -> bool:
    """Return whether a value that was read is a number above 0."""
    return type(value) in (int, float) and 0 < value < float("inf")


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


def _dump_yaml(fields: Mapping[str, Any], *, flow: bool | None) -> str:
    """Return YAML, with all characters as they are unless PyYAML would change some."""
    unicode_as_is = not re.search(_NOT_ESCAPED, json.dumps(fields, ensure_ascii=False))
    return yaml.safe_dump(
        unsigned_zeros(fields),
        default_flow_style=flow,
        sort_keys=False,
        allow_unicode=unicode_as_is,
        width=160,
    )
