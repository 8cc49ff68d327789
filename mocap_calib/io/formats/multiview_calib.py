"""multiview_calib's JSON: intrinsics.json and files of poses in a folder.

* The steps of the program write poses.json, ba_poses.json and global_poses.json, the last of which
  counts; bundle adjustment refines the intrinsics too, so that those beside the poses are better
  than those of intrinsics.json.
* Image sizes (`image_shape`) are in intrinsics.json alone, as (height, width).
* There is no unit of length; a field `unit` of the first camera says ours.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from mocap_calib.io.camera_checks import make_camera
from mocap_calib.io.cameras import (
    CameraFile,
    PlacedCamera,
    collect_cameras,
    entries,
    extrinsics_if_given,
    has_json_entry,
    need_names,
    terms,
    to_json,
    without_verdict,
)
from mocap_calib.io.document import Document, need
from mocap_calib.io.format import Format, Written
from mocap_calib.types import Camera, CameraRig

_INTRINSICS = "intrinsics.json"
_GLOBAL_POSES = "global_poses.json"
_POSES = (_GLOBAL_POSES, "ba_poses.json", "poses.json")  # the last that are made come first


def sniff(document: Document) -> bool:
    """Return whether this is a folder with intrinsics.json, or one of its files."""
    if document.is_folder:
        return _INTRINSICS in document.names
    return has_json_entry(document, "K", "dist")


# --- reading


def parse(document: Document) -> CameraFile:
    """Read the cameras of a folder, or of one of its files. Raises FormatError."""
    merged = _merge_files(document)
    placed: list[PlacedCamera] = []
    for name, fields in merged.items():
        where = f"{document.source}: camera {name}"
        camera = _parse_camera(name, fields, where)
        placed.append((camera, extrinsics_if_given(fields, where)))
    first = next(iter(merged.values()))
    return collect_cameras(placed, document.source, unit=str(first.get("unit", "")))


def _merge_files(document: Document) -> dict[str, dict[str, Any]]:
    """Return the fields of each view, those beside poses in place of those of intrinsics.json.

    Raises FormatError.
    """
    first = document.of(_INTRINSICS) if document.is_folder else document
    merged = dict(entries(first.tree, "views with K and dist", first.source))
    if not document.is_folder:
        return merged
    for file in _POSES:
        if file in document.names:
            poses = document.of(file)
            for name, fields in entries(poses.tree, "views with R and t", poses.source):
                merged[name] = merged.get(name, {}) | fields
            break
    return merged


def _parse_camera(name: str, fields: Mapping[str, Any], where: str) -> Camera:
    """Return a camera without its place. Raises FormatError."""
    need(fields, ("K", "dist"), where)
    shape = fields.get("image_shape")
    return make_camera(
        name=name,
        size=shape[1::-1] if isinstance(shape, list) else None,
        matrix=fields["K"],
        distortion=fields["dist"],
        fisheye=False,
        source=where,
    )


# --- writing


def write(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write intrinsics.json and global_poses.json. Raises MismatchError."""
    need_names(rig.names, r"[^\ud800-\udfff]+", "text", "multiview-calib")
    intrinsics = {}
    poses = {}
    for view, camera in enumerate(rig.cameras):
        lens = _format_lens(camera)
        intrinsics[camera.name] = lens | _format_size(camera) | {"unit": rig.unit}
        poses[camera.name] = lens | {
            "R": rig.rotation[view].tolist(),
            "t": rig.translation[view].tolist(),
        }
    files = {_INTRINSICS: to_json(intrinsics), _GLOBAL_POSES: to_json(poses)}
    return Written(files, without_verdict(provenance))


def _format_lens(camera: Camera) -> dict[str, Any]:
    """Return the fields that both files have. Raises MismatchError."""
    distorted = terms(camera, 8, "multiview-calib").any()
    distortion = camera.distortion if distorted else np.zeros(5)
    return {"K": camera.matrix.tolist(), "dist": distortion.tolist()}


def _format_size(camera: Camera) -> dict[str, Any]:
    """Return the field of the image size, nothing where that is not known."""
    width, height = camera.size
    return {} if 0 in camera.size else {"image_shape": [height, width]}


FORMAT = Format(
    kind="cameras",
    name="multiview-calib",
    title="multiview_calib JSON",
    sniff=sniff,
    read=parse,
    write=write,
    folder=True,
)
