"""Our own cameras.yaml, which carries all that is known of a rig; `own` has how it is written."""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from mocap_calib.errors import FormatError
from mocap_calib.io.cameras.common import PlacedCamera, collect_cameras, extrinsics_if_given
from mocap_calib.io.cameras.intrinsics import camera_from_fields, describe_keys
from mocap_calib.io.cameras.own import VERSION, format_cameras_yaml, read_clock
from mocap_calib.io.cameras.source import CameraFile, unique
from mocap_calib.io.document import Document
from mocap_calib.io.format import Written
from mocap_calib.io.provenance import read_judgement
from mocap_calib.io.world_fields import read_world
from mocap_calib.types import CameraRig

_FORMAT = r"^format: *[\"']?mocap-calib cameras"


def sniff(document: Document) -> bool:
    """Return whether the first field says that it is ours."""
    return document.syntax == "yaml" and re.search(_FORMAT, document.text, re.M) is not None


def parse(document: Document) -> CameraFile:
    """Read the cameras. Raises FormatError."""
    data = document.mapping()
    if data.get("version") != VERSION:
        expected = f"version {VERSION} of our cameras"
        found = f"version {data.get('version')}"
        raise FormatError(document.source, expected, found, "use the program that wrote it")
    entries = data.get("cameras")
    if not isinstance(entries, list) or not entries:
        found = describe_keys(entries)
        raise FormatError(document.source, "a list of cameras", found, "write the file again")
    cameras = unique(
        (camera_from_fields(each, document.source) for each in entries), document.source
    )
    placed: list[PlacedCamera] = []
    for camera, fields in zip(cameras, entries, strict=True):
        where = f"{document.source}: camera {camera.name}"
        placed.append((camera, extrinsics_if_given(fields, where)))
    file = collect_cameras(placed, document.source, unit=str(data.get("unit", "")))
    clocks = (
        read_clock(fields, camera.name) for camera, fields in zip(cameras, entries, strict=True)
    )
    return replace(
        file,
        judgement=read_judgement(data.get("provenance")),
        clocks=tuple(clock for clock in clocks if clock is not None),
        world=read_world(data.get("world")),
    )


def write(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write the file, which carries all."""
    return Written({"cameras.yaml": format_cameras_yaml(rig, provenance).encode()})
