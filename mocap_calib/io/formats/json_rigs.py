"""JSON of rigs: CMU Panoptic, VoxelPose, 4D-Association, multiview_calib, nerfstudio.

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
* nerfstudio's transforms.json: one frame an image, which is a camera here. transform_matrix is
  camera_to_world in OpenGL's axes: x right, y up, z back. Pixels have their corners at integers, so
  that cx and cy are half a pixel more than ours. What a frame does not state (intrinsics, camera
  model) stands at the top and holds for all. There is no unit of length; `unit` at the top states
  ours.
"""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from mocap_calib.config import CORNER_OFFSET
from mocap_calib.errors import FormatError
from mocap_calib.io.camera_fields import camera_fields
from mocap_calib.io.cameras import (
    CameraFile,
    RawCamera,
    camera_of_image,
    check_rig,
    collect_cameras,
    entries,
    lens_terms,
    numbers,
    pinhole_terms,
    to_json,
)
from mocap_calib.io.document import Document, need
from mocap_calib.io.format import Format, Written
from mocap_calib.io.provenance import plain_fields
from mocap_calib.types import CameraRig

_CALIBRATION = "calibration.json"
_VOXELPOSE_MATRIX = ("fx", "fy", "cx", "cy")


# --- CMU Panoptic


def read_panoptic(document: Document) -> CameraFile:
    """Read the cameras. Raises FormatError."""
    data = document.mapping("cameras")
    raws = [
        RawCamera(name=each.get("name") or number, **camera_fields(each, document.source))
        for number, each in entries(data["cameras"], document.source, "K", "distCoef")
    ]
    return collect_cameras(raws, document.source, provenance=data.get("provenance"))


def write_panoptic(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write the fields that the data set's cameras have. Raises MismatchError."""
    lost = check_rig(rig, provenance, "panoptic", terms=5, sizes="needed")
    cameras = [
        {
            "name": camera.name,
            "type": "hd",
            "resolution": camera.size,
            "panel": 0,
            "node": view,
            "K": camera.matrix,
            "distCoef": lens_terms(camera, 5),
            "R": camera.rotation,
            "t": camera.translation[:, None],
        }
        for view, camera in enumerate(rig)
    ]
    about = {"calibDataSource": "mocap-calib", "provenance": plain_fields(provenance)}
    return Written({_CALIBRATION: to_json({**about, "cameras": cameras})}, lost)


# --- VoxelPose


def read_voxelpose(document: Document) -> CameraFile:
    """Read the cameras. Raises FormatError."""
    tree: Any = document.mapping()
    sequences = [value for value in tree.values() if isinstance(value, list)]
    if len(sequences) > 1:
        found = f"{len(sequences)} sequences"
        raise document.refuse("the cameras of one sequence", found, "keep one of them in the file")
    raws = []
    cameras = entries(
        sequences[0] if sequences else tree, document.source, "R", "T", *_VOXELPOSE_MATRIX
    )
    for number, each in cameras:
        where = f"{document.source}: camera {number}"
        lens: dict[str, Any] = {"translation": None, "centre": each["T"]}
        if each.get("k") or each.get("p"):
            k1, k2, k3 = numbers(each.get("k") or [0] * 3, "three k, or none", where, 3).ravel()
            p1, p2 = numbers(each.get("p") or [0] * 2, "two p, or none", where, 2).ravel()
            lens["distortion"] = [k1, k2, p1, p2, k3]
        matrix = {"matrix": [each[key] for key in _VOXELPOSE_MATRIX]}
        fields = camera_fields(each, where) | matrix | lens
        raws.append(RawCamera(name=each.get("name") or number, **fields))
    return collect_cameras(raws, document.source)


def write_voxelpose(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write the cameras by number, as its data sets are read, with their names.

    Raises MismatchError.
    """
    lost = check_rig(rig, provenance, "voxelpose", terms=5, sizes="lost", verdict=False)
    cameras = {}
    for view, camera in enumerate(rig):
        lens = lens_terms(camera, 5)[:, None]
        cameras[str(view)] = {
            "name": camera.name,
            "R": camera.rotation,
            "T": camera.centre[:, None],
            **dict(zip(_VOXELPOSE_MATRIX, pinhole_terms(camera), strict=True)),
            "k": lens[[0, 1, 4]],
            "p": lens[2:4],
        }
    return Written({_CALIBRATION: to_json(cameras)}, lost)


# --- 4D-Association


def read_four_d(document: Document) -> CameraFile:
    """Read the cameras, which are called by their numbers. Raises FormatError."""
    raws = []
    for name, each in entries(document.tree, document.source, "K", "RT", "imgSize"):
        pose = numbers(each["RT"], "12 numbers RT", f"{document.source}: camera {name}", 12)
        rotation, translation = np.split(pose.reshape(3, 4), [3], axis=1)
        keys = {"size": each["imgSize"], "matrix": each["K"]}
        raws.append(
            RawCamera(name=name, **keys, distortion=(), rotation=rotation, translation=translation)
        )
    return collect_cameras(raws, document.source)


def write_four_d(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write the cameras by number.

    Raises MismatchError, also where a camera has a distortion.
    """
    lost = check_rig(rig, provenance, "4d-association", terms=0, sizes="needed", verdict=False)
    cameras = {
        str(view): {
            "K": camera.matrix.ravel(),
            "RT": np.column_stack([camera.rotation, camera.translation]).ravel(),
            "imgSize": camera.size,
        }
        for view, camera in enumerate(rig)
    }
    if rig.names != tuple(cameras):
        lost = ("the cameras' names: they are counted from 0", *lost)
    return Written({_CALIBRATION: to_json(cameras)}, lost)


# --- multiview_calib

_INTRINSICS = "intrinsics.json"
_GLOBAL_POSES = "global_poses.json"
_POSES = (_GLOBAL_POSES, "ba_poses.json", "poses.json")  # the last that are made come first


def sniff_multiview_calib(document: Document) -> bool:
    """Return whether this is a folder with intrinsics.json, or one of its files."""
    if document.is_folder:
        return _INTRINSICS in document.names
    return document.has_entry(["K", "dist"])


def read_multiview_calib(document: Document) -> CameraFile:
    """Read the cameras of a folder, or of one of its files. Raises FormatError."""
    first = document.of(_INTRINSICS) if document.is_folder else document
    views = dict(entries(first.tree, first.source, "K", "dist"))
    file = next((file for file in _POSES if file in document.names), None)
    if file is not None:
        poses = document.of(file)
        for name, pose in entries(poses.tree, poses.source, "R", "t"):
            views[name] = views[name] | pose if name in views else pose
    raws = []
    for name, view in views.items():
        found = camera_fields(view, f"{document.source}: camera {name}")
        raws.append(RawCamera(name=name, **found))
    unit = next((view.get("unit", "") for view in views.values()), "")
    return collect_cameras(raws, document.source, unit=unit)


def write_multiview_calib(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write intrinsics.json and global_poses.json. Raises MismatchError."""
    text = (r"[^\ud800-\udfff]+", "text")
    lost = check_rig(rig, provenance, "multiview-calib", names=text, verdict=False)
    intrinsics, poses = {}, {}
    for camera in rig:
        distortion = camera.distortion if camera.distortion.any() else np.zeros(5)
        lens = {"K": camera.matrix, "dist": distortion}
        size = {} if 0 in camera.size else {"image_shape": camera.size[::-1]}
        intrinsics[camera.name] = lens | size | {"unit": rig.unit}
        poses[camera.name] = lens | {"R": camera.rotation, "t": camera.translation}
    return Written({_INTRINSICS: to_json(intrinsics), _GLOBAL_POSES: to_json(poses)}, lost)


# --- nerfstudio

_OPENGL_AXES = np.array([1.0, -1.0, -1.0])
_NERFSTUDIO_PINHOLE = ("k1", "k2", "p1", "p2", "k3")
_TERMS = {  # of each camera model
    **dict.fromkeys(("OPENCV", "PINHOLE", "SIMPLE_PINHOLE"), _NERFSTUDIO_PINHOLE),
    "OPENCV_FISHEYE": ("k1", "k2", "k3", "k4"),
}
_FOLDER = "images/"


def read_nerfstudio(document: Document) -> CameraFile:
    """Read the frames as cameras, called after their images. Raises FormatError."""
    shared = document.mapping("frames")
    raws = [
        _read_frame(shared | {"file_path": number} | frame, f"{document.source}: frame {number}")
        for number, frame in entries(shared["frames"], document.source, "transform_matrix")
    ]
    unit, provenance = shared.get("unit", ""), shared.get("provenance")
    return collect_cameras(raws, document.source, unit=unit, provenance=provenance)


def _read_frame(fields: dict[str, Any], where: str) -> RawCamera:
    """Return the camera of a frame. Raises FormatError."""
    need(fields, ("fl_x", "cx", "cy"), where)
    fisheye = camera_fields(fields, where)["fisheye"]
    model = "OPENCV_FISHEYE" if fisheye else str(fields.get("camera_model", "OPENCV"))
    if model not in _TERMS:
        expected = f"the camera_model {', '.join(_TERMS)}"
        raise FormatError(where, expected, model, "undistort, or choose another model")
    if "k4" not in _TERMS[model] and fields.get("k4"):
        expected = "k1, k2, k3, p1, p2 of OpenCV's model"
        raise FormatError(where, expected, "a k4", "calibrate without it")
    middle = numbers([fields["cx"], fields["cy"]], "numbers cx and cy", where, 2) - CORNER_OFFSET
    # world_from_cam: its translation is the camera's centre
    transform = numbers(fields["transform_matrix"], "a 4 x 4 transform_matrix", where, 12, 16)
    turned, centre = np.split(transform.reshape(-1, 4)[:3], [3], axis=1)
    name = str(fields["file_path"]).removeprefix("./").removeprefix(_FOLDER)
    return RawCamera(
        name=camera_of_image(name),
        size=[fields.get("w"), fields.get("h")],
        matrix=[fields["fl_x"], fields.get("fl_y") or fields["fl_x"], *middle],
        distortion=[fields.get(key, 0.0) for key in _TERMS[model]],
        fisheye=model == "OPENCV_FISHEYE",
        rotation=(turned * _OPENGL_AXES).T,
        centre=centre,
    )


def write_nerfstudio(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write one frame a camera; its image is called images/NAME.png. Raises MismatchError."""
    lost = check_rig(rig, provenance, "nerfstudio", terms=5, fisheye=True, sizes="needed")
    frames = []
    for camera in rig:
        model = "OPENCV_FISHEYE" if camera.fisheye else "OPENCV"
        fx, fy, cx, cy = pinhole_terms(camera)
        keys = _TERMS[model]
        turned = np.column_stack([camera.rotation.T * _OPENGL_AXES, camera.centre])
        frames.append(
            {
                "file_path": f"{_FOLDER}{camera.name}.png",
                "camera_model": model,
                **{"fl_x": fx, "fl_y": fy, "cx": cx + CORNER_OFFSET, "cy": cy + CORNER_OFFSET},
                **dict(zip("wh", camera.size, strict=True)),
                **dict(zip(keys, lens_terms(camera, len(keys)).tolist(), strict=True)),
                "transform_matrix": np.vstack([turned, [0.0, 0.0, 0.0, 1.0]]),
            }
        )
    document = {
        "camera_model": frames[0]["camera_model"],
        "unit": rig.unit,
        "provenance": plain_fields(provenance),
        "frames": frames,
    }
    return Written({"transforms.json": to_json(document)}, lost)


PANOPTIC = Format(
    name="panoptic",
    title="CMU Panoptic JSON",
    sniff=partial(Document.has_entry, keys=["distCoef"]),
    read=read_panoptic,
    passed_over=("panel", "node", "provenance"),
    write=write_panoptic,
    unit="cm",
)
VOXELPOSE = Format(
    name="voxelpose",
    title="VoxelPose JSON",
    sniff=partial(Document.has_entry, keys=["R", "T", *_VOXELPOSE_MATRIX]),
    read=read_voxelpose,
    write=write_voxelpose,
    unit="mm",
)
FOUR_D_ASSOCIATION = Format(
    name="4d-association",
    title="4D-Association JSON",
    sniff=partial(Document.has_entry, keys=["K", "RT", "imgSize"]),
    read=read_four_d,
    write=write_four_d,
    unit="m",
)
MULTIVIEW_CALIB = Format(
    name="multiview-calib",
    title="multiview_calib JSON",
    sniff=sniff_multiview_calib,
    read=read_multiview_calib,
    write=write_multiview_calib,
    folder=True,
)
NERFSTUDIO = Format(
    name="nerfstudio",
    title="nerfstudio transforms.json",
    sniff=partial(Document.has_entry, keys=["transform_matrix"]),
    read=read_nerfstudio,
    passed_over=(
        *("camera_angle_x", "camera_angle_y", "aabb_scale", "scale", "offset", "sharpness"),
        *("applied_transform", "applied_scale", "colmap_im_id", "provenance"),
    ),
    write=write_nerfstudio,
)
