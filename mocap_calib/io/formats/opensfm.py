"""OpenSfM's and OpenDroneMap's reconstruction.json: a list of reconstructions, the largest first.

* A shot is a camera here, called after its image. Its pose is a rotation vector and a translation
  from the world; several shots share the lens of their `camera`.
* Focal lengths and principal points are in shares of the larger side of the image; the principal
  point is given from the middle of the image.
* Lengths are metres where images have GPS positions; the file does not state whether.
"""

from collections.abc import Mapping
from typing import Any

from mocap_calib.config import CORNER_OFFSET
from mocap_calib.errors import FormatError
from mocap_calib.io.cameras import (
    CameraFile,
    RawCamera,
    camera_of_image,
    collect_cameras,
    entries,
    numbers,
)
from mocap_calib.io.detections import is_list_of
from mocap_calib.io.document import Document, need
from mocap_calib.io.format import Format

# projection_type -> the distortions that it has, in OpenCV's order (0: it has no such)
_TERMS: dict[str, tuple[str, ...]] = {
    "perspective": ("k1", "k2", "", "", ""),
    "simple_radial": ("k1", "", "", "", ""),
    "radial": ("k1", "k2", "", "", ""),
    "brown": ("k1", "k2", "p1", "p2", "k3"),
    "fisheye": ("k1", "k2", "", ""),
    "fisheye_opencv": ("k1", "k2", "k3", "k4"),
}


def sniff(document: Document) -> bool:
    """Return whether this is a list of reconstructions with cameras and shots."""
    return document.syntax == "json" and is_list_of(document.tree, "cameras", "shots")


def read(document: Document) -> CameraFile:
    """Read the shots of the first reconstruction. Raises FormatError."""
    if not sniff(document):
        raise document.refuse("a list of reconstructions", "none")
    first, *others = document.tree
    notes = [f"{len(others)} smaller reconstructions are left out"] if others else []
    lenses = dict(entries(first["cameras"], document.source, "projection_type", "width", "height"))
    raws = []
    for image, shot in entries(first["shots"], document.source, "camera"):
        where = f"{document.source}: shot {image}"
        need(lenses, [str(shot["camera"])], where)
        lens = _lens(lenses[str(shot["camera"])], where)
        place: dict[str, Any] = {
            "rotation": shot.get("rotation"),
            "translation": shot.get("translation"),
        }
        raws.append(RawCamera(name=camera_of_image(image), **lens, **place))
    return collect_cameras(raws, document.source, notes=notes)


def _lens(fields: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return the intrinsics of a camera. Raises FormatError."""
    model = str(fields["projection_type"])
    if model not in _TERMS:
        raise FormatError(where, f"a projection_type of {', '.join(_TERMS)}", model, "undistort")
    size = numbers([fields["width"], fields["height"]], "a size", where, 2)
    fx = fields.get("focal_x", fields.get("focal"))
    shares = [fx, fields.get("focal_y", fx), fields.get("c_x", 0.0), fields.get("c_y", 0.0)]
    lens = numbers(shares, "focal lengths and principal point", where, 4) * size.max()
    lens[2:] += size / 2 - CORNER_OFFSET
    return {
        "size": size,
        "matrix": lens,
        "distortion": [fields.get(term, 0.0) if term else 0.0 for term in _TERMS[model]],
        "fisheye": model.startswith("fisheye"),
    }


FORMAT = Format(
    name="opensfm",
    title="OpenSfM reconstruction.json",
    sniff=sniff,
    read=read,
    passed_over=(
        *("orientation", "capture_time", "gps_dop", "gps_position", "compass", "scale", "vertices"),
        *("merge_cc", "covariance", "points", "biases", "reference_lla", "rig_cameras"),
        *("rig_instances", "faces", "normals", "colors"),
    ),
)
