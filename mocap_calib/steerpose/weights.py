"""What weights say of themselves and of their joints: without torch, which takes a second."""

import hashlib
import json
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open

from mocap_calib.errors import FormatError, suggest
from mocap_calib.recording.joints import SHIPPED
from mocap_calib.recording.skeleton_fields import parse_skeleton
from mocap_calib.types import Skeleton

DESCRIPTION = "mocap_calib"  # key of the description in the metadata of a file of weights
GEOMETRY_ALONE = "none"  # asks for no model: it knows no joint, and the geometry must do


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
    with resources.as_file(_weights_of(name)) as path:
        return parse_skeleton(read_description(path)["skeleton"], str(path))


def identify_model(name: str) -> str:
    """Return what tells a model from others: the SHA-256 of its weights, if it has any."""
    return GEOMETRY_ALONE if name == GEOMETRY_ALONE else digest(name)


def digest(name_or_path: str) -> str:
    """Return the SHA-256 of the weights of a lifter: a shipped one, or one in a file."""
    return hashlib.sha256(_weights_of(name_or_path).read_bytes()).hexdigest()


def _weights_of(name_or_path: str) -> Traversable:
    """Return the place of the weights of a shipped model, or the file of that name."""
    shipped = name_or_path in SHIPPED
    return shipped_weights(name_or_path) if shipped else Path(name_or_path)


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
