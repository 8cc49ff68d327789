"""Weights as safetensors files that describe themselves."""

import hashlib
import json
from dataclasses import asdict
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from mocap_calib.errors import FormatError
from mocap_calib.io.atomic import write_bytes
from mocap_calib.recording.joints import SHIPPED, parse_skeleton
from mocap_calib.steerpose.model import Lifter, ModelConfig
from mocap_calib.steerpose.steer import Architecture, Model
from mocap_calib.steerpose.token import TokenConfig, TokenSteerer
from mocap_calib.types import Skeleton

_KEY = "mocap_calib"


def save_lifter(path: Path, lifter: Model, skeleton: Skeleton, card: dict[str, object]) -> None:
    """Writes weights, network size, vocabulary and model card into one file."""
    description = {
        "architecture": "factorised" if isinstance(lifter, Lifter) else "token",
        "model": asdict(lifter.config),
        "skeleton": {
            "name": skeleton.name,
            "keypoints": skeleton.keypoints,
            "edges": [[skeleton.keypoints[a], skeleton.keypoints[b]] for a, b in skeleton.edges],
            "aliases": skeleton.aliases,
            "layouts": {str(k): layout for k, layout in enumerate(skeleton.layouts)},
        },
        "card": card,
    }
    tensors = {
        name: value.detach().cpu().contiguous() for name, value in lifter.state_dict().items()
    }
    write_bytes(path, save(tensors, metadata={_KEY: json.dumps(description, sort_keys=True)}))


def load_lifter(name_or_path: str | Path = "people") -> tuple[Lifter, Skeleton]:
    """The factorised network and its vocabulary: shipped ones by name (`models`), or from a file. Raises FormatError."""
    model, skeleton = load_steerer(name_or_path)
    if not isinstance(model, Lifter):
        raise FormatError(
            f"{name_or_path}: expected weights of the factorised architecture, found those of the rotation token"
        )
    return model, skeleton


def load_steerer(
    name_or_path: str | Path = "people", *, architecture: Architecture = "factorised"
) -> tuple[Model, Skeleton]:
    """A network of either architecture: shipped ones by the name of their skeleton, or from a file. Raises FormatError."""
    if isinstance(name_or_path, str) and (name := name_or_path) in SHIPPED:
        with resources.as_file(
            _shipped(name if architecture == "factorised" else f"{name}_token")
        ) as path:
            return _read(path)
    return _read(Path(name_or_path))


def models() -> dict[str, dict[str, Any]]:
    """The model card of each shipped lifter, by the name of its skeleton."""
    cards = {}
    for name in SHIPPED:
        with resources.as_file(_shipped(name)) as path:
            if path.is_file():
                cards[name] = _description(path)["card"]
    return cards


def digest(name_or_path: str) -> str:
    """SHA-256 of the weights of a lifter: a shipped one, or one in a file."""
    return hashlib.sha256(
        (_shipped(name_or_path) if name_or_path in SHIPPED else Path(name_or_path)).read_bytes()
    ).hexdigest()


def _shipped(name: str) -> Traversable:
    return resources.files("mocap_calib") / "weights" / f"{name}.safetensors"


def _description(path: Path) -> dict[str, Any]:
    """What a weights file says of itself. Raises FormatError."""
    try:
        with safe_open(path, framework="pt") as file:
            return json.loads((file.metadata() or {})[_KEY])
    except FileNotFoundError:
        raise FormatError(
            f"{path}: expected a weights file, or a shipped model ({', '.join(SHIPPED)}), found neither"
        ) from None
    except (SafetensorError, KeyError, ValueError) as error:
        raise FormatError(
            f"{path}: not weights of mocap-calib: {str(error).splitlines()[0]}"
        ) from None


def _read(path: Path) -> tuple[Model, Skeleton]:
    description = _description(path)
    with safe_open(path, framework="pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  (not a dictionary)
    token = description.get("architecture") == "token"
    model: Model = (
        TokenSteerer(TokenConfig(**description["model"]))
        if token
        else Lifter(ModelConfig(**description["model"]))
    )
    model.load_state_dict(tensors)
    return model.eval(), parse_skeleton(description["skeleton"], str(path))


# --- by the name that a user gives

GEOMETRY_ALONE = "none"  # asks for no model: it knows no joint, and the geometry must do


def load_model(name: str = "people") -> Lifter:
    """Return the lifter of a shipped skeleton, or that in a weights file. Raises FormatError.

    For geometry alone any will do, as it is given no joint.
    """
    lifter, _ = load_lifter("people" if name == GEOMETRY_ALONE else name)
    return lifter


def load_vocabulary(name: str) -> Skeleton:
    """Return the joints that a model knows: none for geometry alone. Raises FormatError."""
    if name == GEOMETRY_ALONE:
        return Skeleton(GEOMETRY_ALONE, keypoints=(), edges=(), symmetries=(), aliases={})
    _, skeleton = load_lifter(name)
    return skeleton


def identify_model(name: str) -> str:
    """Return what tells a model from others: the SHA-256 of its weights, if it has any."""
    return GEOMETRY_ALONE if name == GEOMETRY_ALONE else digest(name)
