"""Read and write the weights of networks: safetensors files that describe themselves."""

import json
from dataclasses import asdict, replace
from importlib import resources
from pathlib import Path
from typing import Any

from safetensors import safe_open
from safetensors.torch import save
from torch import Tensor

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.io.atomic import write_bytes
from mocap_calib.recording.joints import SHIPPED, match_names, parse_skeleton
from mocap_calib.steerpose.model import Lifter, ModelConfig
from mocap_calib.steerpose.steer import Architecture, Model
from mocap_calib.steerpose.token import TokenConfig, TokenSteerer
from mocap_calib.steerpose.weights import (
    DESCRIPTION,
    GEOMETRY_ALONE,
    load_vocabulary,
    read_description,
    shipped_weights,
)
from mocap_calib.types import Recording, Skeleton


def save_lifter(path: Path, lifter: Model, skeleton: Skeleton, card: dict[str, object]) -> None:
    """Write weights, size of the network, vocabulary and model card into one file."""
    description = {
        "architecture": "factorised" if isinstance(lifter, Lifter) else "token",
        "model": asdict(lifter.config),
        "skeleton": _describe_skeleton(skeleton),
        "card": card,
    }
    tensors = {
        name: value.detach().cpu().contiguous() for name, value in lifter.state_dict().items()
    }
    metadata = {DESCRIPTION: json.dumps(description, sort_keys=True)}
    write_bytes(path, save(tensors, metadata=metadata))


def load_lifter(name_or_path: str | Path = "people") -> tuple[Lifter, Skeleton]:
    """Return a factorised network and its vocabulary: a shipped one by name, or from a file.

    Raises FormatError.
    """
    model, skeleton = load_steerer(name_or_path)
    if not isinstance(model, Lifter):
        raise FormatError(
            f"{name_or_path}: expected weights of the factorised architecture, "
            "found those of the rotation token"
        )
    return model, skeleton


def load_steerer(
    name_or_path: str | Path = "people", *, architecture: Architecture = "factorised"
) -> tuple[Model, Skeleton]:
    """Return a network and its vocabulary: a shipped one by its skeleton's name, or from a file.

    architecture: of a shipped one; a file says its own. Raises FormatError.
    """
    if isinstance(name_or_path, str) and name_or_path in SHIPPED:
        token = architecture == "token"
        shipped = shipped_weights(f"{name_or_path}_token" if token else name_or_path)
        with resources.as_file(shipped) as path:
            return _read(path)
    return _read(Path(name_or_path))


def _describe_skeleton(skeleton: Skeleton) -> dict[str, Any]:
    """Return the fields of a skeleton's file, as `parse_skeleton` reads them."""
    names = skeleton.keypoints
    return {
        "name": skeleton.name,
        "keypoints": names,
        "edges": [[names[parent], names[child]] for parent, child in skeleton.edges],
        "aliases": skeleton.aliases,
        "layouts": {str(k): layout for k, layout in enumerate(skeleton.layouts)},
    }


def _read_tensors(path: Path) -> dict[str, Tensor]:
    """Return the weights of a file by name."""
    with safe_open(path, framework="pt") as file:
        names = file.keys()
        return {name: file.get_tensor(name) for name in names}


def _read(path: Path) -> tuple[Model, Skeleton]:
    """Read a network and its vocabulary. Raises FormatError."""
    description = read_description(path)
    size = description["model"]
    model: Model
    if description.get("architecture") == "token":
        model = TokenSteerer(TokenConfig(**size))
    else:
        model = Lifter(ModelConfig(**size))
    model.load_state_dict(_read_tensors(path))
    return model.eval(), parse_skeleton(description["skeleton"], str(path))


# --- by the name that a user gives

AUTO = "auto"  # asks for the model that the recording was made for


def choose_model(recording: Recording, model: str | Path | Lifter) -> tuple[Recording, Lifter]:
    """Return the lifter of a recording, and the recording with its joints in that vocabulary.

    model: "auto", the name of a shipped model, a file of weights, or "none" for geometry alone;
        or a lifter, whose joints the recording's vocabulary already means. Where it is not the
        model that the recording was made for, keypoints are matched to its joints by name.

    Raises FormatError, and MismatchError where a lifter has too few joints for the vocabulary.
    """
    if isinstance(model, Lifter):
        _check_joints(recording, model)
        return recording, model
    name = recording.model if model == AUTO else str(model)
    if name != recording.model:
        vocabulary = match_names(recording.keypoints, load_vocabulary(name))
        recording = replace(recording, vocabulary=vocabulary, model=name)
    return recording, load_model(name)


def _check_joints(recording: Recording, lifter: Lifter) -> None:
    """Raise MismatchError where a lifter has too few joints for a recording's vocabulary."""
    needed = int(recording.vocabulary.max(initial=-1)) + 1
    if lifter.config.joints < needed:
        raise MismatchError(
            f"expected a network of the {needed} joints or more that the recording has in the "
            f"vocabulary of {recording.model}, found one of {lifter.config.joints}; "
            "give the model by its name or file"
        )


def load_model(name: str = "people") -> Lifter:
    """Return the lifter of a shipped skeleton, or that in a weights file. Raises FormatError.

    For geometry alone any will do, as it is given no joint.
    """
    lifter, _ = load_lifter("people" if name == GEOMETRY_ALONE else name)
    return lifter
