"""Vocabularies of joints: reading them, and matching other names to them.

Lives below `io` because the readers and the model both need it.
"""

import re
from collections.abc import Iterable, Set
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mocap_calib.errors import FormatError
from mocap_calib.types import Ints, Skeleton

SHIPPED = (
    "people",
    "quadruped",
    "rodent",
    "bird",
)  # the first of those that know a recording equally well is chosen
_SIDES = {"l": "left", "left": "left", "r": "right", "right": "right"}


def normalise_name(name: str) -> str:
    """`LShoulder`, `shoulder_l`, `Left Shoulder`, `leftShoulder` -> `left_shoulder`."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[LR])(?=[A-Z][a-z])|[\s\-.()]+", "_", name.strip())
    words = [word for word in spaced.lower().split("_") if word]
    sides = [_SIDES[word] for word in words if word in _SIDES]
    rest = [word for word in words if word not in _SIDES]
    return "_".join(sides[:1] + rest)


def _spelled(name: str, known: Set[str]) -> str:
    """The normalised name; `leye` and `leftshoulder`, which only a list of joints can take apart, as far as it is known."""
    whole = normalise_name(name)
    sides = [
        f"{_SIDES[side]}_{whole.removeprefix(side)}"
        for side in ("left", "right", "l", "r")
        if whole.startswith(side)
    ]
    return next((each for each in (whole, *sides) if each in known), whole)


def match_names(names: tuple[str, ...], skeleton: Skeleton) -> Ints:
    """`[keypoint]` index in the skeleton of each name, -1 where it has no such joint; the first of twins wins.

    The layouts whose names all occur say what theirs mean, then the skeleton's own names count, then aliases.
    """
    index = {normalise_name(joint): k for k, joint in enumerate(skeleton.keypoints)}
    aliases = {
        normalise_name(a): index[normalise_name(joint)] for a, joint in skeleton.aliases.items()
    }
    layouts = [
        {normalise_name(name): index[normalise_name(joint)] for name, joint in layout.items()}
        for layout in skeleton.layouts
    ]
    spelled = [
        _spelled(name, {*index, *aliases, *(name for layout in layouts for name in layout)})
        for name in names
    ]
    meant = {
        name: joint
        for layout in layouts
        if set(spelled) >= layout.keys()
        for name, joint in layout.items()
    }
    own = {name: k for name, k in index.items() if k not in meant.values()} | meant
    exact = [own.get(name, -1) for name in spelled]
    taken = set(exact)
    found = np.full(len(names), -1, dtype=np.int64)
    for k, name in enumerate(spelled):
        joint = exact[k] if exact[k] >= 0 else aliases.get(name, -1)
        if exact[k] >= 0 or joint not in taken:
            found[k] = joint
            taken.add(joint)
    return found


def load_skeleton(name_or_path: str | Path) -> Skeleton:
    """A skeleton by name (one that is shipped) or from a YAML file of one's own.

    The file has `name`, `keypoints`, and optionally `edges` (pairs of names, parent first), `aliases` (other name:
    keypoint), and `layouts` (name: aliases that hold where all of them occur). Raises FormatError.
    """
    return parse_skeleton(
        _mapping(_text(name_or_path), f"skeleton {name_or_path}"), str(name_or_path)
    )


def _text(name_or_path: str | Path) -> str:
    """What a skeleton's file says. Raises FormatError."""
    shipped = resources.files("mocap_calib") / "skeletons" / f"{name_or_path}.yaml"
    path = Path(name_or_path)
    if shipped.is_file():
        return shipped.read_text("utf-8")
    if path.is_file():
        return path.read_text("utf-8")
    raise FormatError(
        f"skeleton {name_or_path}: expected the name of a shipped skeleton or a YAML file, found neither"
    )


def load_section(name_or_path: str | Path, section: str) -> dict[str, Any]:
    """A section of a skeleton's file: `body` (bones and postures), `training` (settings of TrainConfig); empty where it has none.

    Raises FormatError.
    """
    found = (_mapping(_text(name_or_path), f"skeleton {name_or_path}") or {}).get(section) or {}
    if not isinstance(found, dict):
        raise FormatError(
            f"skeleton {name_or_path}: expected a mapping `{section}`, found {type(found).__name__}; see docs/skeletons.md"
        )
    return found


def choose_skeleton(names: Iterable[str]) -> Skeleton:
    """The shipped skeleton that knows most of the names of joints; people where others know no more."""
    unique = tuple(dict.fromkeys(names))
    skeletons = [load_skeleton(name) for name in SHIPPED]
    return max(skeletons, key=lambda skeleton: int((match_names(unique, skeleton) >= 0).sum()))


def load_aliases(path: Path, skeleton: Skeleton) -> dict[str, str]:
    """Own names of joints, `aliases: {own name: joint}` in a YAML file; a joint may be said by any name the skeleton knows.

    Raises FormatError, also for a joint that the skeleton does not have.
    """
    try:
        text = path.read_text("utf-8")
    except (OSError, ValueError) as error:
        raise FormatError(
            f"{path}: expected a YAML file with `aliases`, found: {getattr(error, 'strerror', None) or error}; check the path"
        ) from None
    fields = _mapping(text, str(path))
    found = fields.get("aliases") if isinstance(fields, dict) else None
    if not isinstance(found, dict) or not found:
        raise FormatError(
            f"{path}: expected a mapping `aliases` of own names to joints, found none; write for instance `aliases: {{beak: nose}}`"
        )
    aliases = {str(name): str(joint) for name, joint in found.items()}
    strangers = [joint for joint in aliases.values() if match_names((joint,), skeleton)[0] < 0]
    if strangers:
        known = ", ".join(skeleton.keypoints)
        raise FormatError(
            f"{path}: expected aliases of joints that the model {skeleton.name} has ({known}), found {', '.join(strangers)}; choose among those"
        )
    return aliases


def _mapping(text: str, source: str) -> Any:
    """What a YAML text holds. Raises FormatError."""
    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise FormatError(f"{source}: not a YAML file: {str(error).splitlines()[0]}") from None


def parse_skeleton(fields: Any, source: str) -> Skeleton:
    """A skeleton from the fields of its YAML file. Raises FormatError."""
    if not isinstance(fields, dict) or not isinstance(fields.get("keypoints"), list):
        raise FormatError(
            f"skeleton {source}: expected a mapping with a list `keypoints`; see docs/skeletons.md"
        )
    keypoints = tuple(str(name) for name in fields["keypoints"])
    index = {name: k for k, name in enumerate(keypoints)}
    aliases = {str(a): str(joint) for a, joint in (fields.get("aliases") or {}).items()}
    edges = [tuple(map(str, edge)) for edge in fields.get("edges") or []]
    layouts = tuple(
        {str(a): str(joint) for a, joint in layout.items()}
        for layout in (fields.get("layouts") or {}).values()
    )
    strangers = sorted(
        (
            {n for edge in edges for n in edge}
            | set(aliases.values())
            | {n for layout in layouts for n in layout.values()}
        )
        - set(index)
    )
    if strangers:
        raise FormatError(
            f"skeleton {source}: edges, aliases or layouts name {', '.join(strangers)}, expected only its own keypoints"
        )
    symmetries = tuple(
        (index[n], index["right" + n[4:]])
        for n in keypoints
        if n.startswith("left") and "right" + n[4:] in index
    )
    return Skeleton(
        str(fields.get("name", source)),
        keypoints,
        tuple((index[a], index[b]) for a, b in edges),
        symmetries,
        aliases,
        layouts,
    )


def fit_vocabulary(
    names: Iterable[str], aliases_file: Path | None
) -> tuple[Skeleton, dict[str, str]]:
    """Return the shipped skeleton that knows most of the joints, and the aliases of a file.

    names: of the joints; repeated ones count once. aliases_file: other names of joints, as
    `load_aliases` reads them; a skeleton that lacks one of these joints is not considered.

    Raises FormatError where no skeleton has the joints of the file.
    """
    unique = tuple(dict.fromkeys(names))
    if aliases_file is None:
        return choose_skeleton(unique), {}
    candidates: list[tuple[Skeleton, dict[str, str]]] = []
    refusals: list[FormatError] = []
    for skeleton in map(load_skeleton, SHIPPED):
        try:
            candidates.append((skeleton, load_aliases(aliases_file, skeleton)))
        except FormatError as error:
            refusals.append(error)
    if not candidates:
        raise refusals[0]
    known = [_count_known(unique, skeleton, aliases) for skeleton, aliases in candidates]
    return candidates[known.index(max(known))]


def _count_known(names: tuple[str, ...], skeleton: Skeleton, aliases: dict[str, str]) -> int:
    """Return how many names the skeleton knows, after the aliases were applied."""
    joints = tuple(aliases.get(name, name) for name in names)
    return int((match_names(joints, skeleton) >= 0).sum())
