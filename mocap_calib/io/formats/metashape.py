"""Metashape's cameras.xml (Agisoft; Export Cameras).

* A camera is called by its label; its `transform` is the 4 x 4 matrix from the camera (x right, y
  down, z forward) to the chunk. The chunk's own leads to the world, in metres where it has a scale.
* f is the focal length along y, f + b1 along x; the principal point is given from the middle of the
  image, and pixels have their corners at integers. p1 and p2 are OpenCV's p2 and p1.
* k4 is a coefficient that OpenCV's pinhole model lacks; a fisheye has it, but no p1 and p2.
"""

from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from mocap_calib.config import CORNER_OFFSET
from mocap_calib.errors import FormatError
from mocap_calib.io.cameras import CameraFile, RawCamera, camera_of_image, collect_cameras, numbers
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.types import Floats

_TERMS = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2")


def sniff(document: Document) -> bool:
    """Return whether this is XML of a chunk with sensors and cameras."""
    root = document.xml
    return root is not None and root.find("chunk/sensors/sensor") is not None


def read(document: Document) -> CameraFile:
    """Read the cameras of the first chunk. Raises FormatError."""
    root = document.xml
    chunk = None if root is None else root.find("chunk")
    if chunk is None:
        raise document.refuse("a chunk of cameras", "none")
    sensors = {each.get("id"): each for each in chunk.iterfind("sensors/sensor")}
    world, has_scale = _world(chunk, document.source)
    raws, notes = [], []
    for element in chunk.iterfind(".//camera"):
        name = element.get("label", "")
        where = f"{document.source}: camera {name}"
        sensor = sensors.get(element.get("sensor_id"))
        calibration = None if sensor is None else _calibration(sensor)
        if sensor is None or calibration is None:
            notes.append(f"camera {name} has no calibration and is left out")
            continue
        place: dict[str, Any] = {}
        if (text := element.findtext("transform")) is not None:
            pose = world @ numbers(text.split(), "a 4 x 4 transform", where, 16).reshape(4, 4)
            with np.errstate(all="ignore"):  # numbers of a damaged file
                rotation = pose[:3, :3].T / np.cbrt(np.linalg.det(pose[:3, :3]))
            place = {"rotation": rotation, "centre": pose[:3, 3]}
        lens = _lens(calibration, sensor, where)
        raws.append(RawCamera(name=camera_of_image(name), **lens, **place))
    unit = "m" if has_scale else ""
    return collect_cameras(raws, document.source, unit=unit, notes=notes)


def _calibration(sensor: Element) -> Element | None:
    """Return the calibration that was adjusted, else the one that there is."""
    adjusted = sensor.find("calibration[@class='adjusted']")
    return sensor.find("calibration") if adjusted is None else adjusted


def _lens(calibration: Element, sensor: Element, where: str) -> dict[str, Any]:
    """Return the intrinsics of a sensor. Raises FormatError."""
    resolution = calibration.find("resolution")
    resolution = sensor.find("resolution") if resolution is None else resolution
    sides = [] if resolution is None else [resolution.get("width"), resolution.get("height")]
    size = numbers(sides, "a resolution", where, 2)
    texts = [calibration.findtext(term) or "0" for term in _TERMS]
    f, cx, cy, b1, b2, *terms = numbers(texts, f"numbers {', '.join(_TERMS)}", where, len(_TERMS))
    k1, k2, k3, k4, p1, p2 = terms
    fisheye = calibration.get("type") == "fisheye"
    if calibration.get("type") not in ("frame", "fisheye") or (any((p1, p2)) if fisheye else k4):
        expected = "a calibration of type frame without k4, or fisheye without p1 and p2"
        raise FormatError(where, expected, calibration.get("type"), "calibrate with one of them")
    cx, cy = size / 2 + [cx, cy] - CORNER_OFFSET
    return {
        "size": size,
        "matrix": [f + b1, b2, cx, 0, f, cy, 0, 0, 1],
        "distortion": [k1, k2, k3, k4] if fisheye else [k1, k2, p2, p1, k3],
        "fisheye": fisheye,
    }


def _world(chunk: Element, source: str) -> tuple[Floats, bool]:
    """Return the `[4, 4]` transform of the chunk, and whether it has a scale.

    Raises FormatError.
    """
    transform, found = np.eye(4), chunk.find("transform")
    if found is None or found.findtext("scale") is None:
        return transform, False
    parts = [(found.findtext(each) or "").split() for each in ("rotation", "translation", "scale")]
    rotation = numbers(parts[0], "the rotation of the chunk", source, 9).reshape(3, 3)
    transform[:3, 3] = numbers(parts[1], "the translation of the chunk", source, 3)
    transform[:3, :3] = rotation * numbers(parts[2], "the scale of the chunk", source, 1)
    return transform, True


FORMAT = Format(
    name="metashape",
    title="Metashape cameras.xml",
    sniff=sniff,
    read=read,
)
