"""Skeletons: read their files, and match the keypoint names of data sets to their joints."""

import re
from collections.abc import Container, Iterable, Mapping, Set
from functools import cache
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mocap_calib.errors import FormatError, one_line
from mocap_calib.types import Ints, Skeleton

# the first of those that know a recording equally well is chosen
SHIPPED = ("people", "quadruped", "rodent", "bird")
_SIDES = {"l": "left", "left": "left", "r": "right", "right": "right"}
# between `aB`, between `L` and `Ab`, and at spaces and marks
_WORD_BREAK = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[LR])(?=[A-Z][a-z])|[\s\-.()]+")


# --- names of joints


def normalise_name(name: str) -> str:
    """Return a name in lower case, words joined by `_`, the side first.

    `LShoulder`, `shoulder_l`, `Left Shoulder`, `leftShoulder` -> `left_shoulder`.
    """
    spaced = _WORD_BREAK.sub("_", name.strip())
    words = [word for word in spaced.lower().split("_") if word]
    sides = [_SIDES[word] for word in words if word in _SIDES]
    others = [word for word in words if word not in _SIDES]
    return "_".join(sides[:1] + others)


def side_pairs(keypoints: tuple[str, ...]) -> tuple[tuple[int, int], ...]:
    """Return the index pairs (left, right) of keypoints whose normalised names differ by side."""
    index = {normalise_name(name): k for k, name in enumerate(keypoints)}
    lefts = [name for name in index if name.startswith("left")]
    pairs = [(name, "right" + name.removeprefix("left")) for name in lefts]
    return tuple((index[left], index[right]) for left, right in pairs if right in index)


def match_names(names: tuple[str, ...], skeleton: Skeleton) -> Ints:
    """Return the index `[keypoint]` of each name's joint in the skeleton, -1 = no such joint.

    Names are looked up in the layouts whose names all occur, then among the skeleton's own joints,
    then among its aliases. Of several aliases of one joint, the first is used.
    """
    own_names = {normalise_name(joint): k for k, joint in enumerate(skeleton.keypoints)}
    aliases = _index_joints(skeleton.aliases, own_names)
    layouts = [_index_joints(layout, own_names) for layout in skeleton.layouts]
    known = {*own_names, *aliases, *(name for layout in layouts for name in layout)}
    spelled = [_spell_as_known(name, known) for name in names]

    by_layout: dict[str, int] = {}
    for layout in layouts:
        if layout.keys() <= set(spelled):
            by_layout |= layout
    elsewhere = set(by_layout.values())
    exact = {name: k for name, k in own_names.items() if k not in elsewhere} | by_layout
    return _match_each_once(spelled, exact, aliases)


def _index_joints(joints: Mapping[str, str], index: Mapping[str, int]) -> dict[str, int]:
    """Return the index of the joint that each name means, by the normalised name."""
    return {normalise_name(name): index[normalise_name(joint)] for name, joint in joints.items()}


def _spell_as_known(name: str, known: Set[str]) -> str:
    """Return the normalised name, its side split off if only that spelling is known.

    `leye` and `leftshoulder` can be split only with a list of joints.
    """
    normalised = normalise_name(name)
    sided = [
        f"{_SIDES[side]}_{normalised.removeprefix(side)}"
        for side in ("left", "right", "l", "r")
        if normalised.startswith(side)
    ]
    return next((spelling for spelling in (normalised, *sided) if spelling in known), normalised)


def _match_each_once(
    names: list[str], exact: Mapping[str, int], aliases: Mapping[str, int]
) -> Ints:
    """Return the joint `[keypoint]` of each name: the exact one, else a free one by alias."""
    matched = np.full(len(names), -1, dtype=np.int64)
    taken = {exact[name] for name in names if name in exact}
    for k, name in enumerate(names):
        if name in exact:
            matched[k] = exact[name]
        elif name in aliases and aliases[name] not in taken:
            matched[k] = aliases[name]
            taken.add(aliases[name])
    return matched


# --- skeletons and their files


def load_skeleton(name_or_path: str | Path) -> Skeleton:
    """Return a skeleton by its name (one that is shipped) or from a YAML file.

    The file has `name`, `keypoints`, and optionally `edges` (pairs of names, parent first),
    `aliases` (other name: keypoint), and `layouts` (name: aliases that hold where all of them
    occur).

    Raises FormatError.
    """
    return parse_skeleton(_read_fields(name_or_path), str(name_or_path))


def load_section(name_or_path: str | Path, section: str) -> dict[str, Any]:
    """Return a section of a skeleton's file, empty where it has none.

    Sections are `body` (bones and postures) and `training` (settings of TrainConfig).

    Raises FormatError.
    """
    fields = _read_fields(name_or_path) or {}
    found = fields.get(section) or {}
    if not isinstance(found, dict):
        raise FormatError(
            f"skeleton {name_or_path}",
            f"a mapping `{section}`",
            type(found).__name__,
            "see docs/skeletons.md",
        )
    return found


def choose_skeleton(names: Iterable[str]) -> Skeleton:
    """Return the shipped skeleton with most of the names; `people` if none has more."""
    return fit_vocabulary(names, aliases_file=None)[0]


def edges_of_keypoints(skeleton: Skeleton, vocabulary: Ints) -> tuple[tuple[int, int], ...]:
    """Return the edges of a skeleton between the keypoints of a recording, as pairs of indices.

    vocabulary: `[keypoint]` index of each keypoint in the skeleton, -1 = none.

    A joint that the recording lacks is skipped: its children are joined to its nearest ancestor in
    the recording. Where there is none, left and right are joined, and each side to the next pair of
    the same side (the shoulders and hips of a recording without neck and pelvis).
    """
    keypoints = {int(joint): k for k, joint in enumerate(vocabulary) if joint >= 0}
    parents = {child: parent for parent, child in skeleton.edges}
    edges: list[tuple[int, int]] = []
    topmost: list[int] = []
    for joint in sorted(keypoints):
        above = _nearest_above(joint, parents, keypoints)
        if above < 0:
            topmost.append(joint)
        else:
            edges.append((above, joint))
    pairs = [pair for pair in skeleton.symmetries if set(pair) <= set(topmost)]
    sides = [side for pair, below in pairwise(pairs) for side in zip(pair, below, strict=True)]
    return tuple((keypoints[a], keypoints[b]) for a, b in (*edges, *pairs, *sides))


def _nearest_above(joint: int, parents: Mapping[int, int], known: Container[int]) -> int:
    """Return the nearest ancestor of a joint that is known, -1 = none.

    parents: of each joint that has one. The edges of a user's skeleton may form a cycle.
    """
    above = joint
    for _ in parents:
        above = parents.get(above, -1)
        if above < 0 or above in known:
            return above
    return -1


def _read_fields(name_or_path: str | Path) -> Any:
    """Return what a skeleton's file holds. Raises FormatError."""
    name = str(name_or_path)
    if name in SHIPPED:
        return _read_shipped(name)
    source = f"skeleton {name}"
    if not Path(name).is_file():
        raise FormatError(
            source, "the name of a shipped one or a YAML file", "neither", "check the path"
        )
    return _read_yaml(Path(name).read_bytes(), source)


@cache
def _read_shipped(name: str) -> Any:
    """Return what the file of a shipped skeleton holds; it is read once."""
    text = (resources.files("mocap_calib") / "skeletons" / f"{name}.yaml").read_text("utf-8")
    # in C, where PyYAML has it; for our own files alone, as it may crash on deep nesting
    return yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))


def _read_yaml(text: str | bytes, source: str) -> Any:
    """Return what a YAML text holds. Raises FormatError."""
    try:
        return yaml.safe_load(text)
    # dates and numbers that are none are ValueErrors, keys that are lists TypeErrors
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        reason = str(error).splitlines()[0]
        raise FormatError(
            source, "a YAML file", f"an error ({reason})", "correct that place"
        ) from None


def parse_skeleton(fields: Any, source: str) -> Skeleton:
    """Return a skeleton from the fields of its YAML file. Raises FormatError."""
    if not isinstance(fields, dict) or not isinstance(fields.get("keypoints"), list):
        raise FormatError(
            f"skeleton {source}",
            "a mapping with a list `keypoints`",
            "none",
            "see docs/skeletons.md",
        )
    try:
        return _parse_skeleton(fields, source)
    except (ValueError, TypeError, AttributeError, LookupError) as error:
        raise FormatError(
            f"skeleton {source}",
            "edges, aliases and layouts as docs/skeletons.md has them",
            f"an error ({one_line(error)})",
            "correct that place",
        ) from None


def _parse_skeleton(fields: Mapping[str, Any], source: str) -> Skeleton:
    """Return the skeleton. Raises FormatError, and what Python raises of other types."""
    keypoints = tuple(str(name) for name in fields["keypoints"])
    aliases = _strings(fields.get("aliases") or {})
    layouts = tuple(_strings(layout) for layout in (fields.get("layouts") or {}).values())
    edges = [tuple(map(str, edge)) for edge in fields.get("edges") or []]

    named = {name for edge in edges for name in edge}
    named |= {joint for renaming in (aliases, *layouts) for joint in renaming.values()}
    strangers = sorted(named - set(keypoints))
    if strangers:
        found = ", ".join(strangers)
        raise FormatError(
            f"skeleton {source}: edges, aliases and layouts",
            "names of its own keypoints",
            found,
            "rename them, or add these keypoints",
        )
    index = {name: k for k, name in enumerate(keypoints)}
    return Skeleton(
        name=str(fields.get("name", source)),
        keypoints=keypoints,
        edges=tuple((index[parent], index[child]) for parent, child in edges),
        symmetries=side_pairs(keypoints),
        aliases=aliases,
        layouts=layouts,
    )


def _strings(mapping: Mapping[Any, Any]) -> dict[str, str]:
    """Return a mapping of a YAML file as strings; YAML may read names as numbers."""
    return {str(name): str(joint) for name, joint in mapping.items()}


# --- a user's own names


def load_aliases(path: Path, skeleton: Skeleton) -> dict[str, str]:
    """Return a user's names of joints, from `aliases: {own name: joint}` in a YAML file.

    A joint may be given by any name that the skeleton knows.

    Raises FormatError, also for a joint that the skeleton does not have.
    """
    aliases = _read_aliases(path)
    strangers = [joint for joint in aliases.values() if match_names((joint,), skeleton)[0] < 0]
    if strangers:
        known = ", ".join(skeleton.keypoints)
        raise FormatError(
            path,
            f"aliases of joints that the model {skeleton.name} has ({known})",
            one_line(", ".join(strangers), width=200),
            "choose among those",
        )
    return aliases


def fit_vocabulary(
    names: Iterable[str], aliases_file: Path | None
) -> tuple[Skeleton, dict[str, str]]:
    """Return the shipped skeleton with most of the joints, and the aliases of a file.

    names: of the joints; repeated ones count once. aliases_file: other names of joints, as
    `load_aliases` reads them; a skeleton that lacks one of these joints is not considered.

    Raises FormatError where no skeleton has the joints of the file.
    """
    unique = tuple(dict.fromkeys(names))
    candidates: list[tuple[Skeleton, dict[str, str]]] = []
    refusals: list[FormatError] = []
    for skeleton in map(load_skeleton, SHIPPED):
        try:
            aliases = {} if aliases_file is None else load_aliases(aliases_file, skeleton)
        except FormatError as error:
            refusals.append(error)
        else:
            candidates.append((skeleton, aliases))
    if not candidates:
        raise refusals[0]

    def known(candidate: tuple[Skeleton, dict[str, str]]) -> int:
        """Return how many names are joints of a skeleton, after the aliases were applied."""
        skeleton, aliases = candidate
        joints = tuple(aliases.get(name, name) for name in unique)
        return int((match_names(joints, skeleton) >= 0).sum())

    return max(candidates, key=known)


def _read_aliases(path: Path) -> dict[str, str]:
    """Return the section `aliases` of a YAML file. Raises FormatError."""
    try:
        text = path.read_text("utf-8")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        came = "none" if isinstance(error, FileNotFoundError) else f"an error ({reason})"
        raise FormatError(path, "a YAML file with `aliases`", came, "check the path") from None
    fields = _read_yaml(text, str(path))
    found = fields.get("aliases") if isinstance(fields, dict) else None
    if not isinstance(found, dict) or not found:
        raise FormatError(
            path,
            "a mapping `aliases` of own names to joints",
            "none",
            "write for instance `aliases: {beak: nose}`",
        )
    return _strings(found)
