"""Reading cameras: anipose TOML (also Pose2Sim, FreeMoCap, caliscope), OpenCV and ROS YAML, our own YAML.

The format is recognised by content. Intrinsics are `read_cameras`; with extrinsics, `read_rig`.
"""

import re
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mocap_calib.io.intrinsics import camera_from_fields, make_camera, make_extrinsics, one_field
from mocap_calib.io.reading import decode, malformed, read_bytes
from mocap_calib.types import Camera, CameraRig, Floats

VERSION = 1
_SUFFIXES = (".yml", ".yaml", ".toml")
_MATRIX = ("camera_matrix", "K", "M1", "intrinsic_matrix")
_DISTORTION = ("distortion_coefficients", "dist_coeffs", "distCoeffs", "dist_coeff", "D", "D1")
_ROTATION = ("rvec", "R", "rotation", "rotation_matrix", "rotation_vector")
_TRANSLATION = ("tvec", "T", "t", "translation", "translation_vector")


@dataclass(frozen=True)
class _Cameras:
    """What one file says. extrinsics: (rotation, translation) by camera name, for the cameras that have them."""

    cameras: tuple[Camera, ...]
    extrinsics: dict[str, tuple[Floats, Floats]]
    unit: str


@dataclass(frozen=True)
class _Reader:
    name: str
    sniff: Callable[[str], bool]
    parse: Callable[[str, str], _Cameras]


def read_cameras(path: Path) -> tuple[Camera, ...]:
    """The cameras (intrinsics only) in a file, or in a folder of files with one camera each. Raises FormatError."""
    return _read(path).cameras


def parse_cameras(text: str, source: str) -> tuple[Camera, ...]:
    """`read_cameras` on text; `source` stands for the file's path. Raises FormatError."""
    return _parse(text, source).cameras


def read_rig(path: Path) -> CameraRig:
    """The cameras and where they stand, all of them. Raises FormatError, also when extrinsics are absent."""
    return _rig(_read(path), str(path))


def parse_rig(text: str, source: str) -> CameraRig:
    """`read_rig` on text; `source` stands for the file's path. Raises FormatError."""
    return _rig(_parse(text, source), source)


def _rig(found: _Cameras, source: str) -> CameraRig:
    bare = [camera.name for camera in found.cameras if camera.name not in found.extrinsics]
    if bare:
        raise malformed(source, "extrinsics (rotation and translation) of every camera", f"none of {', '.join(bare)}", "calibrate, or remove these cameras")
    rotations, translations = zip(*(found.extrinsics[camera.name] for camera in found.cameras), strict=True)
    return CameraRig(found.cameras, np.stack(rotations), np.stack(translations), found.unit)


def _read(path: Path) -> _Cameras:
    if not path.is_dir():
        return _parse(decode(read_bytes(path), str(path)), str(path))
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in _SUFFIXES and file.is_file())
    if not files:
        raise malformed(str(path), f"camera files ({', '.join(_SUFFIXES)}) in the folder", "none", "give the file itself")
    parts = [_parse(decode(read_bytes(file), str(file)), str(file)) for file in files]
    units = {part.unit for part in parts}
    if len(units) > 1:
        raise malformed(str(path), "files in one unit of length", " and ".join(sorted(units)), "convert one of them")
    # the names are checked before the extrinsics are joined by name
    cameras = _unique((camera for part in parts for camera in part.cameras), str(path))
    return _Cameras(cameras, {name: pose for part in parts for name, pose in part.extrinsics.items()}, units.pop())


def _parse(text: str, source: str) -> _Cameras:
    for reader in _READERS:
        if reader.sniff(text):
            return reader.parse(text, source)
    found = f"text that begins with {text.strip()[:20]!r}" if text.strip() else "an empty file"
    raise malformed(source, f"one of: {', '.join(reader.name for reader in _READERS)}", found, "export one of these")


def _unique(cameras: Iterable[Camera], source: str) -> tuple[Camera, ...]:
    kept = tuple(cameras)
    names = [camera.name for camera in kept]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise malformed(source, "each camera name once", f"{', '.join(twice)} twice", "rename one of them")
    return kept


# --- anipose TOML


def _parse_toml(text: str, source: str) -> _Cameras:
    try:
        data = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        raise malformed(source, "TOML", f"an error ({error})", "mend that line") from None
    sections = dict(_sections(data))
    if not sections:
        raise malformed(source, "sections with a camera's size, matrix and distortions", one_field(data) or "nothing", "export anipose's calibration.toml")
    cameras, extrinsics = [], {}
    for section, fields in sections.items():
        name = str(fields.get("name", section))
        where = f"{source}: camera {name}"
        fisheye = fields.get("fisheye", False) is True
        cameras.append(make_camera(name, fields.get("size"), fields["matrix"], fields.get("distortions"), fisheye, where))
        # caliscope writes the text "null" where a camera was not placed
        if isinstance(fields.get("rotation"), list) and isinstance(fields.get("translation"), list):
            extrinsics[name] = make_extrinsics(fields["rotation"], fields["translation"], where)
    metadata = data.get("metadata")
    unit = metadata.get("unit", "arbitrary") if isinstance(metadata, dict) else "arbitrary"
    return _Cameras(_unique(cameras, source), extrinsics, str(unit))


def _sections(data: dict[str, Any]) -> Iterable[tuple[str, dict[str, Any]]]:
    """The tables with a matrix, at the top or one below ([cameras.0] of caliscope)."""
    for key, value in data.items():
        if isinstance(value, dict) and isinstance(value.get("matrix"), list):
            yield key, value
        elif isinstance(value, dict):
            yield from ((k, v) for k, v in value.items() if isinstance(v, dict) and isinstance(v.get("matrix"), list))


# --- YAML


class _Loader(yaml.SafeLoader):
    """YAML with OpenCV's matrices, as plain mappings of rows, cols and data."""


def _opencv_matrix(loader: yaml.SafeLoader, node: yaml.Node) -> Any:
    return loader.construct_yaml_map(node)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _opencv_matrix)


def _mapping(text: str, source: str) -> dict[str, Any]:
    # OpenCV 4 writes `%YAML:1.0`, which is not YAML
    text = re.sub(r"\A\s*%YAML.*\n", "", text)
    try:
        data = yaml.load(text, _Loader)  # a SafeLoader
    except (yaml.YAMLError, RecursionError, ValueError, TypeError, AttributeError, KeyError) as error:
        raise malformed(source, "YAML", f"an error ({error})", "mend the file") from None
    if not isinstance(data, dict):
        raise malformed(source, "a YAML mapping", type(data).__name__, "export the cameras again")
    return data


def _parse_opencv(text: str, source: str) -> _Cameras:
    data = _mapping(text, source)
    matrix = _first(data, _MATRIX)
    if matrix is None or "M2" in data:
        found = "a stereo pair (M1, M2)" if "M2" in data else ", ".join(map(str, list(data)[:8]))
        raise malformed(source, f"one camera with its matrix under {', '.join(_MATRIX)}", found, "give one file per camera")
    name = str(data.get("camera_name") or Path(source).stem)
    width, height = data.get("image_width"), data.get("image_height")
    size = None if width is None or height is None else [width, height]
    fisheye = str(data.get("distortion_model", data.get("model", ""))).lower() in ("equidistant", "fisheye") or data.get("fisheye") in (True, 1)
    camera = make_camera(name, size, matrix, _first(data, _DISTORTION), fisheye, source)
    rotation, translation = _first(data, _ROTATION), _first(data, _TRANSLATION)
    placed = rotation is not None and translation is not None
    return _Cameras((camera,), {name: make_extrinsics(rotation, translation, source)} if placed else {}, str(data.get("unit", "arbitrary")))


def _first(data: dict[str, Any], keys: Iterable[str]) -> Any:
    return next((data[key] for key in keys if key in data), None)


def _parse_own(text: str, source: str) -> _Cameras:
    data = _mapping(text, source)
    if data.get("version") != VERSION:
        raise malformed(source, f"version {VERSION} of our cameras", f"version {data.get('version')}", "use the program that wrote it")
    entries = data.get("cameras")
    if not isinstance(entries, list) or not entries:
        raise malformed(source, "a list of cameras", one_field(entries), "write the file again")
    cameras = _unique((camera_from_fields(fields, source) for fields in entries), source)
    placed = [(camera.name, fields) for camera, fields in zip(cameras, entries, strict=True) if {"R", "t"} <= fields.keys()]
    extrinsics = {name: make_extrinsics(fields["R"], fields["t"], f"{source}: camera {name}") for name, fields in placed}
    return _Cameras(cameras, extrinsics, str(data.get("unit", "arbitrary")))


_READERS = (
    _Reader("mocap-calib cameras.yaml", lambda text: re.search(r"^format: *[\"']?mocap-calib cameras", text, re.M) is not None, _parse_own),
    _Reader("OpenCV or ROS YAML", lambda text: re.search(r"\A\s*%YAML|!!opencv-matrix|^(camera_matrix|K|M1)\s*:", text, re.M) is not None, _parse_opencv),
    _Reader("anipose calibration.toml", lambda text: re.search(r"^\s*\[[\w .\"'-]+\]\s*(#.*)?$|^[\w\"' .-]+=", text, re.M) is not None, _parse_toml),
)
