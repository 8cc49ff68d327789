"""What files of results say of how they came about, for those who write them anew."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import yaml

from mocap_calib.io.cameras.own import SUBFRAME


def provenance_of_cameras(path: Path) -> dict[str, Any]:
    """Return the provenance in a cameras.yaml of ours, and beside it the offsets of the clocks.

    It is what `format_rig` takes.
    """
    fields = yaml.safe_load(path.read_text("utf-8"))
    offsets = {
        str(camera["name"]): camera[SUBFRAME] for camera in fields["cameras"] if SUBFRAME in camera
    }
    return dict(fields.get("provenance") or {}) | ({SUBFRAME: offsets} if offsets else {})


def provenance_of_poses(path: Path) -> dict[str, Any]:
    """Return the provenance in a poses3d.h5 of ours."""
    with h5py.File(path, "r") as file:
        found = json.loads(file.attrs.get("provenance", "{}"))
    return dict(found) if isinstance(found, Mapping) else {}
