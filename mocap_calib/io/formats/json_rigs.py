"""JSON of camera rigs in data sets: CMU Panoptic, VoxelPose, 4D-Association, multiview_calib.

* CMU Panoptic: a list of cameras in centimetres. `distCoef` has k1 k2 p1 p2 k3; a camera may lack
  its resolution, or its extrinsics (R and t).
* VoxelPose (Campus, Shelf, Panoptic in its own layout), in millimetres: cameras by number, or the
  list of one sequence. T is the camera's centre and no translation: x = R (X - T). k has k1 k2 k3
  and p has p1 p2; both may be missing. There are no image sizes.
* 4D-Association: cameras by number, in metres. K has the 9 numbers of the camera matrix and RT the
  12 of [R t], row after row. There is no distortion, as its images are undistorted, and no name.
* multiview_calib: intrinsics.json and files of poses in a folder. Its steps write poses.json,
  ba_poses.json and global_poses.json, the last of which counts. Bundle adjustment refines the
  intrinsics too, so that those beside the poses are better than those of intrinsics.json. Image
  sizes (`image_shape`) are in intrinsics.json alone, as (height, width). There is no unit of
  length; a field `unit` of the first camera states ours.
"""

from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.camera_checks import numbers
from mocap_calib.io.cameras import (
    CameraFile,
    RawCamera,
    check_rig,
    collect_cameras,
    entries,
    has_json_entry,
    lens_terms,
    pinhole_matrix,
    to_json,
)
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format, Written
from mocap_calib.io.provenance import plain_fields
from mocap_calib.types import CameraRig, Floats

_CALIBRATION = "calibration.json"


# --- CMU Panoptic


class _Panoptic(msgspec.Struct):
    K: Any
    distCoef: Any
    name: Any = None
    resolution: Any = None
    R: Any = None
    t: Any = None


def sniff_panoptic(document: Document) -> bool:
    """Return whether there is a list of cameras with distCoef."""
    return document.has("json", "cameras") and has_json_entry(document, "distCoef")


def read_panoptic(document: Document) -> CameraFile:
    """Read the cameras. Raises FormatError."""
    data = document.mapping("cameras")
    found = entries(_Panoptic, data["cameras"], document.source, "cameras with K and distCoef")
    raws = (
        RawCamera(
            name=str(each.name or number),
            size=each.resolution,
            matrix=each.K,
            distortion=each.distCoef,
            rotation=each.R,
            translation=each.t,
        )
        for number, each in found
    )
    return collect_cameras(raws, document.source, provenance=data.get("provenance"))


def write_panoptic(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write the fields that the data set's cameras have. Raises MismatchError."""
    lost = check_rig(rig, provenance, "panoptic", terms=5, sizes="needed")
    cameras = [
        {
            "name": camera.name,
            "type": "hd",
            "resolution": list(camera.size),
            "panel": 0,
            "node": view,
            "K": camera.matrix.tolist(),
            "distCoef": lens_terms(camera, 5),
            "R": rig.rotation[view].tolist(),
            "t": rig.translation[view][:, None].tolist(),
        }
        for view, camera in enumerate(rig.cameras)
    ]
    about = {"calibDataSource": "mocap-calib", "provenance": plain_fields(provenance)}
    return Written({_CALIBRATION: to_json({**about, "cameras": cameras})}, lost)


# --- VoxelPose


class _VoxelPose(msgspec.Struct):
    R: Any
    T: Any
    fx: Any
    fy: Any
    cx: Any
    cy: Any
    k: Any = ()
    p: Any = ()
    name: Any = None


def sniff_voxelpose(document: Document) -> bool:
    """Return whether there are cameras with fx and T, by number or in a sequence's list."""
    return has_json_entry(document, "R", "T", "fx", "fy", "cx", "cy")


def read_voxelpose(document: Document) -> CameraFile:
    """Read the cameras. Raises FormatError."""
    tree: Any = document.mapping()
    sequences = [value for value in tree.values() if isinstance(value, list)]
    if len(sequences) > 1:
        found = f"{len(sequences)} sequences"
        raise document.refuse("the cameras of one sequence", found, "keep one of them in the file")
    cameras = sequences[0] if sequences else tree
    expected = "cameras by number with R, T, fx, fy, cx and cy"
    raws = (
        RawCamera(
            name=str(each.name or number),
            matrix=pinhole_matrix(each.fx, each.fy, each.cx, each.cy),
            distortion=_voxelpose_terms(each, f"{document.source}: camera {number}"),
            rotation=each.R,
            centre=each.T,
        )
        for number, each in entries(_VoxelPose, cameras, document.source, expected)
    )
    return collect_cameras(raws, document.source)


def _voxelpose_terms(camera: _VoxelPose, where: str) -> Floats:
    """Return `[5]` k1 k2 p1 p2 k3, 0 where they are missing. Raises FormatError."""
    expected = "three k and two p of the distortion, or none"
    distortion = np.zeros(5)
    for given, places in ((camera.k, [0, 1, 4]), (camera.p, [2, 3])):
        values = numbers(given, expected, where).reshape(-1)
        if len(values) not in (0, len(places)):
            raise FormatError(where, expected, len(values), "correct the distortion")
        distortion[places] = values if len(values) else 0.0
    return distortion


def write_voxelpose(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write the cameras by number, as its data sets are read, with their names.

    Raises MismatchError.
    """
    lost = check_rig(rig, provenance, "voxelpose", terms=5, sizes="lost", verdict=False)
    cameras = {}
    for view, camera in enumerate(rig.cameras):
        k1, k2, p1, p2, k3 = lens_terms(camera, 5)
        (fx, _, cx), (_, fy, cy), _ = camera.matrix.tolist()
        cameras[str(view)] = {
            "name": camera.name,
            "R": rig.rotation[view].tolist(),
            "T": rig.centres[view][:, None].tolist(),
            **{"fx": fx, "fy": fy, "cx": cx, "cy": cy},
            "k": [[k1], [k2], [k3]],
            "p": [[p1], [p2]],
        }
    return Written({_CALIBRATION: to_json(cameras)}, lost)


# --- 4D-Association


class _FourD(msgspec.Struct):
    K: Any
    RT: Any
    imgSize: Any


def sniff_four_d(document: Document) -> bool:
    """Return whether there are cameras with K and RT."""
    return has_json_entry(document, "K", "RT", "imgSize")


def read_four_d(document: Document) -> CameraFile:
    """Read the cameras, which are called by their numbers. Raises FormatError."""
    raws = []
    expected = "cameras by number with 9 numbers K, 12 RT and an imgSize"
    for name, each in entries(_FourD, document.tree, document.source, expected):
        pose = numbers(each.RT, expected, document.source)
        if pose.size != 12:
            raise document.refuse(expected, f"{pose.size} RT of camera {name}", "correct them")
        pose = pose.reshape(3, 4)
        raws.append(
            RawCamera(
                name=name,
                size=each.imgSize,
                matrix=each.K,
                rotation=pose[:, :3],
                translation=pose[:, 3],
            )
        )
    return collect_cameras(raws, document.source)


def write_four_d(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write the cameras by number.

    Raises MismatchError, also where a camera has a distortion.
    """
    lost = check_rig(rig, provenance, "4d-association", terms=0, sizes="needed", verdict=False)
    cameras = {
        str(view): {
            "K": camera.matrix.ravel().tolist(),
            "RT": np.column_stack([rig.rotation[view], rig.translation[view]]).ravel().tolist(),
            "imgSize": list(camera.size),
        }
        for view, camera in enumerate(rig.cameras)
    }
    if rig.names != tuple(cameras):
        lost = ("the cameras' names: they are counted from 0", *lost)
    return Written({_CALIBRATION: to_json(cameras)}, lost)


# --- multiview_calib

_INTRINSICS = "intrinsics.json"
_GLOBAL_POSES = "global_poses.json"
_POSES = (_GLOBAL_POSES, "ba_poses.json", "poses.json")  # the last that are made come first


class _View(msgspec.Struct, omit_defaults=True):
    K: Any = None
    dist: Any = None
    image_shape: Any = None
    R: Any = None
    t: Any = None
    unit: Any = ""


def sniff_multiview_calib(document: Document) -> bool:
    """Return whether this is a folder with intrinsics.json, or one of its files."""
    if document.is_folder:
        return _INTRINSICS in document.names
    return has_json_entry(document, "K", "dist")


def read_multiview_calib(document: Document) -> CameraFile:
    """Read the cameras of a folder, or of one of its files. Raises FormatError."""
    first = document.of(_INTRINSICS) if document.is_folder else document
    views = dict(entries(_View, first.tree, first.source, "views with K and dist"))
    file = next((file for file in _POSES if file in document.names), None)
    if file is not None:
        poses = document.of(file)
        for name, pose in entries(_View, poses.tree, poses.source, "views with R and t"):
            merged = msgspec.to_builtins(views.get(name, _View())) | msgspec.to_builtins(pose)
            views[name] = msgspec.convert(merged, _View)
    for name, view in views.items():
        if view.K is None or view.dist is None:
            raise document.refuse(f"K and dist of the view {name}", "none")
    raws = (
        RawCamera(
            name=name,
            size=view.image_shape[1::-1] if isinstance(view.image_shape, list) else None,
            matrix=view.K,
            distortion=view.dist,
            rotation=view.R,
            translation=view.t,
        )
        for name, view in views.items()
    )
    unit = next(iter(views.values())).unit
    return collect_cameras(raws, document.source, unit=unit)


def write_multiview_calib(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write intrinsics.json and global_poses.json. Raises MismatchError."""
    text = (r"[^\ud800-\udfff]+", "text")
    lost = check_rig(rig, provenance, "multiview-calib", names=text, verdict=False)
    intrinsics, poses = {}, {}
    for view, camera in enumerate(rig.cameras):
        distortion = camera.distortion if camera.distortion.any() else np.zeros(5)
        lens = {"K": camera.matrix.tolist(), "dist": distortion.tolist()}
        size = {} if 0 in camera.size else {"image_shape": list(camera.size[::-1])}
        intrinsics[camera.name] = lens | size | {"unit": rig.unit}
        pose = {"R": rig.rotation[view].tolist(), "t": rig.translation[view].tolist()}
        poses[camera.name] = lens | pose
    return Written({_INTRINSICS: to_json(intrinsics), _GLOBAL_POSES: to_json(poses)}, lost)


PANOPTIC = Format(
    kind="cameras",
    name="panoptic",
    title="CMU Panoptic JSON",
    sniff=sniff_panoptic,
    read=read_panoptic,
    write=write_panoptic,
    unit="cm",
)
VOXELPOSE = Format(
    kind="cameras",
    name="voxelpose",
    title="VoxelPose JSON",
    sniff=sniff_voxelpose,
    read=read_voxelpose,
    write=write_voxelpose,
    unit="mm",
)
FOUR_D_ASSOCIATION = Format(
    kind="cameras",
    name="4d-association",
    title="4D-Association JSON",
    sniff=sniff_four_d,
    read=read_four_d,
    write=write_four_d,
    unit="m",
)
MULTIVIEW_CALIB = Format(
    kind="cameras",
    name="multiview-calib",
    title="multiview_calib JSON",
    sniff=sniff_multiview_calib,
    read=read_multiview_calib,
    write=write_multiview_calib,
    folder=True,
)
