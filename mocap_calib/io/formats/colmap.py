"""COLMAP's models, binary and text: folders of cameras, images, points3D, rigs and frames.

pycolmap reads and writes them (`colmap_model.py`). It is loaded late, as it takes 0.3 s, and it
reads in a process of its own, as models are other people's files.

* An image is a camera here: a rig that stands still has one image a camera, called after it.
* There is no unit of length; a comment `# unit: m` in cameras.txt states ours.
"""

import tempfile
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from mocap_calib.io.cameras import CameraFile, check_rig
from mocap_calib.io.crash_guard import guard
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format, Written
from mocap_calib.results import ObservedPoints
from mocap_calib.types import ARBITRARY, CameraRig

_BINARY, _TEXT = ".bin", ".txt"
_CAMERAS, _IMAGES, _POINTS = "cameras", "images", "points3D"
_FILES = (_CAMERAS, _IMAGES, _POINTS, "rigs", "frames")
_EMPTY = {_BINARY: bytes(8), _TEXT: b""}  # a list of nothing
_UNIT = b"# unit:"
_UNIT_LENGTH = 40  # characters at most
# COLMAP leaves out the last image of a text whose line of points is missing
_LINE_OF_POINTS = b"\n\n"
_NO_SPACES = (r"[^\s\x00-\x1f\x7f-\xa0\ud800-\udfff]+", "no spaces")
_WITH_SPACES = "rename the camera, or write colmap-binary, which can hold spaces"
_check = partial(check_rig, fisheye=True, sizes="needed")
_NO_CONTROLS = (r"[^\x00-\x1f\x7f-\x9f\ud800-\udfff]+", "no control characters")


def sniff_binary(document: Document) -> bool:
    """Return whether this is a folder with cameras.bin."""
    return document.is_folder and _CAMERAS + _BINARY in document.names


def sniff_text(document: Document) -> bool:
    """Return whether this is a folder with cameras.txt, or cameras.txt itself."""
    if document.is_folder:
        return _CAMERAS + _TEXT in document.names
    return document.has_line(r"^\d+ +[A-Z_]+ +\d+ +\d+ ")


# --- reading


def read_binary(document: Document) -> CameraFile:
    """Read the images of a binary model as cameras, with the points that they see.

    Without images there are the cameras alone, by their numbers. Raises FormatError.
    """
    return _read(document, _BINARY)


def read_text(document: Document) -> CameraFile:
    """Read a text model as `read_binary` does. Raises FormatError."""
    return _read(document, _TEXT)


def _read(document: Document, ending: str) -> CameraFile:
    """Read a model, or its list of cameras alone. Raises FormatError."""
    files = {_CAMERAS + ending: document.content}
    if document.is_folder:
        files = {each.path.name: each.content for each in document.documents()}
    with_images = _IMAGES + ending in files
    files = {f"{name}{ending}": _EMPTY[ending] for name in (_CAMERAS, _IMAGES, _POINTS)} | files
    files = {name: files[name] for name in (each + ending for each in _FILES) if name in files}
    unit = b""
    if ending == _TEXT:
        files[_IMAGES + _TEXT] += _LINE_OF_POINTS
        lines = files[_CAMERAS + _TEXT].splitlines()
        unit = next((line for line in lines if line.startswith(_UNIT)), b"").removeprefix(_UNIT)
    with tempfile.TemporaryDirectory() as work:
        for name, content in files.items():
            (Path(work) / name).write_bytes(content)
        return guard(
            _read_model,
            Path(work),
            with_images,
            unit.decode("utf-8", "replace").strip()[:_UNIT_LENGTH],
            document.source,
            what="COLMAP model",
            library="COLMAP",
            source=document.source,
            size=sum(map(len, files.values())),
            packed=False,
        )


def _read_model(folder: Path, with_images: bool, unit: str, source: str) -> CameraFile:
    """Read a model in the process that is for it."""
    from mocap_calib.io.formats import colmap_model  # noqa: PLC0415 - takes 0.3 s

    return colmap_model.read(folder, with_images=with_images, unit=unit, source=source)


# --- writing


def write_binary(rig: CameraRig, provenance: Mapping[str, Any], points: ObservedPoints) -> Written:
    """Write a binary model; an image is called NAME.png. Raises MismatchError."""
    lost = _check(rig, provenance, "colmap-binary", names=_NO_CONTROLS, verdict=False)
    unit = () if rig.unit == ARBITRARY else ("the unit of length",)
    return _write(rig, points, _BINARY, (*unit, *lost))


def write_text(rig: CameraRig, provenance: Mapping[str, Any], points: ObservedPoints) -> Written:
    """Write a text model, with the unit; an image is called NAME.png. Raises MismatchError."""
    lost = _check(rig, provenance, "colmap", names=_NO_SPACES, remedy=_WITH_SPACES)
    written = _write(rig, points, _TEXT, lost)
    cameras, unit = _CAMERAS + _TEXT, b"%s %s\n" % (_UNIT, rig.unit.encode())
    return replace(written, files={**written.files, cameras: unit + written.files[cameras]})


def _write(rig: CameraRig, points: ObservedPoints, ending: str, lost: tuple[str, ...]) -> Written:
    """Write the files of a model with this ending."""
    from mocap_calib.io.formats import colmap_model  # noqa: PLC0415 - takes 0.3 s

    with colmap_model.silent_colmap(), tempfile.TemporaryDirectory() as work:
        model = colmap_model.build_model(rig, points)
        write = model.write_binary if ending == _BINARY else model.write_text
        write(work)
        files = {file + ending: (Path(work) / (file + ending)).read_bytes() for file in _FILES}
    if len(points.positions):
        what = "frame, individual and keypoint of a point (the points are in this order)"
        lost = (*lost, what)
    return Written(files, lost)


BINARY = Format(
    name="colmap-binary",
    title="COLMAP binary model",
    sniff=sniff_binary,
    read=read_binary,
    write=write_binary,
    folder=True,
    points=True,
)
TEXT = Format(
    name="colmap",
    title="COLMAP text model",
    sniff=sniff_text,
    read=read_text,
    write=write_text,
    folder=True,
    points=True,
)
