"""OpenMVG's sfm_data.json: views, intrinsics and extrinsics (rotation of camera from world, and the camera's centre)."""

from collections.abc import Mapping
from typing import Any

from mocap_calib.io.cameras.colmap import stem
from mocap_calib.io.cameras.intrinsics import make_camera, make_extrinsics, numbers
from mocap_calib.io.cameras.source import (
    CameraFile,
    Source,
    cannot,
    entries,
    need,
    need_sizes,
    terms,
    to_json,
    unique,
)
from mocap_calib.io.file import malformed
from mocap_calib.io.registry import Written
from mocap_calib.types import Camera, CameraRig

# model -> (the key of its distortion, where k1 k2 p1 p2 k3 stand in it)
_MODELS: dict[str, tuple[str, tuple[int | None, ...]]] = {
    "pinhole": ("", ()),
    "pinhole_radial_k1": ("disto_k1", (0,)),
    "pinhole_radial_k3": ("disto_k3", (0, 1, None, None, 2)),
    "pinhole_brown_t2": ("disto_t2", (0, 1, 3, 4, 2)),
    "fisheye": ("fisheye", (0, 1, 2, 3)),
}
_SQUARE = 1e-3  # of the focal length: half a pixel at the edge of a common image
_NEW = 2147483648  # cereal's mark of an object that comes for the first time


def sniff(source: Source) -> bool:
    """By the version that it states."""
    return source.has("json", "sfm_data_version", "views", "intrinsics")


def parse(source: Source) -> CameraFile:
    """A view is a camera, called as its image; a view without a pose has no extrinsics. Raises FormatError."""
    source.mapping("views", "intrinsics")
    intrinsics, poses = _intrinsics(source), dict(_values(source, "extrinsics"))
    cameras, extrinsics, notes = [], {}, []
    for key, value in _values(source, "views"):
        view, where = _data(value), f"{source.path}: view {key}"
        need(view, ("filename", "id_intrinsic"), where)
        name = stem(str(view["filename"]))
        if str(view["id_intrinsic"]) not in intrinsics:
            notes.append(f"camera {name} has no intrinsics and is left out")
            continue
        cameras.append(_camera(name, *intrinsics[str(view["id_intrinsic"])], where))
        pose = poses.get(str(view.get("id_pose", "")))
        if pose is not None:
            need(pose, ("rotation", "center"), where)
            rotation, centre = make_extrinsics(pose["rotation"], pose["center"], where)
            extrinsics[name] = (rotation, -rotation @ centre)
    return CameraFile(
        unique(cameras, source.path), extrinsics, str(source.tree.get("unit", "")), tuple(notes)
    )


def _values(source: Source, key: str) -> list[tuple[str, dict[str, Any]]]:
    """(key, value) of one of the file's maps, which are lists. Raises FormatError."""
    if key not in ("views", "intrinsics") and not source.tree.get(key):
        return []
    found = []
    for _, entry in entries(source.tree[key], f"a list of {key}", source.path):
        need(entry, ("key", "value"), f"{source.path}: {key}")
        if not isinstance(entry["value"], dict):
            raise malformed(
                f"{source.path}: {key}",
                "a value for each key",
                type(entry["value"]).__name__,
                "export the cameras again",
            )
        found.append((str(entry["key"]), entry["value"]))
    return found


def _data(value: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of an object behind cereal's pointer; none where it is something else."""
    wrapper = value.get("ptr_wrapper")
    data = wrapper.get("data") if isinstance(wrapper, dict) else None
    return data if isinstance(data, dict) else {}


def _intrinsics(source: Source) -> dict[str, tuple[str, dict[str, Any]]]:
    """Key -> (model, fields). A model is named where it comes for the first time, and has a number afterwards."""
    names: dict[int, str] = {}
    found = {}
    for key, value in _values(source, "intrinsics"):
        number = value.get("polymorphic_id")
        number = number % _NEW if isinstance(number, int) else -1
        if "polymorphic_name" in value:
            names[number] = str(value["polymorphic_name"])
        found[key] = (names.get(number, "unknown"), _data(value))
    return found


def _camera(name: str, model: str, fields: Mapping[str, Any], where: str) -> Camera:
    if model not in _MODELS:
        raise malformed(
            where, f"one of the models {', '.join(_MODELS)}", model, "choose another camera model"
        )
    key, order = _MODELS[model]
    need(
        fields,
        ("width", "height", "focal_length", "principal_point", *([key] if key else [])),
        where,
    )
    point = numbers(fields["principal_point"], "a principal_point of 2", where).reshape(-1)
    given = numbers(fields[key] if key else [], f"numbers {key}", where).reshape(-1)
    if len(point) != 2 or len(given) != len([k for k in order if k is not None]):
        raise malformed(
            where,
            f"a principal_point of 2 and the numbers {key}",
            f"{len(point)} and {len(given)}",
            "mend them",
        )
    lens = [0.0 if k is None else given[k] for k in order]
    focal = fields["focal_length"]
    matrix = [[focal, 0, point[0]], [0, focal, point[1]], [0, 0, 1]]
    return make_camera(
        name, [fields["width"], fields["height"]], matrix, lens, model == "fisheye", where
    )


# --- writing


def write(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:  # noqa: ARG001 - the writers' signature
    """A view, an intrinsic and a pose for each camera. Raises MismatchError."""
    need_sizes(rig, "openmvg")
    views, intrinsics, poses, lost = [], [], [], []
    models: list[str] = []
    for v, camera in enumerate(rig.cameras):
        lost += _square(camera)
        width, height = camera.size
        view = {
            "local_path": "",
            "filename": f"{camera.name}.png",
            "width": width,
            "height": height,
            "id_view": v,
            "id_intrinsic": v,
            "id_pose": v,
        }
        views.append(
            {"key": v, "value": {"polymorphic_id": 1073741824, "ptr_wrapper": _pointer(v, view)}}
        )
        model, lens = _lens(camera)
        named = (
            {"polymorphic_id": models.index(model) + 1}
            if model in models
            else {"polymorphic_id": _NEW + len(models) + 1, "polymorphic_name": model}
        )
        models += [] if model in models else [model]
        middle = {
            "focal_length": camera.focal,
            "principal_point": camera.matrix[:2, 2].tolist(),
            _MODELS[model][0]: lens,
        }
        data = {"width": width, "height": height} | middle
        intrinsics.append(
            {"key": v, "value": named | {"ptr_wrapper": _pointer(len(rig.cameras) + v, data)}}
        )
        poses.append(
            {
                "key": v,
                "value": {"rotation": rig.rotation[v].tolist(), "center": rig.centres[v].tolist()},
            }
        )
    head = {"sfm_data_version": "0.3", "root_path": "", "unit": rig.unit}
    tail: dict[str, list[Any]] = {"structure": [], "control_points": []}
    return Written(
        {
            "sfm_data.json": to_json(
                head | {"views": views, "intrinsics": intrinsics, "extrinsics": poses} | tail
            )
        },
        tuple(lost),
    )


def _pointer(number: int, data: Mapping[str, Any]) -> dict[str, Any]:
    return {"id": _NEW + 1 + number, "data": dict(data)}


def _lens(camera: Camera) -> tuple[str, list[float]]:
    """The model, and its numbers in its order."""
    if camera.fisheye:
        return "fisheye", camera.distortion.tolist()
    k1, k2, p1, p2, k3 = terms(camera, 5, "openmvg").tolist()
    return "pinhole_brown_t2", [k1, k2, k3, p1, p2]


def _square(camera: Camera) -> list[str]:
    """What is lost by one focal length. Raises MismatchError where that is more than rounding."""
    fx, fy = camera.matrix[0, 0], camera.matrix[1, 1]
    if abs(fx - fy) > _SQUARE * camera.focal:
        raise cannot(
            "openmvg",
            camera.name,
            "one focal length",
            f"{fx:.2f} and {fy:.2f}",
            "calibrate with one focal length, or write another format",
        )
    return (
        []
        if fx == fy
        else [
            f"the two focal lengths of {camera.name}, {fx:.2f} and {fy:.2f}: their mean is written"
        ]
    )
