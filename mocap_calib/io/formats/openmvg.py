"""OpenMVG's sfm_data.json: views (images), the intrinsics that they share, and their poses.

* A view is a camera here, called after its image; one without a pose has no extrinsics.
* A pose has the rotation of cam_from_world, and the camera's centre in place of a translation.
* A camera has one focal length, and its model its own order of distortion coefficients.
* The file is written by cereal, a C++ library: maps are lists of key and value, objects stand
  behind a `ptr_wrapper`, and the name of a class is given where it occurs first, with a number
  (plus 2^31, the mark of the first time) that stands for it afterwards.
* There is no unit of length; `unit` at the top states ours.
"""

from collections.abc import Mapping
from functools import partial
from typing import Any, Generic, TypeVar

import msgspec
import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.account import Fields
from mocap_calib.io.cameras import (
    CameraFile,
    RawCamera,
    camera_of_image,
    cannot,
    check_rig,
    collect_cameras,
    lens_terms,
    numbers,
    to_json,
)
from mocap_calib.io.document import Document, need, typed
from mocap_calib.io.format import Format, Written
from mocap_calib.io.provenance import plain_fields
from mocap_calib.types import Camera, CameraRig

# model -> the key of its distortion, and where k1 k2 p1 p2 k3 stand in it (-1: it has no such)
_MODELS: dict[str, tuple[str, list[int]]] = {
    "pinhole": ("", []),
    "pinhole_radial_k1": ("disto_k1", [0]),
    "pinhole_radial_k3": ("disto_k3", [0, 1, -1, -1, 2]),
    "pinhole_brown_t2": ("disto_t2", [0, 1, 3, 4, 2]),
    "fisheye": ("fisheye", [0, 1, 2, 3]),
}
_FOCAL_TOLERANCE = 1e-3  # of the focal length: half a pixel at the edge of a common image
# cereal's marks of an object that comes for the first time, and of a class without a name
_FIRST_TIME = 2147483648
_NO_NAME = 1073741824
T = TypeVar("T")


class _View(msgspec.Struct):
    filename: str
    id_intrinsic: int
    id_pose: int | None = None


class _Pose(msgspec.Struct):
    rotation: Any
    center: Any


class _Pointer(msgspec.Struct, Generic[T]):
    data: T


class _Object(msgspec.Struct, Generic[T]):
    ptr_wrapper: _Pointer[T]
    polymorphic_id: int = 0
    polymorphic_name: str = ""


class _Item(msgspec.Struct, Generic[T]):
    key: int
    value: T


class _File(msgspec.Struct):
    views: list[_Item[_Object[_View]]]
    intrinsics: list[_Item[_Object[dict[str, Any]]]]
    extrinsics: list[_Item[_Pose]] | None = None
    unit: Any = ""
    provenance: Any = None


# --- reading


def read(document: Document) -> CameraFile:
    """Read the views as cameras; those without intrinsics are left out. Raises FormatError."""
    expected = "sfm_data with views, intrinsics and extrinsics"
    file = typed(document.mapping(), _File, document.source, expected)
    intrinsics = {each.key: each.value for each in file.intrinsics}
    models = {
        each.polymorphic_id % _FIRST_TIME: each.polymorphic_name
        for each in intrinsics.values()
        if each.polymorphic_name
    }
    poses: dict[int | None, _Pose] = {each.key: each.value for each in file.extrinsics or ()}
    raws: list[RawCamera] = []
    notes: list[str] = []
    for item in file.views:
        view = item.value.ptr_wrapper.data
        name = camera_of_image(view.filename)
        found = intrinsics.get(view.id_intrinsic)
        if found is None:
            notes.append(f"camera {name} has no intrinsics and is left out")
            continue
        model = models.get(found.polymorphic_id % _FIRST_TIME, "unknown")
        pose = poses.get(view.id_pose, _Pose(None, None))
        where = f"{document.source}: view {item.key}"
        fields = Fields(found.ptr_wrapper.data, document.account.asked)
        lens = _read_intrinsics(model, fields, where)
        raws.append(RawCamera(name=name, rotation=pose.rotation, centre=pose.center, **lens))
    return collect_cameras(
        raws, document.source, unit=file.unit, notes=notes, provenance=file.provenance
    )


def _read_intrinsics(model: str, fields: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return the fields of a `RawCamera` but its name and pose. Raises FormatError."""
    if model not in _MODELS:
        expected = f"one of the models {', '.join(_MODELS)}"
        raise FormatError(where, expected, model, "choose another camera model")
    need(fields, ("width", "height", "focal_length", "principal_point"), where)
    key, order = _MODELS[model]
    count = max(order, default=-1) + 1
    lens = numbers(fields.get(key, []), f"{count} numbers {key}", where, count).ravel()
    focal = fields["focal_length"]
    middle = numbers(fields["principal_point"], "two numbers principal_point", where, 2)
    return {
        "size": [fields["width"], fields["height"]],
        "matrix": [focal, focal, *middle],
        "distortion": np.append(lens, 0.0)[order],
        "fisheye": model == "fisheye",
    }


# --- writing


def write(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write a view, an intrinsic and a pose for each camera. Raises MismatchError."""
    lost = check_rig(rig, provenance, "openmvg", terms=5, fisheye=True, sizes="needed")
    models: list[str] = []
    views, intrinsics, poses = [], [], []
    for view, camera in enumerate(rig):
        lost = (*lost, *_lost_focal_length(camera))
        size = dict(zip(("width", "height"), camera.size, strict=True))
        image = {"local_path": "", "filename": f"{camera.name}.png", **size}
        image |= dict.fromkeys(("id_view", "id_intrinsic", "id_pose"), view)
        views.append({"polymorphic_id": _NO_NAME, "ptr_wrapper": _pointer(view, image)})
        model = "fisheye" if camera.fisheye else "pinhole_brown_t2"
        key, order = _MODELS[model]
        lens = {
            **size,
            "focal_length": camera.focal,
            "principal_point": camera.matrix[:2, 2],
            key: lens_terms(camera, len(order))[np.argsort(order)],
        }
        named: dict[str, Any] = {}
        if model not in models:
            models.append(model)
            named = {"polymorphic_id": _FIRST_TIME + len(models), "polymorphic_name": model}
        named = named or {"polymorphic_id": models.index(model) + 1}
        intrinsics.append(named | {"ptr_wrapper": _pointer(len(rig) + view, lens)})
        poses.append({"rotation": camera.rotation, "center": camera.centre})
    document = {
        "sfm_data_version": "0.3",
        "root_path": "",
        "unit": rig.unit,
        "provenance": plain_fields(provenance),
        "views": _map(views),
        "intrinsics": _map(intrinsics),
        "extrinsics": _map(poses),
        "structure": [],
        "control_points": [],
    }
    return Written({"sfm_data.json": to_json(document)}, lost)


def _pointer(number: int, data: Mapping[str, Any]) -> dict[str, Any]:
    return {"id": _FIRST_TIME + 1 + number, "data": data}


def _map(values: list[Any]) -> list[dict[str, Any]]:
    return [{"key": key, "value": value} for key, value in enumerate(values)]


def _lost_focal_length(camera: Camera) -> list[str]:
    """Return what is lost by one focal length.

    Raises MismatchError where that is more than rounding.
    """
    fx, fy = camera.matrix[0, 0], camera.matrix[1, 1]
    both = f"{fx:.2f} and {fy:.2f}"
    if abs(fx - fy) > _FOCAL_TOLERANCE * camera.focal:
        raise cannot("openmvg", camera.name, "one focal length", both)
    if fx == fy:
        return []
    return [f"the two focal lengths of {camera.name}, {both}: their mean is written"]


FORMAT = Format(
    name="openmvg",
    title="OpenMVG sfm_data.json",
    sniff=partial(Document.has, syntax="json", keys=["sfm_data_version", "views", "intrinsics"]),
    read=read,
    passed_over=("provenance", "structure", "control_points", "id", "id_view", "polymorphic_id"),
    write=write,
)
