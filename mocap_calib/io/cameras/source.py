"""What is read and what is written: files in memory, and the cameras they hold.

A `Source` is one file, or the files of a folder. It knows the syntax of its text and parses it once.
"""

import json
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import PurePath
from typing import Any

import numpy as np
import yaml

from mocap_calib.errors import MismatchError
from mocap_calib.io.file import decode, malformed, repeated
from mocap_calib.types import Camera, CameraRig, Floats

# PyYAML reads a megabyte of text, or 20 000 values, in a second; a camera takes a kilobyte, and fifty values
_YAML_ROOM, _YAML_VALUES = 2_000_000, 50_000
_YAML_LEVELS = 50
_TOML = r"^[ \t]*\[\[?[\w .\"'-]+\]\]?\s*(#.*)?$|^[\w\"' .-]+="
_BINARY = (b"MATLAB", b"\x89HDF", b"\x00")


@dataclass(frozen=True)
class Source:
    """The files at `path` by their names (one file, unless it is a folder)."""

    path: str
    files: Mapping[str, bytes]
    folder: bool = False

    def of(self, name: str) -> "Source":
        """One file of the folder."""
        return Source(f"{self.path}/{name}", {name: self.files[name]})

    @property
    def content(self) -> bytes:
        """The one file's content."""
        return next(iter(self.files.values()))

    @property
    def stem(self) -> str:
        """The one file's name without its ending."""
        return PurePath(next(iter(self.files))).stem

    @cached_property
    def text(self) -> str:
        """The one file's text. Raises FormatError."""
        return decode(self.content, self.path)

    @cached_property
    def syntax(self) -> str:
        """`folder`, `binary`, `json`, `toml` or `yaml` (which is any other text)."""
        if self.folder or self.content.startswith(_BINARY) or b"\x00" in self.content[:512]:
            return "folder" if self.folder else "binary"
        if re.search(_TOML, self.text, re.M) and not re.match(r"\s*(\{|%YAML|---)", self.text):
            return "toml"
        return "json" if re.match(r"\s*[\[{]", self.text) else "yaml"

    @cached_property
    def tree(self) -> Any:
        """The parsed text. Raises FormatError, also where a key occurs twice."""
        if self.syntax in ("binary", "folder"):
            raise malformed(
                self.path,
                "text",
                f"a {self.syntax} file".replace("folder file", "folder"),
                "name another format",
            )
        return {"json": parse_json, "toml": parse_toml, "yaml": parse_yaml}[self.syntax](
            self.text, self.path
        )

    def mapping(self, *keys: str) -> dict[str, Any]:
        """The parsed text, which is a mapping with the keys. Raises FormatError."""
        if not isinstance(self.tree, dict):
            raise malformed(
                self.path,
                "a mapping of names to fields",
                type(self.tree).__name__,
                "export the cameras again",
            )
        need(self.tree, keys, self.path)
        return self.tree

    def has(self, syntax: str, *keys: str) -> bool:
        """Whether the file is a mapping of that syntax with all of the keys."""
        return (
            self.syntax == syntax and isinstance(self.tree, dict) and self.tree.keys() >= set(keys)
        )


@dataclass(frozen=True)
class CameraFile:
    """What a source says.

    extrinsics: `[3, 3]` rotation and `[3]` translation of cam_from_world by camera name, for the cameras that have
    them. unit: of the lengths, "" where the file does not say. notes: what a user should know of what was left out.
    """

    cameras: tuple[Camera, ...]
    extrinsics: Mapping[str, tuple[Floats, Floats]]
    unit: str = ""
    notes: tuple[str, ...] = ()


def parse_json(text: str, source: str) -> Any:
    """JSON, each key once. Raises FormatError."""
    try:
        return json.loads(text, object_pairs_hook=lambda pairs: _once(pairs, source))
    except (ValueError, RecursionError) as error:
        raise malformed(source, "JSON", f"an error ({error})", "write the file again") from None


def parse_toml(text: str, source: str) -> Any:
    """TOML. Raises FormatError."""
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        raise malformed(source, "TOML", f"an error ({error})", "mend that line") from None


class _Loader(yaml.SafeLoader):
    """YAML with OpenCV's matrices as plain mappings; each key once, no aliases, which could stand for a giant, no abyss, no crowd."""

    level = 0
    values = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("an alias (*name), which camera files do not need")
        if self.level > _YAML_LEVELS:  # PyYAML takes seconds for thousands
            raise yaml.YAMLError(f"more than {_YAML_LEVELS} levels of nesting")
        if self.values > _YAML_VALUES:
            raise yaml.YAMLError(f"more than {_YAML_VALUES} values; cameras have some fifty each")
        self.values += 1
        self.level += 1
        node = super().compose_node(parent, index)
        self.level -= 1
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        twice = repeated(key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode))
        if twice:
            raise yaml.YAMLError(f"the key {twice[0]} twice")
        return super().construct_mapping(node, deep)


def _opencv_matrix(loader: yaml.SafeLoader, node: yaml.Node) -> Any:
    return loader.construct_yaml_map(node)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _opencv_matrix)


def parse_yaml(text: str, source: str) -> Any:
    """YAML, also in OpenCV's dialects. Raises FormatError."""
    if len(text) > _YAML_ROOM:
        raise malformed(
            source,
            f"YAML of cameras, below {_YAML_ROOM // 1_000_000} MB",
            f"{len(text) // 1_000_000} MB",
            "give the cameras alone",
        )
    # OpenCV 4 writes `%YAML:1.0`, which is not YAML; `rostopic echo` ends with a line that begins another document
    text = re.sub(r"\n---\s*\Z", "\n", re.sub(r"\A\s*%YAML.*\n", "", text))
    try:
        return yaml.load(text, _Loader)  # a SafeLoader
    except (
        yaml.YAMLError,
        RecursionError,
        ValueError,
        TypeError,
        AttributeError,
        KeyError,
    ) as error:
        raise malformed(source, "YAML", f"an error ({error})", "mend the file") from None


def _once(pairs: list[tuple[str, Any]], source: str) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise malformed(
            source,
            "each key once",
            f"{repeated(name for name, _ in pairs)[0]} twice",
            "rename one of them",
        )
    return found


def unique(cameras: Iterable[Camera], source: str) -> tuple[Camera, ...]:
    """The cameras as they are. Raises FormatError where there is none, or one name is two cameras'."""
    kept = tuple(cameras)
    twice = repeated(camera.name for camera in kept)
    if twice:
        raise malformed(
            source, "each camera name once", f"{', '.join(twice)} twice", "rename one of them"
        )
    if not kept:
        raise malformed(source, "at least one camera", "none", "export the cameras again")
    return kept


def entries(value: Any, what: str, source: str) -> list[tuple[str, dict[str, Any]]]:
    """(name or number, fields) of a mapping or a list of mappings. Raises FormatError."""
    pairs = (
        list(value.items())
        if isinstance(value, dict)
        else list(enumerate(value))
        if isinstance(value, list)
        else []
    )
    if not pairs or not all(isinstance(fields, dict) for _, fields in pairs):
        raise malformed(
            source,
            what,
            f"{type(value).__name__} of something else" if pairs else "none",
            "export the cameras again",
        )
    return [(str(name), fields) for name, fields in pairs]


def need(fields: Mapping[str, Any], keys: Iterable[str], source: str) -> None:
    """Raises FormatError where a key is missing."""
    missing = [key for key in keys if key not in fields]
    if missing:
        raise malformed(
            source,
            f"the keys {', '.join(keys)}",
            f"none of {', '.join(missing)}",
            "export the cameras again",
        )


def whole(value: Any, expected: str, source: str) -> int:
    """A whole number. Raises FormatError."""
    try:
        number = float(value)
        if number == int(number):
            return int(number)
    except (TypeError, ValueError, OverflowError):
        pass
    raise malformed(source, expected, value, "mend it")


# --- for writers


def cannot(name: str, camera: str, expected: str, found: object, remedy: str) -> MismatchError:
    """The complaint of a format (`name`) that does not have what the camera has."""
    return MismatchError(
        f"{name}: camera {camera}: expected {expected}, which is all the format has, found {found}; {remedy}"
    )


def terms(camera: Camera, count: int, name: str, remedy: str = "write another format") -> Floats:
    """`[count]` k1 k2 p1 p2 (k3 (k4 k5 k6)), padded with zeros. Raises MismatchError where the camera has more or is a fisheye's."""
    if camera.fisheye:
        raise cannot(name, camera.name, "a pinhole camera", "a fisheye camera", remedy)
    padded: Floats = np.concatenate([camera.distortion, np.zeros(8)])[:8]
    if (padded[count:] != 0).any():
        raise cannot(
            name,
            camera.name,
            f"{count} distortion coefficients",
            f"more ({camera.distortion.tolist()})",
            remedy,
        )
    return padded[:count]


def need_names(cameras: Iterable[str], pattern: str, words: str, owner: str) -> None:
    """Raises MismatchError where a camera's name does not match the pattern, which `words` describe."""
    for camera in cameras:
        if not re.fullmatch(pattern, camera):
            raise MismatchError(
                f"{owner}: expected camera names of {words}, found {camera!r}; rename the camera"
            )


def need_sizes(rig: CameraRig, name: str) -> None:
    """Raises MismatchError where a camera's image size is not known."""
    for camera in rig.cameras:
        if 0 in camera.size:
            raise MismatchError(
                f"{name}: expected the image size of camera {camera.name}, found none; add it to the input"
            )


def without_sizes(rig: CameraRig) -> tuple[str, ...]:
    """What is lost by a format that has no image sizes."""
    return ("image sizes",) if any(0 not in camera.size for camera in rig.cameras) else ()


FILE_NAME = (
    r"(?!\.)[^\x00-\x1f\x7f-\x9f/\\\"\u2028\u2029\ud800-\udfff]{1,80}",
    "characters that a file name may have",
)


def to_json(value: Any) -> bytes:
    """Readable JSON; floats come back exactly."""
    return (json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def join_camera_files(found: CameraFile, more: CameraFile, source: str) -> CameraFile:
    """Two files' cameras together. Raises FormatError where they share a name or differ in their unit."""
    units = {found.unit, more.unit}
    if len(units) > 1:
        raise malformed(
            source,
            "files in one unit of length",
            " and ".join(sorted(unit or "none said" for unit in units)),
            "convert one of them",
        )
    cameras = unique(
        (*found.cameras, *more.cameras), source
    )  # before the extrinsics are joined by name
    return CameraFile(
        cameras, {**found.extrinsics, **more.extrinsics}, found.unit, (*found.notes, *more.notes)
    )
