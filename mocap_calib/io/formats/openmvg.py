"""OpenMVG's sfm_data.json: views (images), the intrinsics that they share, and their poses.

* A view is a camera here, called after its image; one without a pose has no extrinsics.
* A pose has the rotation of cam_from_world, and the camera's centre in place of a translation.
* A camera has one focal length, and its model its own order of distortion coefficients.
* The file is written by cereal, a C++ library: maps are lists of key and value, objects stand
  behind a `ptr_wrapper`, and the name of a class is given where it occurs first, with a number
  (plus 2^31, the mark of the first time) that stands for it afterwards.
* There is no unit of length; `unit` at the top says ours.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from mocap_calib.errors import FormatError
from mocap_calib.io.camera_checks import make_camera, numbers
from mocap_calib.io.cameras import (
    CameraFile,
    Extrinsics,
    PlacedCamera,
    camera_of_image,
    cannot,
    collect_cameras,
    entries,
    extrinsics_from_centre,
    need_sizes,
    pinhole_matrix,
    terms,
    to_json,
)
from mocap_calib.io.document import Document, need
from mocap_calib.io.format import Format, Written
from mocap_calib.io.provenance import plain_fields, read_judgement
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


def sniff(document: Document) -> bool:
    """Return whether the file states a version of sfm_data."""
    return document.has("json", "sfm_data_version", "views", "intrinsics")


# --- reading


def parse(document: Document) -> CameraFile:
    """Read the views as cameras; those without intrinsics are left out. Raises FormatError."""
    document.mapping("views", "intrinsics")
    intrinsics = _parse_intrinsics(document)
    poses = dict(_map_items(document, "extrinsics"))
    placed: list[PlacedCamera] = []
    notes: list[str] = []
    for key, value in _map_items(document, "views"):
        where = f"{document.source}: view {key}"
        view = _pointed_data(value)
        need(view, ("filename", "id_intrinsic"), where)
        name = camera_of_image(str(view["filename"]))
        intrinsic = intrinsics.get(str(view["id_intrinsic"]))
        if intrinsic is None:
            notes.append(f"camera {name} has no intrinsics and is left out")
            continue
        model, fields = intrinsic
        camera = _parse_camera(name, model, fields, where)
        pose = poses.get(str(view.get("id_pose", "")))
        placed.append((camera, None if pose is None else _parse_pose(pose, where)))
    unit = str(document.tree.get("unit", ""))
    found = collect_cameras(placed, document.source, unit=unit, notes=notes)
    return replace(found, judgement=read_judgement(document.tree.get("provenance")))


def _map_items(document: Document, name: str) -> list[tuple[str, dict[str, Any]]]:
    """Return (key, value) of one of the file's maps; extrinsics may be missing.

    Raises FormatError.
    """
    if name == "extrinsics" and not document.tree.get(name):
        return []
    where = f"{document.source}: {name}"
    items = []
    for _, entry in entries(document.tree[name], f"a list of {name}", document.source):
        need(entry, ("key", "value"), where)
        value = entry["value"]
        if not isinstance(value, dict):
            found = type(value).__name__
            raise FormatError(where, "a value for each key", found, "export the cameras again")
        items.append((str(entry["key"]), value))
    return items


def _pointed_data(value: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of an object behind cereal's pointer; none where it is something else."""
    wrapper = value.get("ptr_wrapper")
    data = wrapper.get("data") if isinstance(wrapper, dict) else None
    return data if isinstance(data, dict) else {}


def _parse_intrinsics(document: Document) -> dict[str, tuple[str, dict[str, Any]]]:
    """Return the intrinsics: key -> model and fields. Raises FormatError."""
    models: dict[int, str] = {}
    found = {}
    for key, value in _map_items(document, "intrinsics"):
        number = value.get("polymorphic_id")
        number = number % _FIRST_TIME if isinstance(number, int) else -1
        if "polymorphic_name" in value:
            models[number] = str(value["polymorphic_name"])
        found[key] = (models.get(number, "unknown"), _pointed_data(value))
    return found


def _parse_camera(name: str, model: str, fields: Mapping[str, Any], where: str) -> Camera:
    """Return a camera without its place. Raises FormatError."""
    if model not in _MODELS:
        expected = f"one of the models {', '.join(_MODELS)}"
        raise FormatError(where, expected, model, "choose another camera model")
    key, order = _MODELS[model]
    lens_keys = [key] if key else []
    need(fields, ("width", "height", "focal_length", "principal_point", *lens_keys), where)
    point = numbers(fields["principal_point"], "a principal_point of 2", where).reshape(-1)
    lens = numbers(fields[key] if key else [], f"numbers {key}", where).reshape(-1)
    known = [index for index in order if index is not None]
    if len(point) != 2 or len(lens) != len(known):
        expected = f"a principal_point of 2 and the numbers {key}"
        raise FormatError(where, expected, f"{len(point)} and {len(lens)}", "mend them")
    focal = fields["focal_length"]
    return make_camera(
        name=name,
        size=[fields["width"], fields["height"]],
        matrix=pinhole_matrix(focal, focal, point[0], point[1]),
        distortion=[0.0 if index is None else lens[index] for index in order],
        fisheye=model == "fisheye",
        source=where,
    )


def _parse_pose(pose: Mapping[str, Any], where: str) -> Extrinsics:
    """Return the extrinsics of a view. Raises FormatError."""
    need(pose, ("rotation", "center"), where)
    return extrinsics_from_centre(pose["rotation"], pose["center"], where)


# --- writing


def write(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write a view, an intrinsic and a pose for each camera. Raises MismatchError."""
    need_sizes(rig, "openmvg")
    lost: list[str] = []
    models: list[str] = []
    intrinsics: list[dict[str, Any]] = []
    for view, camera in enumerate(rig.cameras):
        lost += _lost_focal_length(camera)
        intrinsic = _intrinsic(camera, models, pointer=len(rig.cameras) + view)
        intrinsics.append({"key": view, "value": intrinsic})
    document = {
        "sfm_data_version": "0.3",
        "root_path": "",
        "unit": rig.unit,
        "provenance": plain_fields(provenance),
        "views": [
            {"key": view, "value": _view(camera, view)} for view, camera in enumerate(rig.cameras)
        ],
        "intrinsics": intrinsics,
        "extrinsics": [
            {"key": view, "value": {"rotation": rotation.tolist(), "center": centre.tolist()}}
            for view, (rotation, centre) in enumerate(zip(rig.rotation, rig.centres, strict=True))
        ],
        "structure": [],
        "control_points": [],
    }
    return Written({"sfm_data.json": to_json(document)}, tuple(lost))


def _view(camera: Camera, view: int) -> dict[str, Any]:
    """Return an image of the camera, which has the intrinsics and the pose of the same number."""
    width, height = camera.size
    data = {
        "local_path": "",
        "filename": f"{camera.name}.png",
        "width": width,
        "height": height,
        "id_view": view,
        "id_intrinsic": view,
        "id_pose": view,
    }
    return {"polymorphic_id": _NO_NAME, "ptr_wrapper": _pointer(view, data)}


def _intrinsic(camera: Camera, models: list[str], *, pointer: int) -> dict[str, Any]:
    """Return the intrinsics of a camera. Raises MismatchError.

    models: that were named before; that of the camera is added.
    """
    model, lens = _format_lens(camera)
    if model in models:
        named: dict[str, Any] = {"polymorphic_id": models.index(model) + 1}
    else:
        models.append(model)
        named = {"polymorphic_id": _FIRST_TIME + len(models), "polymorphic_name": model}
    width, height = camera.size
    key, _ = _MODELS[model]
    data = {
        "width": width,
        "height": height,
        "focal_length": camera.focal,
        "principal_point": camera.matrix[:2, 2].tolist(),
        key: lens,
    }
    return named | {"ptr_wrapper": _pointer(pointer, data)}


def _pointer(number: int, data: Mapping[str, Any]) -> dict[str, Any]:
    return {"id": _FIRST_TIME + 1 + number, "data": dict(data)}


def _format_lens(camera: Camera) -> tuple[str, list[float]]:
    """Return the model of a camera and its distortion in the model's order.

    Raises MismatchError.
    """
    if camera.fisheye:
        return "fisheye", camera.distortion.tolist()
    k1, k2, p1, p2, k3 = terms(camera, 5, "openmvg").tolist()
    return "pinhole_brown_t2", [k1, k2, k3, p1, p2]


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
    read=parse,
    write=write,
)
