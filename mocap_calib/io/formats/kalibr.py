"""Kalibr's camchain: YAML with the cameras cam0, cam1, ... of a chain. Read only.

The transform T_cn_cnm1 of a camera is from the camera before it, so that transforms are multiplied
along the chain; cam0 is the world. Where a link of the chain is missing, the cameras behind it have
no extrinsics.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.camera_checks import make_camera, make_extrinsics, numbers
from mocap_calib.io.cameras import (
    CameraFile,
    PlacedCamera,
    collect_cameras,
    entries,
    pinhole_matrix,
)
from mocap_calib.io.document import Document, need
from mocap_calib.io.format import Format
from mocap_calib.types import Camera, Floats

_KEYS = ("camera_model", "intrinsics", "distortion_model", "distortion_coeffs", "resolution")
_DISTORTION_MODELS = ("radtan", "equidistant", "none")


def sniff(document: Document) -> bool:
    """Return whether this is YAML of cameras, all with intrinsics."""
    if document.syntax != "yaml" or "intrinsics" not in document.text:
        return False
    if not isinstance(document.tree, dict) or not document.tree:
        return False
    cameras = document.tree.values()
    return all(isinstance(fields, dict) and "intrinsics" in fields for fields in cameras)


def parse(document: Document) -> CameraFile:
    """Read the cameras in the order of the chain. Raises FormatError."""
    named = entries(document.tree, "cameras cam0, cam1, ...", document.source)
    placed: list[PlacedCamera] = []
    from_world: Floats | None = np.eye(4)
    for name, fields in sorted(named, key=_order_in_chain):
        where = f"{document.source}: camera {name}"
        camera = _parse_camera(name, fields, where)
        if placed:
            from_world = _follow_chain(from_world, fields.get("T_cn_cnm1"), where)
        if from_world is None:
            placed.append((camera, None))
        else:
            extrinsics = make_extrinsics(from_world[:3, :3], from_world[:3, 3], where)
            placed.append((camera, extrinsics))
    return collect_cameras(placed, document.source)


def _order_in_chain(camera: tuple[str, Mapping[str, Any]]) -> tuple[int, str]:
    """Return what puts cam2 before cam10, for a camera's name and fields."""
    name, _ = camera
    return len(name), name


def _follow_chain(from_world: Floats | None, step: Any, where: str) -> Floats | None:
    """Return the `[4, 4]` transform of a camera from that of the one before it.

    step: T_cn_cnm1 of the camera. None stands for what is not known.
    """
    if step is None or from_world is None:
        return None
    return _parse_transform(step, where) @ from_world


def _parse_camera(name: str, fields: Mapping[str, Any], where: str) -> Camera:
    """Return a camera without its place. Raises FormatError."""
    need(fields, _KEYS, where)
    model = str(fields["camera_model"])
    lens = str(fields["distortion_model"])
    if model != "pinhole" or lens not in _DISTORTION_MODELS:
        expected = "the models pinhole and radtan, equidistant or none"
        raise FormatError(where, expected, f"{model} and {lens}", "calibrate with one of them")
    expected = "intrinsics [fu, fv, pu, pv]"
    values = numbers(fields["intrinsics"], expected, where).reshape(-1)
    if len(values) != 4:
        raise FormatError(where, expected, f"{len(values)} numbers", "mend them")
    return make_camera(
        name=name,
        size=fields["resolution"],
        matrix=pinhole_matrix(*values.tolist()),
        distortion=fields["distortion_coeffs"],
        fisheye=lens == "equidistant",
        source=where,
    )


def _parse_transform(value: Any, where: str) -> Floats:
    """Return a `[4, 4]` transform of a rotation and a translation. Raises FormatError."""
    step = numbers(value, "a 4 x 4 transform T_cn_cnm1", where)
    if step.shape != (4, 4) or not np.isfinite(step).all():
        expected = "a finite 4 x 4 transform T_cn_cnm1"
        raise FormatError(where, expected, f"shape {step.shape}", "mend it")
    make_extrinsics(step[:3, :3], step[:3, 3], where)  # which refuses what is no rotation
    return step


FORMAT = Format(
    kind="cameras",
    name="kalibr",
    title="Kalibr camchain",
    sniff=sniff,
    read=parse,
    unit="m",
)
