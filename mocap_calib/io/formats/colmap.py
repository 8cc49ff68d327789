"""COLMAP's models, binary and text: folders of cameras, images, points3D, rigs and frames.

pycolmap reads and writes them (`colmap_model.py`). It is loaded late, as it takes 0.3 s, and it
reads in a process of its own, as models are other people's files.

* An image is a camera here: a rig that stands still has one image a camera, called after it.
* There is no unit of length; a comment `# unit: m` in cameras.txt says ours.
"""

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from mocap_calib.io.cameras import (
    COLMAP_LENSES,
    CameraFile,
    need_names,
    need_sizes,
    without_verdict,
)
from mocap_calib.io.crash_guard import guard
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format, Written
from mocap_calib.io.units import ARBITRARY
from mocap_calib.results import ObservedPoints
from mocap_calib.types import CameraRig

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
_NO_CONTROLS = (r"[^\x00-\x1f\x7f-\x9f\ud800-\udfff]+", "no control characters")


def sniff_binary(document: Document) -> bool:
    """Return whether this is a folder with cameras.bin."""
    return document.is_folder and _CAMERAS + _BINARY in document.names


def sniff_text(document: Document) -> bool:
    """Return whether this is a folder with cameras.txt, or cameras.txt itself."""
    if document.is_folder:
        return _CAMERAS + _TEXT in document.names
    if document.syntax != "yaml":
        return False
    rows = [line.split() for line in document.text.splitlines()[:8]]
    return any(len(row) > 1 and row[1] in COLMAP_LENSES for row in rows)


# --- reading


def parse_binary(document: Document) -> CameraFile:
    """Read the images of a binary model as cameras, with the points that they see.

    Without images there are the cameras alone, by their numbers. Raises FormatError.
    """
    return _parse(document, _BINARY)


def parse_text(document: Document) -> CameraFile:
    """Read a text model as `parse_binary` does. Raises FormatError."""
    return _parse(document, _TEXT)


def _parse(document: Document, ending: str) -> CameraFile:
    """Read a model, or its list of cameras alone. Raises FormatError."""
    files = {_CAMERAS + ending: document.content}
    if document.is_folder:
        files = {each.path.name: each.content for each in document.documents()}
    with_images = _IMAGES + ending in files
    for name in (_CAMERAS, _IMAGES, _POINTS):
        files.setdefault(name + ending, _EMPTY[ending])
    if ending == _TEXT:
        files[_IMAGES + _TEXT] += _LINE_OF_POINTS
    own = {name + ending: files[name + ending] for name in _FILES if name + ending in files}
    unit = _find_unit(own[_CAMERAS + ending]) if ending == _TEXT else ""
    size = sum(map(len, own.values()))
    with tempfile.TemporaryDirectory() as work:
        for name, content in own.items():
            (Path(work) / name).write_bytes(content)
        return guard(
            _read_model,
            Path(work),
            with_images,
            unit,
            document.source,
            what="COLMAP model",
            library="COLMAP",
            source=document.source,
            size=size,
            packed=False,
        )


def _read_model(folder: Path, with_images: bool, unit: str, source: str) -> CameraFile:
    """Read a model in the process that is for it."""
    from mocap_calib.io.formats import colmap_model  # noqa: PLC0415 - takes 0.3 s

    return colmap_model.read(folder, with_images=with_images, unit=unit, source=source)


def _find_unit(content: bytes) -> str:
    """Return the unit in the comment that `write_text` makes, "" where there is none."""
    for line in content.splitlines():
        if line.startswith(_UNIT):
            return line.removeprefix(_UNIT).decode("utf-8", "replace").strip()[:_UNIT_LENGTH]
    return ""


# --- writing


def write_binary(rig: CameraRig, provenance: Mapping[str, Any], points: ObservedPoints) -> Written:
    """Write a binary model; an image is called NAME.png. Raises MismatchError."""
    need_names(rig.names, *_NO_CONTROLS, "colmap-binary")
    written = _write(rig, points, "colmap-binary", _BINARY)
    return replace(written, lost=(*written.lost, *without_verdict(provenance)))


def write_text(rig: CameraRig, provenance: Mapping[str, Any], points: ObservedPoints) -> Written:
    """Write a text model, with the unit; an image is called NAME.png. Raises MismatchError."""
    need_names(rig.names, *_NO_SPACES, "colmap", _WITH_SPACES)
    written = _write(rig, points, "colmap", _TEXT)
    cameras = _CAMERAS + _TEXT
    unit = b"%s %s\n" % (_UNIT, rig.unit.encode())
    return Written({**written.files, cameras: unit + written.files[cameras]}, written.lost)


def _write(rig: CameraRig, points: ObservedPoints, name: str, ending: str) -> Written:
    """Write the files of a model with this ending. name: of the format. Raises MismatchError."""
    from mocap_calib.io.formats import colmap_model  # noqa: PLC0415 - takes 0.3 s

    need_sizes(rig, name)
    with colmap_model.silent_colmap(), tempfile.TemporaryDirectory() as work:
        model = colmap_model.build_model(rig, points)
        write = model.write_binary if ending == _BINARY else model.write_text
        write(work)
        files = {file + ending: (Path(work) / (file + ending)).read_bytes() for file in _FILES}
    return Written(files, tuple(_list_losses(rig, points, ending)))


def _list_losses(rig: CameraRig, points: ObservedPoints, ending: str) -> Iterator[str]:
    """Yield what a model with this ending does not hold, in words that follow "does not hold"."""
    if ending == _BINARY and rig.unit != ARBITRARY:
        yield "the unit of length"
    if len(points.positions):
        yield "frame, individual and keypoint of a point (the points are in this order)"


BINARY = Format(
    kind="cameras",
    name="colmap-binary",
    title="COLMAP binary model",
    sniff=sniff_binary,
    read=parse_binary,
    write=write_binary,
    folder=True,
    points=True,
)
TEXT = Format(
    kind="cameras",
    name="colmap",
    title="COLMAP text model",
    sniff=sniff_text,
    read=parse_text,
    write=write_text,
    folder=True,
    points=True,
)
