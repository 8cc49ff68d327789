"""Writing cameras: our own cameras.yaml, and the calibration.toml that anipose, Pose2Sim and their tools read.

Every float is written with as many digits as bring it back exactly.
"""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from mocap_calib import __version__
from mocap_calib.geometry.rotation import vector_from_matrix
from mocap_calib.io.atomic import write_bytes
from mocap_calib.io.cameras.intrinsics import camera_fields
from mocap_calib.types import CameraRig

VERSION = 1
CONVENTION = "x_camera = R x_world + t; x right, y down, z forward; pixel centres are integers"


def write_cameras_yaml(path: Path, rig: CameraRig, provenance: Mapping[str, Any]) -> None:
    """Writes `format_cameras_yaml` atomically."""
    write_bytes(path, format_cameras_yaml(rig, provenance).encode())


def write_calibration_toml(path: Path, rig: CameraRig, provenance: Mapping[str, Any]) -> None:
    """Writes `format_calibration_toml` atomically."""
    write_bytes(path, format_calibration_toml(rig, provenance).encode())


def format_cameras_yaml(rig: CameraRig, provenance: Mapping[str, Any]) -> str:
    """Our own file: plain YAML, lengths in the rig's unit; `provenance` is whatever says how it came about."""
    header = {
        "format": "mocap-calib cameras",
        "version": VERSION,
        "unit": rig.unit,
        "convention": CONVENTION,
        "provenance": plain(provenance),
    }
    cameras = [
        camera_fields(camera)
        | {
            "R": rig.rotation[v].tolist(),
            "t": rig.translation[v].tolist(),
            "centre": rig.centres[v].tolist(),
        }
        for v, camera in enumerate(rig.cameras)
    ]
    # flow style (None) puts the rows of a matrix on a line each; the header reads better line by line
    return _yaml(header, False) + _yaml({"cameras": cameras}, None)


def format_calibration_toml(rig: CameraRig, provenance: Mapping[str, Any]) -> str:
    """The file of anipose; rotations as Rodrigues vectors in radians, lengths in the rig's unit."""
    lines, digits = [], len(str(len(rig.cameras) - 1))  # aniposelib sorts the sections as text
    for v, camera in enumerate(rig.cameras):
        fields = toml_fields(rig, v) | ({"fisheye": True} if camera.fisheye else {})
        lines += [f"[cam_{v:0{digits}}]", *assignments(fields), ""]
    metadata = {
        "adjusted": False,
        "error": 0.0,
        "unit": rig.unit,
        "generator": f"mocap-calib {__version__}",
    }
    lines += ["[metadata]", *assignments(metadata)]
    if provenance:
        lines += ["", "[metadata.provenance]", *assignments(plain(provenance))]
    return "\n".join(lines) + "\n"


def toml_fields(rig: CameraRig, v: int) -> dict[str, Any]:
    """The fields of a camera that anipose and its descendants share."""
    camera = rig.cameras[v]
    return {
        "name": camera.name,
        "size": list(camera.size),
        "matrix": camera.matrix.tolist(),
        "distortions": camera.distortion.tolist(),
        "rotation": vector_from_matrix(rig.rotation[v]).tolist(),
        "translation": rig.translation[v].tolist(),
    }


def plain(provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Down to the types that every format knows; paths and the like become text."""
    plain: dict[str, Any] = json.loads(json.dumps(provenance, default=str))
    return plain


def _yaml(fields: Mapping[str, Any], flow: bool | None) -> str:
    # PyYAML does not escape these line breaks, and reads them back as spaces
    readable = not re.search("[\x85\u2028\u2029]", json.dumps(fields, ensure_ascii=False))
    return yaml.safe_dump(
        dict(fields), default_flow_style=flow, sort_keys=False, allow_unicode=readable, width=160
    )


def assignments(fields: Mapping[str, Any]) -> list[str]:
    """`key = value` lines of TOML, which has no null: such fields are left out."""
    return [
        f"{toml_key(key)} = {_toml(value)}" for key, value in fields.items() if value is not None
    ]


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, list):
        return f"[{', '.join(_toml(v) for v in value if v is not None)}]"
    if isinstance(value, dict):
        return f"{{ {', '.join(assignments(value))} }}"
    return repr(value)


def toml_key(key: str) -> str:
    """A key as TOML spells it."""
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _quoted(key)


def _quoted(text: str) -> str:
    """TOML's basic strings are JSON's, except that they must escape DEL and cannot spell surrogates."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
