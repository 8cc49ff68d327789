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
from typing import Any, Generic, TypeVar

import msgspec

from mocap_calib.errors import FormatError
from mocap_calib.io.camera_checks import numbers
from mocap_calib.io.cameras import (
    CameraFile,
    RawCamera,
    camera_of_image,
    cannot,
    check_rig,
    collect_cameras,
    lens_terms,
    pinhole_matrix,
    to_json,
)
from mocap_calib.io.document import Document, typed
from mocap_calib.io.format import Format, Written
from mocap_calib.io.provenance import plain_fields
from mocap_calib.types import Camera, CameraRig

# model -> the key of its distortion, and where k1 k2 p1 p2 k3 stand in it (None: it has no such)
_MODELS: dict[str, tuple[str, tuple[int | None, ...]]] = {
    "pinhole": ("", ()),
    "pinhole_radial_k1": ("disto_k1", (0,)),
    "pinhole_radial_k3": ("disto_k3", (0, 1, None, None, 2)),
    "pinhole_brown_t2": ("disto_t2", (0, 1, 3, 4, 2)),
    "fisheye": ("fisheye", (0, 1, 2, 3)),
}
_FOCAL_TOLERANCE = 1e-3  # of the focal length: half a pixel at the edge of a common image
# cereal's marks of an object that comes for the first time, and of a class without a name
_FIRST_TIME = 2147483648
_NO_NAME = 1073741824
T = TypeVar("T")
_EXPECTED = "sfm_data with views, intrinsics and extrinsics"


class _View(msgspec.Struct):
    filename: str
    id_intrinsic: int
    id_pose: int | None = None


class _Intrinsic(msgspec.Struct):
    width: Any
    height: Any
    focal_length: Any
    principal_point: tuple[float, float]
    disto_k1: Any = ()
    disto_k3: Any = ()
    disto_t2: Any = ()
    fisheye: Any = ()


class _Pose(msgspec.Struct):
    rotation: Any
    center: Any


class _Pointer(msgspec.Struct):
    data: dict[str, Any]


class _Object(msgspec.Struct):
    ptr_wrapper: _Pointer
    polymorphic_id: int = 0
    polymorphic_name: str = ""


class _Item(msgspec.Struct, Generic[T]):
    key: int
    value: T


class _File(msgspec.Struct):
    views: list[_Item[_Object]]
    intrinsics: list[_Item[_Object]]
    extrinsics: list[_Item[_Pose]] | None = None
    unit: Any = ""
    provenance: Any = None


def sniff(document: Document) -> bool:
    """Return whether the file states a version of sfm_data."""
    return document.has("json", "sfm_data_version", "views", "intrinsics")


# --- reading


def read(document: Document) -> CameraFile:
    """Read the views as cameras; those without intrinsics are left out. Raises FormatError."""
    file = typed(document.mapping(), _File, document.source, _EXPECTED)
    intrinsics = {each.key: each.value for each in file.intrinsics}
    models = {
        each.polymorphic_id % _FIRST_TIME: each.polymorphic_name
        for each in intrinsics.values()
        if each.polymorphic_name
    }
    poses = {each.key: each.value for each in file.extrinsics or ()}
    raws: list[RawCamera] = []
    notes: list[str] = []
    for item in file.views:
        where = f"{document.source}: view {item.key}"
        view = typed(item.value.ptr_wrapper.data, _View, where, _EXPECTED)
        name = camera_of_image(view.filename)
        found = intrinsics.get(view.id_intrinsic)
        if found is None:
            notes.append(f"camera {name} has no intrinsics and is left out")
            continue
        model = models.get(found.polymorphic_id % _FIRST_TIME, "unknown")
        pose = poses.get(-1 if view.id_pose is None else view.id_pose)
        raws.append(_read_camera(name, model, found.ptr_wrapper.data, pose, where))
    return collect_cameras(
        raws, document.source, unit=file.unit, notes=notes, provenance=file.provenance
    )


def _read_camera(
    name: str, model: str, fields: Mapping[str, Any], pose: _Pose | None, where: str
) -> RawCamera:
    """Return a camera. Raises FormatError."""
    if model not in _MODELS:
        expected = f"one of the models {', '.join(_MODELS)}"
        raise FormatError(where, expected, model, "choose another camera model")
    intrinsic = typed(fields, _Intrinsic, where, "intrinsics of OpenMVG")
    key, order = _MODELS[model]
    known = [index for index in order if index is not None]
    expected = f"{len(known)} numbers {key}"
    lens = numbers(getattr(intrinsic, key) if key else (), expected, where).reshape(-1)
    if len(lens) != len(known):
        raise FormatError(where, expected, f"{len(lens)}", "correct them")
    focal = intrinsic.focal_length
    return RawCamera(
        name=name,
        size=[intrinsic.width, intrinsic.height],
        matrix=pinhole_matrix(focal, focal, *intrinsic.principal_point),
        distortion=[0.0 if index is None else lens[index] for index in order],
        fisheye=model == "fisheye",
        rotation=None if pose is None else pose.rotation,
        centre=None if pose is None else pose.center,
    )


# --- writing


def write(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write a view, an intrinsic and a pose for each camera. Raises MismatchError."""
    lost = check_rig(rig, provenance, "openmvg", terms=5, fisheye=True, sizes="needed")
    models: list[str] = []
    views, intrinsics, poses = [], [], []
    for view, camera in enumerate(rig.cameras):
        lost = (*lost, *_lost_focal_length(camera))
        named = {"polymorphic_id": _NO_NAME, "ptr_wrapper": _pointer(view, _view(camera, view))}
        views.append({"key": view, "value": named})
        intrinsic = _intrinsic(camera, models, pointer=len(rig.cameras) + view)
        intrinsics.append({"key": view, "value": intrinsic})
        pose = {"rotation": rig.rotation[view].tolist(), "center": rig.centres[view].tolist()}
        poses.append({"key": view, "value": pose})
    document = {
        "sfm_data_version": "0.3",
        "root_path": "",
        "unit": rig.unit,
        "provenance": plain_fields(provenance),
        "views": views,
        "intrinsics": intrinsics,
        "extrinsics": poses,
        "structure": [],
        "control_points": [],
    }
    return Written({"sfm_data.json": to_json(document)}, lost)


def _view(camera: Camera, view: int) -> dict[str, Any]:
    """Return an image of the camera, which has the intrinsics and the pose of the same number."""
    width, height = camera.size
    image = {"local_path": "", "filename": f"{camera.name}.png", "width": width, "height": height}
    return image | dict.fromkeys(("id_view", "id_intrinsic", "id_pose"), view)


def _intrinsic(camera: Camera, models: list[str], *, pointer: int) -> dict[str, Any]:
    """Return the intrinsics of a camera.

    models: that were named before; that of the camera is added.
    """
    if camera.fisheye:
        model, lens = "fisheye", camera.distortion.tolist()
    else:
        k1, k2, p1, p2, k3 = lens_terms(camera, 5)
        model, lens = "pinhole_brown_t2", [k1, k2, k3, p1, p2]
    if model in models:
        named: dict[str, Any] = {"polymorphic_id": models.index(model) + 1}
    else:
        models.append(model)
        named = {"polymorphic_id": _FIRST_TIME + len(models), "polymorphic_name": model}
    width, height = camera.size
    data = {
        "width": width,
        "height": height,
        "focal_length": camera.focal,
        "principal_point": camera.matrix[:2, 2].tolist(),
        _MODELS[model][0]: lens,
    }
    return named | {"ptr_wrapper": _pointer(pointer, data)}


def _pointer(number: int, data: Mapping[str, Any]) -> dict[str, Any]:
    return {"id": _FIRST_TIME + 1 + number, "data": dict(data)}


def _lost_focal_length(camera: Camera) -> list[str]:
    """Return what is lost by one focal length.

    Raises MismatchError where that is more than rounding.
    """
    fx, fy = camera.matrix[0, 0], camera.matrix[1, 1]
    both = f"{fx:.2f} and {fy:.2f}"
    if abs(fx - fy) > _FOCAL_TOLERANCE * camera.focal:
        remedy = "calibrate with one focal length, or write another format"
        raise cannot("openmvg", camera.name, "one focal length", both, remedy)
    if fx == fy:
        return []
    return [f"the two focal lengths of {camera.name}, {both}: their mean is written"]


FORMAT = Format(
    kind="cameras",
    name="openmvg",
    title="OpenMVG sfm_data.json",
    sniff=sniff,
    read=read,
    write=write,
)
