"""Parse the JSON, TOML and YAML of camera files, of which each key occurs once."""

import json
import re
import tomllib
from typing import Any

import yaml

from mocap_calib.errors import FormatError
from mocap_calib.io.file import find_repeated

# PyYAML reads a megabyte of text, or 20 000 values, in a second; a camera takes a kilobyte of text
# and fifty values
_YAML_CHARACTERS = 2_000_000
_YAML_VALUES = 50_000
_YAML_LEVELS = 50
_TOML_LINE = r"^[ \t]*\[\[?[\w .\"'-]+\]\]?\s*(#.*)?$|^[\w\"' .-]+="
# a name in our own YAML may hold a line that looks like TOML
_OTHER_START = r"(\s*#[^\n]*\n)*\s*(\{|%YAML|---|format: mocap-calib)"


def is_toml(text: str) -> bool:
    """Return whether a line of the text is a section or an assignment of TOML."""
    return re.search(_TOML_LINE, text, re.M) is not None and not re.match(_OTHER_START, text)


def parse(text: str, syntax: str, source: str) -> Any:
    """Return parsed text. Raises FormatError, also where a key occurs twice.

    syntax: `json`, `toml` or `yaml`, that of OpenCV's dialects too.
    """
    try:
        if syntax == "json":
            return json.loads(text, object_pairs_hook=_object)
        return tomllib.loads(text) if syntax == "toml" else _parse_yaml(text)
    except (
        *(yaml.YAMLError, RecursionError, ValueError),
        *(TypeError, AttributeError, KeyError),  # of PyYAML
    ) as error:
        found = f"an error ({error})"
        raise FormatError(source, syntax.upper(), found, "correct the file") from None


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object of JSON. Raises ValueError."""
    for name in find_repeated(name for name, _ in pairs):
        raise ValueError(f"the key {name} twice")
    return dict(pairs)


def _parse_yaml(text: str) -> Any:
    """Return parsed YAML. Raises whatever PyYAML does."""
    if len(text) > _YAML_CHARACTERS:
        most, size = _YAML_CHARACTERS // 1_000_000, len(text) // 1_000_000
        raise ValueError(f"{size} MB; YAML of cameras is below {most} MB")
    # OpenCV 4 writes `%YAML:1.0`, which is not YAML; `rostopic echo` ends with a line that begins
    # another document
    text = re.sub(r"\A\s*%YAML.*\n", "", text)
    return yaml.load(re.sub(r"\n---\s*\Z", "\n", text), _Loader)  # a SafeLoader


class _Loader(yaml.SafeLoader):
    """YAML with OpenCV's matrices as plain mappings.

    Each key occurs once. There are no aliases, which could stand for a giant, not too many levels,
    for which PyYAML takes seconds, and not too many values.
    """

    level = 0
    values = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("an alias (*name), which camera files do not need")
        if self.level > _YAML_LEVELS:
            raise yaml.YAMLError(f"more than {_YAML_LEVELS} levels of nesting")
        if self.values > _YAML_VALUES:
            raise yaml.YAMLError(f"more than {_YAML_VALUES} values; cameras have some fifty each")
        self.values += 1
        self.level += 1
        node = super().compose_node(parent, index)
        self.level -= 1
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        twice = find_repeated(
            key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)
        )
        if twice:
            raise yaml.YAMLError(f"the key {twice[0]} twice")
        return super().construct_mapping(node, deep)


def _opencv_matrix(loader: yaml.SafeLoader, node: yaml.Node) -> Any:
    return loader.construct_yaml_map(node)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _opencv_matrix)
