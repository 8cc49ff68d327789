"""Skeletons from the fields of their YAML files."""

from collections.abc import Mapping
from typing import Any

from mocap_calib.errors import FormatError
from mocap_calib.types import Skeleton
from mocap_calib.wording import one_line


def parse_skeleton(fields: Any, source: str) -> Skeleton:
    """Return a skeleton from the fields of its YAML file. Raises FormatError."""
    if not isinstance(fields, dict) or not isinstance(fields.get("keypoints"), list):
        raise FormatError(
            f"skeleton {source}: expected a mapping with a list `keypoints`; see docs/skeletons.md"
        )
    try:
        return _parse_skeleton(fields, source)
    except (ValueError, TypeError, AttributeError, LookupError) as error:
        raise FormatError(
            f"skeleton {source}: expected edges, aliases and layouts as docs/skeletons.md has "
            f"them, found an error ({one_line(error)}); mend that place"
        ) from None


def _parse_skeleton(fields: Mapping[str, Any], source: str) -> Skeleton:
    """Return the skeleton. Raises FormatError, and what Python raises of other types."""
    keypoints = tuple(str(name) for name in fields["keypoints"])
    aliases = strings(fields.get("aliases") or {})
    layouts = tuple(strings(layout) for layout in (fields.get("layouts") or {}).values())
    edges = [tuple(map(str, edge)) for edge in fields.get("edges") or []]

    named = {name for edge in edges for name in edge}
    named |= {joint for renaming in (aliases, *layouts) for joint in renaming.values()}
    strangers = sorted(named - set(keypoints))
    if strangers:
        found = one_line(", ".join(strangers), width=200)
        raise FormatError(
            f"skeleton {source}: edges, aliases or layouts name {found}, "
            "expected only its own keypoints"
        )
    index = {name: k for k, name in enumerate(keypoints)}
    return Skeleton(
        name=str(fields.get("name", source)),
        keypoints=keypoints,
        edges=tuple((index[parent], index[child]) for parent, child in edges),
        symmetries=_symmetries(keypoints),
        aliases=aliases,
        layouts=layouts,
    )


def strings(mapping: Mapping[Any, Any]) -> dict[str, str]:
    """Return a mapping of a YAML file, whose names may read as numbers, as strings."""
    return {str(name): str(joint) for name, joint in mapping.items()}


def _symmetries(keypoints: tuple[str, ...]) -> tuple[tuple[int, int], ...]:
    """Return the index pairs (left, right) of keypoints `left...` and `right...`."""
    index = {name: k for k, name in enumerate(keypoints)}
    left_names = [name for name in keypoints if name.startswith("left")]
    mirrored = [(name, "right" + name.removeprefix("left")) for name in left_names]
    return tuple((index[left], index[right]) for left, right in mirrored if right in index)
