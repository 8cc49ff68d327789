"""What weights say of themselves and of their joints: without torch, which takes a second."""

import hashlib
import json
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open

from mocap_calib.errors import FormatError, suggest
from mocap_calib.recording.joints import SHIPPED, load_skeleton
from mocap_calib.recording.skeleton_fields import parse_skeleton
from mocap_calib.types import Skeleton

DESCRIPTION = "mocap_calib"  # key of the description in the metadata of a file of weights
GEOMETRY_ALONE = "none"  # asks for no model: it knows no joint, and the geometry must do
_TOKEN = "_token"  # ends the names of shipped weights of the paper's architecture


def models() -> dict[str, dict[str, Any]]:
    """Return the model card of each shipped lifter, by the name of its skeleton."""
    cards = {}
    for name in SHIPPED:
        with resources.as_file(shipped_weights(name)) as path:
            if path.is_file():
                cards[name] = read_description(path)["card"]
    return cards


def load_vocabulary(name: str) -> Skeleton:
    """Return the joints that a model knows: none for geometry alone. Raises FormatError."""
    if name == GEOMETRY_ALONE:
        return Skeleton(GEOMETRY_ALONE, keypoints=(), edges=(), symmetries=(), aliases={})
    with resources.as_file(weights_of(name)) as path:
        return parse_skeleton(read_description(path)["skeleton"], str(path))


def identify_model(name: str) -> str:
    """Return what tells a model from others: the SHA-256 of its weights, if it has any.

    Of a rotation token also that of the weights that lift for it.
    """
    if name == GEOMETRY_ALONE:
        return GEOMETRY_ALONE
    return digest(name) + (digest(lifter_beside(name)) if is_token(name) else "")


def digest(name_or_path: str) -> str:
    """Return the SHA-256 of the weights of a model: a shipped one, or one in a file."""
    return hashlib.sha256(weights_of(name_or_path).read_bytes()).hexdigest()


def weights_of(name_or_path: str) -> Traversable:
    """Return the place of the weights of a shipped model, or the file of that name."""
    shipped = name_or_path in (*SHIPPED, *shipped_tokens())
    return shipped_weights(name_or_path) if shipped else Path(name_or_path)


def shipped_tokens() -> tuple[str, ...]:
    """Return the names of the shipped weights of the paper's architecture."""
    names = (f"{name}{_TOKEN}" for name in SHIPPED)
    return tuple(name for name in names if shipped_weights(name).is_file())


def is_token(name_or_path: str) -> bool:
    """Return whether weights are of the paper's architecture. Raises FormatError."""
    with resources.as_file(weights_of(name_or_path)) as path:
        return read_description(path).get("architecture") == "token"


def lifter_beside(token: str) -> str:
    """Return the shipped model that lifts where a rotation token steers: of the same joints.

    token: a shipped one, or one in a file. Raises FormatError where none has the same joints.
    """
    joints = load_vocabulary(token)
    if joints.name in SHIPPED and load_skeleton(joints.name).keypoints == joints.keypoints:
        return joints.name
    raise FormatError(
        f"{token}: expected a rotation token with the joints of a shipped model "
        f"({', '.join(SHIPPED)}), which lifts where it steers, found others ({joints.name}); "
        "train it with --skeleton and a name of these"
    )


def shipped_weights(name: str) -> Traversable:
    """Return the place of weights in the package, which may not be there."""
    return resources.files("mocap_calib") / "weights" / f"{name}.safetensors"


def read_description(path: Path) -> dict[str, Any]:
    """Return what a weights file says of itself. Raises FormatError."""
    try:
        with safe_open(path, framework="np") as file:
            return json.loads((file.metadata() or {})[DESCRIPTION])
    except FileNotFoundError:
        shipped = ", ".join(SHIPPED)
        raise FormatError(
            f"{path}: expected a shipped model ({shipped}), a file of weights, or none, "
            f"found neither; {suggest(str(path), SHIPPED)}"
        ) from None
    except (SafetensorError, KeyError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise FormatError(
            f"{path}: expected weights that `train` wrote, found another file ({reason}); "
            "check the path"
        ) from None
