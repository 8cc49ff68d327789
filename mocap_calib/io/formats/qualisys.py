"""Qualisys' calibration (.qca.txt, which is XML) and the settings that QTM sends over its protocol.

* Lengths of pixels are in 64ths of a pixel; the principal point is of the sensor, of which the
  image is a part (`fov_video`). Distortions are those of OpenCV.
* `transform` has a camera's centre in millimetres, and r11 to r33, the rotation from world to a
  camera whose y points up and z back.
* Cameras that are not active keep an old pose.
"""

from collections.abc import Iterator, Sequence
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from mocap_calib.io.cameras import CameraFile, RawCamera, collect_cameras, numbers
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.types import Floats

_SUBPIXELS = 64  # of a pixel
_TO_OPENCV = np.array([[1.0], [-1.0], [-1.0]])
_FIELD = ("left", "top", "right", "bottom")
_LENS = ("focalLengthU", "focalLengthV", "centerPointU", "centerPointV", "skew")
_DISTORTION = (
    *("radialDistortion1", "radialDistortion2"),
    *("tangentalDistortion1", "tangentalDistortion2", "radialDistortion3"),
)
_ROTATION = tuple(f"r{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))


def _cameras(document: Document) -> Iterator[tuple[dict[str, str], dict[str, dict[str, str]]]]:
    """Yield the fields of each camera, and those of its parts."""
    for element in document.xml.iter() if document.xml is not None else ():
        parts = {_name(part): _fields(part) for part in element}
        if _name(element) == "camera" and {"transform", "intrinsic", "fov_video"} <= parts.keys():
            yield _fields(element), parts


def _name(element: Element) -> str:
    return element.tag.lower()


def _fields(element: Element) -> dict[str, str]:
    return {key.lower(): value for key, value in element.attrib.items()}


def sniff(document: Document) -> bool:
    """Return whether this is XML with a camera's transform, intrinsics and field of view."""
    return next(_cameras(document), None) is not None


def read(document: Document) -> CameraFile:
    """Read the active cameras, called by their serial numbers. Raises FormatError."""
    raws, left_out = [], []
    for fields, parts in _cameras(document):
        name = fields.get("serial", "")
        if fields.get("active", "1") == "0":
            left_out.append(name)
            continue

        def array(part: str, keys: Sequence[str], where: str = name, found: Any = parts) -> Floats:
            values = [found[part].get(key.lower()) for key in keys]
            source = f"{document.source}: camera {where}"
            return numbers(values, f"{part} with {', '.join(keys)}", source, len(keys))

        left, top, right, bottom = array("fov_video", _FIELD)
        fu, fv, cu, cv, skew = array("intrinsic", _LENS) / _SUBPIXELS
        raws.append(
            RawCamera(
                name=name,
                size=[right - left + 1, bottom - top + 1],
                matrix=[fu, skew, cu - left, 0, fv, cv - top, 0, 0, 1],
                distortion=array("intrinsic", _DISTORTION),
                rotation=_TO_OPENCV * array("transform", _ROTATION).reshape(3, 3),
                centre=array("transform", "xyz"),
            )
        )
    notes = [f"cameras that are not active are left out: {', '.join(left_out)}"] if left_out else []
    return collect_cameras(raws, document.source, notes=notes)


FORMAT = Format(
    name="qualisys",
    title="Qualisys .qca.txt or calibration XML",
    sniff=sniff,
    read=read,
    unit="mm",
)
