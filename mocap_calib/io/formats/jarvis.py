"""JARVIS' YAML: a file of cv2.FileStorage for each camera, which the file's name names.

* intrinsicMatrix and R are those of row vectors, x = [X 1] [R; T] K: the transpose of ours.
* JARVIS itself uses k1 and k2 of the distortion alone.
* Lengths are millimetres; there are no image sizes.
"""

import re
from collections.abc import Mapping
from typing import Any

from mocap_calib.io.camera_checks import make_camera, make_extrinsics, numbers
from mocap_calib.io.cameras import FILE_NAME, CameraFile, need_names, terms, without_sizes
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format, Written
from mocap_calib.io.formats.opencv import format_file, format_matrix
from mocap_calib.types import CameraRig

_MATRIX = r"^intrinsicMatrix\s*:"


def sniff(document: Document) -> bool:
    """Return whether the camera matrix has the name that JARVIS gives it."""
    return document.syntax == "yaml" and re.search(_MATRIX, document.text, re.M) is not None


def parse(document: Document) -> CameraFile:
    """Read the camera. Raises FormatError."""
    data = document.mapping()
    matrix = numbers(data.get("intrinsicMatrix"), "a 3 x 3 intrinsicMatrix", document.source)
    camera = make_camera(
        name=document.stem,
        size=None,
        matrix=matrix.T,
        distortion=data.get("distortionCoefficients"),
        fisheye=False,
        source=document.source,
    )
    if "R" not in data or "T" not in data:
        return CameraFile((camera,), {})
    rotation = numbers(data["R"], "a 3 x 3 rotation R", document.source)
    extrinsics = make_extrinsics(rotation.T, data["T"], document.source)
    return CameraFile((camera,), {camera.name: extrinsics}, str(data.get("unit", "")))


def write(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write a file for each camera. Raises MismatchError."""
    need_names(rig.names, *FILE_NAME, "jarvis")
    files = {}
    simplified = []
    for view, camera in enumerate(rig.cameras):
        distortion = terms(camera, 5, "jarvis")
        if distortion[2:].any():
            simplified.append(camera.name)
        lines = [
            *format_matrix("intrinsicMatrix", camera.matrix.T),
            *format_matrix("distortionCoefficients", distortion[None]),
            *format_matrix("R", rig.rotation[view].T),
            *format_matrix("T", rig.translation[view][:, None]),
        ]
        files[f"{camera.name}.yaml"] = format_file(lines)
    return Written(files, (*without_sizes(rig), *_lost_terms(simplified)))


def _lost_terms(cameras: list[str]) -> tuple[str, ...]:
    """Return what JARVIS leaves out of the distortion of these cameras."""
    if not cameras:
        return ()
    names = ", ".join(cameras)
    return (f"the tangential terms and k3 of {names}, to JARVIS itself: it uses k1 and k2",)


FORMAT = Format(
    kind="cameras",
    name="jarvis",
    title="JARVIS YAML",
    sniff=sniff,
    read=parse,
    write=write,
    unit="mm",
    folder=True,
)
