"""EasyMocap's pair of files: intri.yml and extri.yml in a folder. Names are keys of FileStorage there."""

import re
from collections.abc import Mapping
from typing import Any

from mocap_calib.geometry.rotation import vector_from_matrix
from mocap_calib.io.cameras.intrinsics import make_camera, make_extrinsics
from mocap_calib.io.cameras.source import CameraFile, Source, need_names, terms, unique
from mocap_calib.io.cameras.yaml_files import file_storage, opencv_matrix
from mocap_calib.io.file import malformed
from mocap_calib.io.registry import Written
from mocap_calib.types import CameraRig

_INTRI, _EXTRI = "intri.yml", "extri.yml"


def sniff(source: Source) -> bool:
    """A folder with intri.yml, or one of the two by its list of names."""
    if source.folder:
        return _INTRI in source.files
    return source.syntax == "yaml" and re.search(r"^names\s*:", source.text, re.M) is not None


def parse(source: Source) -> CameraFile:
    """Cameras without extrinsics are kept as such: an intri.yml often has more than its extri.yml. Raises FormatError."""
    if not source.folder:
        return _parse(source, source.path, {}, source.path)
    extri = source.of(_EXTRI) if _EXTRI in source.files else None
    return _parse(
        source.of(_INTRI),
        f"{source.path}/{_INTRI}",
        extri.mapping() if extri else {},
        extri.path if extri else "",
    )


def _parse(intri: Source, where: str, extri: Mapping[str, Any], extri_path: str) -> CameraFile:
    data = intri.mapping("names")
    names = data["names"]
    if not isinstance(names, list):
        raise malformed(where, "a list of names", type(names).__name__, "export the cameras again")
    cameras, extrinsics = [], {}
    for name in map(str, names):
        if f"K_{name}" not in data:
            remedy = (
                f"give a folder in which it is called {_EXTRI}, beside its {_INTRI}"
                if any(key.startswith("R_") for key in map(str, data))
                else "mend the list"
            )
            raise malformed(
                where, f"the matrix K_{name} of the camera {name} in names", "none", remedy
            )
        size = (
            [data[f"W_{name}"], data[f"H_{name}"]]
            if {f"W_{name}", f"H_{name}"} <= data.keys()
            else None
        )
        distortion = data.get(f"dist_{name}", data.get(f"D_{name}"))
        cameras.append(
            make_camera(name, size, data[f"K_{name}"], distortion, False, f"{where}: camera {name}")
        )
        rotation = extri.get(f"Rot_{name}", extri.get(f"R_{name}"))
        if rotation is not None and f"T_{name}" in extri:
            extrinsics[name] = make_extrinsics(
                rotation, extri[f"T_{name}"], f"{extri_path}: camera {name}"
            )
    return CameraFile(unique(cameras, where), extrinsics, str(data.get("unit", "")))


def write(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:  # noqa: ARG001 - the writers' signature
    """Both files. Raises MismatchError."""
    need_names(rig.names, r"[A-Za-z0-9_-]{1,80}", "letters, digits, - and _", "easymocap")
    names = ["names:", *(f'  - "{name}"' for name in rig.names)]
    intri, extri = list(names), list(names)
    for v, camera in enumerate(rig.cameras):
        intri += opencv_matrix(f"K_{camera.name}", camera.matrix)
        intri += opencv_matrix(f"dist_{camera.name}", terms(camera, 5, "easymocap")[None])
        intri += (
            [f"H_{camera.name}: {camera.size[1]}", f"W_{camera.name}: {camera.size[0]}"]
            if 0 not in camera.size
            else []
        )
        extri += opencv_matrix(f"R_{camera.name}", vector_from_matrix(rig.rotation[v])[:, None])
        extri += opencv_matrix(f"Rot_{camera.name}", rig.rotation[v]) + opencv_matrix(
            f"T_{camera.name}", rig.translation[v][:, None]
        )
    return Written({_INTRI: file_storage(intri), _EXTRI: file_storage(extri)})
