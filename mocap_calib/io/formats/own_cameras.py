"""cameras.yaml, our own file of cameras, which carries all that is known of a rig.

Every float is written with as many digits as bring it back exactly.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import yaml

from mocap_calib.errors import FormatError
from mocap_calib.geometry.rotation import rig_size
from mocap_calib.io.camera_checks import describe_keys, make_camera, numbers
from mocap_calib.io.cameras import (
    CameraFile,
    PlacedCamera,
    collect_cameras,
    extrinsics_if_given,
    unique,
)
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format, Written
from mocap_calib.io.provenance import plain_fields, read_judgement, round_sigma
from mocap_calib.io.world_fields import read_world, stated_world
from mocap_calib.io.zeros import unsigned_zeros
from mocap_calib.types import (
    ARBITRARY,
    Camera,
    CameraClock,
    CameraRig,
    ClockKind,
    EstimatedCamera,
)

VERSION = 1
_MODELS = ("opencv", "fisheye", "pinhole")
SUBFRAME = "clock_subframe_offset"  # of a camera: the part of a frame that comes to its offset
CONVENTION = "x_camera = R x_world + t; x right, y down, z forward; pixel centres are integers"
_NOT_ESCAPED = "[\x85\u2028\u2029]"  # line breaks that PyYAML reads back as spaces


def camera_fields(camera: Camera) -> dict[str, Any]:
    """Return the fields of a camera in our own files."""
    estimated: dict[str, Any] = {}
    if isinstance(camera, EstimatedCamera):
        estimated = {"estimated": estimated_fields(camera)}
    return {
        "name": camera.name,
        "size": list(camera.size),
        "model": "fisheye" if camera.fisheye else "opencv",
        "K": camera.matrix.tolist(),
        "distortion": camera.distortion.tolist(),
        **estimated,
    }


def estimated_fields(camera: EstimatedCamera) -> dict[str, float]:
    """Return how sure the intrinsics of a camera are that were estimated from a recording."""
    return {"focal_sigma": camera.focal_sigma, "k1_sigma": camera.k1_sigma}


def camera_from_fields(fields: Any, source: str) -> Camera:
    """Return the camera of `camera_fields`; the model `pinhole` has no distortion."""
    if not isinstance(fields, dict) or not {"name", "K"} <= fields.keys():
        expected = "cameras with name, size, model, K, distortion"
        raise FormatError(source, expected, describe_keys(fields), "write the file again")
    name = str(fields["name"])
    where = f"{source}: camera {name}"
    model = fields.get("model", "opencv")
    if model not in _MODELS:
        raise FormatError(
            where, "the model opencv, fisheye or pinhole", model, "convert the camera"
        )
    camera = make_camera(
        name=name,
        size=fields.get("size"),
        matrix=fields["K"],
        distortion=[] if model == "pinhole" else fields.get("distortion", []),
        fisheye=model == "fisheye",
        source=where,
    )
    return _mark_estimated(camera, fields["estimated"], where) if "estimated" in fields else camera


def _mark_estimated(camera: Camera, fields: Any, source: str) -> EstimatedCamera:
    """Return a camera with the fields of `estimated_fields`. Raises FormatError."""
    expected = "estimated: focal_sigma and k1_sigma of 0 or more"
    if not isinstance(fields, dict) or fields.keys() != {"focal_sigma", "k1_sigma"}:
        raise FormatError(source, expected, describe_keys(fields), "write the file again")
    sigma = numbers([fields["focal_sigma"], fields["k1_sigma"]], expected, source)
    if sigma.shape != (2,) or not np.isfinite(sigma).all() or (sigma < 0).any():
        raise FormatError(source, expected, sigma.tolist(), "write the file again")
    return EstimatedCamera.of(camera, focal_sigma=float(sigma[0]), k1_sigma=float(sigma[1]))


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


FORMAT = Format(
    kind="cameras",
    name="mocap-calib",
    title="mocap-calib cameras.yaml",
    sniff=sniff,
    read=parse,
    write=write,
    endings=(".yaml", ".yml"),
)
