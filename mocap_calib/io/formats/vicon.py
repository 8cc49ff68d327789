"""Vicon's calibration .xcp, which is XML.

* A camera is called by its DEVICEID. ORIENTATION is a quaternion (x, y, z, w), the rotation to the
  camera (y down, z forward) from the world; POSITION is its centre in millimetres.
* VICON_RADIAL2 has a name, a centre and three coefficients; VICON_RADIAL of older files has two.
  They correct what was measured: its distance d in pixels from the principal point is multiplied by
  1 + k1 d^2 + k2 d^4 + k3 d^6. OpenCV's coefficients, which distort, are fitted to the inverse.
* A camera without a KeyFrame was not calibrated.
"""

from xml.etree.ElementTree import Element

import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.geometry.rotation import matrix_from_vector
from mocap_calib.io.cameras import CameraFile, RawCamera, collect_cameras, numbers
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.types import Floats

_SAMPLES = 200  # radii from the principal point to the farthest corner
_FITTED = 0.05  # pixels, well below what any detector resolves


def sniff(document: Document) -> bool:
    """Return whether this is XML of cameras with a DEVICEID."""
    root = document.xml
    return root is not None and root.tag == "Cameras" and root.find("Camera[@DEVICEID]") is not None


def read(document: Document) -> CameraFile:
    """Read the calibrated cameras. Raises FormatError."""
    root = document.xml
    elements = [] if root is None else root.findall("Camera")
    raws, notes = [], []
    for element in elements:
        name = element.get("DEVICEID", "")
        frames = element.findall("KeyFrames/KeyFrame")
        if not frames:
            notes.append(f"camera {name} is not calibrated and is left out")
            continue
        if len(frames) > 1:
            notes.append(f"camera {name} has {len(frames)} poses: the first is read")
        raws.append(_camera(element, frames[0], name, f"{document.source}: camera {name}"))
    return collect_cameras(raws, document.source, notes=notes)


def _camera(element: Element, frame: Element, name: str, where: str) -> RawCamera:
    """Return the camera of a KeyFrame. Raises FormatError."""

    def array(key: str, *counts: int, of: Element = frame) -> Floats:
        text = of.get(key)
        return numbers(text and text.split(), f"numbers {key}", where, *counts).ravel()

    size = array("SENSOR_SIZE", 2, of=element)
    (focal,) = array("FOCAL_LENGTH", 1)
    (aspect,) = array("PIXEL_ASPECT_RATIO", 1, of=element)
    middle, quaternion = array("PRINCIPAL_POINT", 2), array("ORIENTATION", 4)
    if not (focal > 0 and aspect > 0 and 0.5 < np.linalg.norm(quaternion) < 2):
        expected = "a focal length and an aspect above 0, and a unit quaternion"
        raise FormatError(where, expected, [focal, aspect, *quaternion], "calibrate it again")
    turn = np.linalg.norm(quaternion[:3])
    angle = 2 * np.arctan2(turn, quaternion[3])
    if frame.get("VICON_RADIAL2"):
        given = numbers(frame.get("VICON_RADIAL2", "").split()[3:], "VICON_RADIAL2", where, 2, 3)
    else:
        given = array("VICON_RADIAL", 2)
    farthest = np.hypot(*np.maximum(middle, size - middle))
    return RawCamera(
        name=name,
        size=size,
        matrix=[focal, focal / aspect, *middle],
        distortion=_distortion(given.ravel(), focal, farthest, where),
        rotation=matrix_from_vector(quaternion[:3] * (angle / max(turn, 1e-12))),
        centre=array("POSITION", 3),
    )


def _distortion(correction: Floats, focal: float, farthest: float, where: str) -> list[float]:
    """Return k1 k2 p1 p2 k3 of the inverse of a correction `[2 | 3]`.

    farthest: pixel of the image from the principal point. Raises FormatError where they do not fit.
    """
    if not correction.any():
        return [0.0] * 5
    measured = np.linspace(0, farthest, _SAMPLES)[1:]
    powers = 2 * np.arange(1, len(correction) + 1)
    ideal = measured * (1 + (measured[:, None] ** powers) @ correction)
    radius = ideal / focal
    system = ideal[:, None] * radius[:, None] ** [2, 4, 6]
    k1, k2, k3 = np.linalg.lstsq(system, measured - ideal, rcond=None)[0]
    error = np.abs(system @ [k1, k2, k3] - (measured - ideal)).max()
    if not error < _FITTED or (np.diff(ideal) <= 0).any():
        expected = "a distortion that OpenCV's model has"
        found = f"one that differs by {error:.2g} pixels"
        raise FormatError(where, expected, found, "calibrate it again")
    return [k1, k2, 0.0, 0.0, k3]


FORMAT = Format(
    name="vicon",
    title="Vicon .xcp",
    sniff=sniff,
    read=read,
    unit="mm",
)
