"""What files of results say of how they came about, for those who write them anew."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py

from mocap_calib.io.file import decode, read_bytes
from mocap_calib.io.formats.own_cameras import SUBFRAME
from mocap_calib.io.syntax import parse_yaml


def provenance_of_cameras(path: Path) -> dict[str, Any]:
    """Return the provenance in a cameras.yaml of ours, and beside it the offsets of the clocks.

    It is what `format_rig` takes. What was edited into something else is left out.

    Raises FormatError.
    """
    fields = parse_yaml(decode(read_bytes(path), str(path)), str(path))
    stored = fields if isinstance(fields, Mapping) else {}
    cameras = stored.get("cameras")
    offsets = {
        str(camera["name"]): float(camera[SUBFRAME])
        for camera in (cameras if isinstance(cameras, list) else ())
        if isinstance(camera, Mapping) and "name" in camera and _is_number(camera.get(SUBFRAME))
    }
    return _as_mapping(stored.get("provenance")) | ({SUBFRAME: offsets} if offsets else {})


def provenance_of_poses(path: Path) -> dict[str, Any]:
    """Return the provenance in a poses3d.h5 of ours, nothing where it was edited."""
    with h5py.File(path, "r") as file:
        text = file.attrs.get("provenance", "{}")
    try:
        return _as_mapping(json.loads(text))
    except (ValueError, TypeError, RecursionError):
        return {}


def _as_mapping(stored: Any) -> dict[str, Any]:
    return dict(stored) if isinstance(stored, Mapping) else {}


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and math.isfinite(value)
