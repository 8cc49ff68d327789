"""Reading cameras in any of the formats of `formats_cameras`.

Intrinsics are `read_cameras`; with extrinsics, `read_rig`; all that a file says, `load_cameras`.
"""

from dataclasses import replace
from functools import reduce
from pathlib import Path

import numpy as np

from mocap_calib.errors import MismatchError
from mocap_calib.io.cameras.formats import (
    CAMERA_FORMAT_NAMES,
    CAMERA_FORMATS,
    FOLDER_SUFFIXES,
    ONE_CAMERA,
    CameraFormat,
    camera_format,
)
from mocap_calib.io.cameras.source import CameraFile, Source, both
from mocap_calib.io.file import malformed, read_bytes
from mocap_calib.io.units import ARBITRARY, known_unit
from mocap_calib.types import Camera, CameraRig


def read_cameras(path: Path, name: str | None = None) -> tuple[Camera, ...]:
    """The cameras (intrinsics only) in a file, or in a folder; `name` is the format, where it is not to be recognised. Raises FormatError."""
    return load_cameras(path, name).cameras


def parse_cameras(text: str, source: str) -> tuple[Camera, ...]:
    """`read_cameras` on text; `source` stands for the file's path. Raises FormatError."""
    return parse_content(text.encode(), source).cameras


def read_rig(path: Path, name: str | None = None, unit: str | None = None) -> CameraRig:
    """The cameras and where they stand, all of them; `unit` is what a length of 1 is, where the file does not say.

    Raises FormatError, also when extrinsics are absent, and MismatchError where the file states another unit.
    """
    return make_rig(load_cameras(path, name, unit), str(path))


def parse_rig(text: str, source: str) -> CameraRig:
    """`read_rig` on text; `source` stands for the file's path. Raises FormatError."""
    return make_rig(parse_content(text.encode(), source), source)


def make_rig(found: CameraFile, source: str) -> CameraRig:
    """The rig that a file holds. Raises FormatError where a camera has no extrinsics."""
    bare = [camera.name for camera in found.cameras if camera.name not in found.extrinsics]
    if bare:
        raise malformed(
            source,
            "extrinsics (rotation and translation) of every camera",
            f"none of {', '.join(bare)}",
            "calibrate, or remove these cameras",
        )
    rotations, translations = zip(
        *(found.extrinsics[camera.name] for camera in found.cameras), strict=True
    )
    return CameraRig(found.cameras, np.stack(rotations), np.stack(translations), found.unit)


def load_cameras(path: Path, name: str | None = None, unit: str | None = None) -> CameraFile:
    """All that a file or a folder says of cameras; see `read_rig`. Raises FormatError and MismatchError."""
    if not path.is_dir():
        return parse_content(read_bytes(path), str(path), name, unit)
    files = sorted(
        file
        for file in path.iterdir()
        if file.suffix.lower() in FOLDER_SUFFIXES
        and file.is_file()
        and not file.name.startswith(".")
    )
    if not files:
        raise malformed(
            str(path),
            f"camera files ({', '.join(FOLDER_SUFFIXES)}) in the folder",
            "none",
            "give the file itself",
        )
    whole = Source(str(path), {file.name: read_bytes(file) for file in files}, folder=True)
    for each in _candidates(name):
        if each.sniff(whole):
            return _with_unit(each.parse(whole), each, str(path), unit)
    parts = [
        parse_content(content, f"{path}/{file}", name, unit)
        for file, content in whole.files.items()
        if file.lower().endswith(ONE_CAMERA)
    ]
    if not parts:
        raise malformed(
            str(path),
            f"camera files ({', '.join(ONE_CAMERA)}) in the folder",
            ", ".join(whole.files),
            "give the file itself",
        )
    return reduce(lambda found, more: both(found, more, str(path)), parts)


def looks_like_cameras(path: Path, content: bytes | None = None) -> bool:
    """Whether a file or a folder is of one of the camera formats; raises FormatError where its JSON, TOML or YAML is broken."""
    if content is not None or not path.is_dir():
        file = Source(str(path), {path.name: read_bytes(path) if content is None else content})
        return any(each.sniff(file) for each in CAMERA_FORMATS)
    whole = Source(
        str(path),
        {file.name: b"" for file in path.iterdir() if file.suffix.lower() in FOLDER_SUFFIXES},
        folder=True,
    )
    files = sorted(
        file
        for file in path.iterdir()
        if file.suffix.lower() in ONE_CAMERA and file.is_file() and not file.name.startswith(".")
    )
    return any(each.sniff(whole) for each in CAMERA_FORMATS if each.folder) or (
        bool(files) and looks_like_cameras(files[0])
    )


def parse_content(
    content: bytes, source: str, name: str | None = None, unit: str | None = None
) -> CameraFile:
    """`load_cameras` on the content of one file; `source` stands for its path."""
    file = Source(source, {Path(source).name or source: content})
    return _parse(file, name, unit)


def _parse(file: Source, name: str | None, unit: str | None) -> CameraFile:
    for each in _candidates(name):
        # a format that is named is taken at its word: its own complaint says more
        if name is not None or each.sniff(file):
            return _with_unit(each.parse(file), each, file.path, unit)
    found = (
        f"text that begins with {file.text.strip()[:20]!r}"
        if file.syntax != "binary" and file.text.strip()
        else "another file"
    )
    found = found if file.content.strip() else "an empty file"
    raise malformed(
        file.path,
        f"one of: {', '.join(CAMERA_FORMAT_NAMES)}",
        found,
        "export one of these, or name it",
    )


def _candidates(name: str | None) -> tuple[CameraFormat, ...]:
    return CAMERA_FORMATS if name is None else (camera_format(name),)


def _with_unit(found: CameraFile, form: CameraFormat, source: str, unit: str | None) -> CameraFile:
    """With the unit that the file states, else the user, else the format. Raises MismatchError where the file contradicts the user."""
    stated = known_unit(found.unit, source)
    if unit is not None and stated not in (ARBITRARY, unit):
        raise MismatchError(
            f"{source}: expected lengths in {stated}, as the file says, found --unit {unit}; leave it out"
        )
    if stated == ARBITRARY:
        stated = unit or form.unit or ARBITRARY
    return replace(found, unit=stated, notes=(*found.notes, *_alike(found)))


def _alike(found: CameraFile) -> list[str]:
    """Notes of cameras that stand in one place and look one way: a calibration that went wrong, or one copied."""
    placed = list(found.extrinsics.items())
    return [
        f"cameras {first} and {second} stand in the same place and look the same way: one of them is wrong"
        for k, (first, (rotation, translation)) in enumerate(placed)
        for second, (other, offset) in placed[k + 1 :]
        if np.array_equal(rotation, other) and np.array_equal(translation, offset)
    ]
