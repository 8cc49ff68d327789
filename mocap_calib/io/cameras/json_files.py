"""JSON of data sets and tools: CMU Panoptic, VoxelPose, 4D-Association, multiview_calib."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from mocap_calib.io.cameras.intrinsics import make_camera, make_extrinsics, numbers
from mocap_calib.io.cameras.source import (
    CameraFile,
    Source,
    cannot,
    entries,
    need,
    need_names,
    need_sizes,
    terms,
    to_json,
    unique,
    without_sizes,
)
from mocap_calib.io.file import malformed
from mocap_calib.io.registry import Written
from mocap_calib.types import Camera, CameraRig, Floats

Found = list[tuple[Camera, tuple[Floats, Floats] | None]]


def _file(found: Found, source: Source, unit: str = "") -> CameraFile:
    cameras = unique((camera for camera, _ in found), source.path)
    return CameraFile(
        cameras, {camera.name: pose for camera, pose in found if pose is not None}, unit
    )


def _said(entry: Any) -> str:
    """The unit that we write beside the fields of others."""
    return str(entry.get("unit", "")) if isinstance(entry, dict) else ""


# --- CMU Panoptic


def sniff_panoptic(source: Source) -> bool:
    """A list of cameras with distCoef."""
    listed = source.tree.get("cameras") if source.has("json", "cameras") else None
    return isinstance(listed, list) and any(
        isinstance(fields, dict) and "distCoef" in fields for fields in listed
    )


def parse_panoptic(source: Source) -> CameraFile:
    """The data set's calibration: centimetres. Raises FormatError."""
    found: Found = []
    for number, fields in entries(
        source.mapping("cameras")["cameras"], "a list of cameras", source.path
    ):
        name = str(fields.get("name", number))
        where = f"{source.path}: camera {name}"
        need(fields, ("K", "distCoef"), where)
        camera = make_camera(
            name, fields.get("resolution"), fields["K"], fields["distCoef"], False, where
        )
        found.append(
            (
                camera,
                make_extrinsics(fields["R"], fields["t"], where)
                if {"R", "t"} <= fields.keys()
                else None,
            )
        )
    return _file(found, source)


def write_panoptic(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:  # noqa: ARG001 - the writers' signature
    """The data set's fields. Raises MismatchError."""
    need_sizes(rig, "panoptic")
    cameras = [
        {
            "name": camera.name,
            "type": "hd",
            "resolution": list(camera.size),
            "panel": 0,
            "node": v,
            "K": camera.matrix.tolist(),
            "distCoef": terms(camera, 5, "panoptic").tolist(),
            "R": rig.rotation[v].tolist(),
            "t": rig.translation[v][:, None].tolist(),
        }
        for v, camera in enumerate(rig.cameras)
    ]
    return Written(
        {"calibration.json": to_json({"calibDataSource": "mocap-calib", "cameras": cameras})}
    )


# --- VoxelPose (Campus, Shelf, Panoptic in its own layout)

_VOXEL = ("R", "T", "fx", "fy", "cx", "cy")


def sniff_voxelpose(source: Source) -> bool:
    """Cameras with fx and T, by number or in a sequence's list."""
    return source.syntax == "json" and any(
        isinstance(f, dict) and f.keys() >= set(_VOXEL) for f in _flat(source.tree)
    )


def _flat(tree: Any) -> list[Any]:
    if not isinstance(tree, dict):
        return []
    return [
        each for value in tree.values() for each in (value if isinstance(value, list) else [value])
    ]


def parse_voxelpose(source: Source) -> CameraFile:
    """T is the camera's centre: x = R (X - T), in millimetres. Raises FormatError."""
    lists = [value for value in source.mapping().values() if isinstance(value, list)]
    if len(lists) > 1:
        raise malformed(
            source.path,
            "the cameras of one sequence",
            f"{len(lists)} sequences",
            "keep one of them in the file",
        )
    found: Found = []
    for number, fields in entries(
        lists[0] if lists else source.tree, "cameras by number", source.path
    ):
        name = str(fields.get("name", number))
        where = f"{source.path}: camera {name}"
        need(fields, _VOXEL, where)
        fx, fy, cx, cy = (fields[key] for key in _VOXEL[2:])
        k, p = (
            numbers(fields.get(key, []), f"the distortion {key}", where).reshape(-1)
            for key in ("k", "p")
        )
        if len(k) not in (0, 3) or len(p) not in (0, 2):
            raise malformed(
                where, "three k and two p", f"{len(k)} and {len(p)}", "mend the distortion"
            )
        k, p = (np.concatenate([each, np.zeros(3)]) for each in (k, p))
        camera = make_camera(
            name,
            None,
            [[fx, 0, cx], [0, fy, cy], [0, 0, 1]],
            [k[0], k[1], p[0], p[1], k[2]],
            False,
            where,
        )
        rotation, centre = make_extrinsics(fields["R"], fields["T"], where)
        found.append((camera, (rotation, -rotation @ centre)))
    return _file(found, source)


def write_voxelpose(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:  # noqa: ARG001 - the writers' signature
    """Cameras by number, as its data sets read them; the name beside. Raises MismatchError."""
    cameras = {}
    for v, camera in enumerate(rig.cameras):
        k1, k2, p1, p2, k3 = terms(camera, 5, "voxelpose").tolist()
        (fx, _, cx), (_, fy, cy), _ = camera.matrix.tolist()
        fields = {
            "name": camera.name,
            "R": rig.rotation[v].tolist(),
            "T": rig.centres[v][:, None].tolist(),
            "fx": fx,
            "fy": fy,
            "cx": cx,
            "cy": cy,
        }
        cameras[str(v)] = fields | {"k": [[k1], [k2], [k3]], "p": [[p1], [p2]]}
    return Written({"calibration.json": to_json(cameras)}, without_sizes(rig))


# --- 4D-Association


def sniff_4d_association(source: Source) -> bool:
    """Cameras with K and RT in a row."""
    return source.syntax == "json" and any(
        isinstance(f, dict) and f.keys() >= {"K", "RT", "imgSize"} for f in _flat(source.tree)
    )


def parse_4d_association(source: Source) -> CameraFile:
    """K of 9 and RT of 12 numbers, row after row; metres; no distortion. Raises FormatError."""
    found: Found = []
    for name, fields in entries(source.tree, "cameras by number", source.path):
        where = f"{source.path}: camera {name}"
        need(fields, ("K", "RT", "imgSize"), where)
        matrix, transform = (
            numbers(fields["K"], "9 numbers K", where),
            numbers(fields["RT"], "12 numbers RT", where),
        )
        if matrix.size != 9 or transform.size != 12:
            raise malformed(
                where, "9 numbers K and 12 RT", f"{matrix.size} and {transform.size}", "mend them"
            )
        transform = transform.reshape(3, 4)
        camera = make_camera(name, fields["imgSize"], matrix.reshape(3, 3), [], False, where)
        found.append((camera, make_extrinsics(transform[:, :3], transform[:, 3], where)))
    return _file(found, source)


def write_4d_association(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:  # noqa: ARG001 - the writers' signature
    """Its calibration.json, cameras by number; they have no distortion there. Raises MismatchError."""
    need_sizes(rig, "4d-association")
    cameras = {}
    for v, camera in enumerate(rig.cameras):
        if terms(camera, 8, "4d-association").any():
            raise cannot(
                "4d-association",
                camera.name,
                "a camera without distortion",
                camera.distortion.tolist(),
                "undistort the images first",
            )
        transform = np.column_stack([rig.rotation[v], rig.translation[v]])
        cameras[str(v)] = {
            "K": camera.matrix.ravel().tolist(),
            "RT": transform.ravel().tolist(),
            "imgSize": list(camera.size),
        }
    named = rig.names == tuple(map(str, range(len(rig.names))))
    return Written(
        {"calibration.json": to_json(cameras)},
        () if named else ("the cameras' names: they are counted from 0",),
    )


# --- multiview_calib

_INTRINSICS, _POSES = "intrinsics.json", ("global_poses.json", "ba_poses.json", "poses.json")


def sniff_multiview_calib(source: Source) -> bool:
    """A folder with intrinsics.json, or one of its files."""
    if source.folder:
        return _INTRINSICS in source.files
    return source.syntax == "json" and any(
        isinstance(f, dict) and f.keys() >= {"K", "dist"} for f in _flat(source.tree)
    )


def parse_multiview_calib(source: Source) -> CameraFile:
    """Poses, the last that were made, have refined intrinsics beside; sizes are in intrinsics.json, (height, width). Raises FormatError."""
    poses = (
        next((source.of(name) for name in _POSES if name in source.files), None)
        if source.folder
        else None
    )
    first = source.of(_INTRINSICS) if source.folder else source
    merged = {
        name: dict(fields)
        for name, fields in entries(first.tree, "views with K and dist", first.path)
    }
    for name, fields in entries(poses.tree, "views with R and t", poses.path) if poses else ():
        merged[name] = merged.get(name, {}) | fields
    found: Found = []
    for name, fields in merged.items():
        where = f"{source.path}: camera {name}"
        need(fields, ("K", "dist"), where)
        shape = fields.get("image_shape")
        size = shape[1::-1] if isinstance(shape, list) else None
        camera = make_camera(name, size, fields["K"], fields["dist"], False, where)
        found.append(
            (
                camera,
                make_extrinsics(fields["R"], fields["t"], where)
                if {"R", "t"} <= fields.keys()
                else None,
            )
        )
    return _file(found, source, _said(next(iter(merged.values()), {})))


def write_multiview_calib(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:  # noqa: ARG001 - the writers' signature
    """intrinsics.json and global_poses.json. Raises MismatchError."""
    need_names(rig.names, r"[^\ud800-\udfff]+", "text", "multiview-calib")
    intrinsics, poses = {}, {}
    for v, camera in enumerate(rig.cameras):
        lens = {
            "K": camera.matrix.tolist(),
            "dist": (
                camera.distortion if terms(camera, 8, "multiview-calib").any() else np.zeros(5)
            ).tolist(),
        }
        intrinsics[camera.name] = (
            lens
            | ({"image_shape": list(camera.size[::-1])} if 0 not in camera.size else {})
            | {"unit": rig.unit}
        )
        poses[camera.name] = lens | {
            "R": rig.rotation[v].tolist(),
            "t": rig.translation[v].tolist(),
        }
    return Written({_INTRINSICS: to_json(intrinsics), _POSES[0]: to_json(poses)})
