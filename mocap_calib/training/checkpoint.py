"""Read and write the weights of torch's networks: safetensors files that describe themselves.

`lift.weights` reads those that lift without torch.
"""

import json
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import Any

from safetensors import safe_open
from safetensors.torch import save
from torch import Tensor

from mocap_calib.io.atomic import write_bytes
from mocap_calib.lift.lifter import ModelConfig
from mocap_calib.lift.weights import (
    DESCRIPTION,
    read_description,
    weights_of,
)
from mocap_calib.recording.joints import parse_skeleton
from mocap_calib.training.model import LifterModule, Model, TokenConfig, TokenSteerer
from mocap_calib.types import Skeleton


def save_model(path: Path, model: Model, skeleton: Skeleton, card: dict[str, object]) -> None:
    """Write weights, size of the network, vocabulary and model card into one file."""
    description = {
        "architecture": "factorised" if isinstance(model, LifterModule) else "token",
        "model": asdict(model.config),
        "skeleton": _describe_skeleton(skeleton),
        "card": card,
    }
    tensors = {
        name: value.detach().cpu().contiguous() for name, value in model.state_dict().items()
    }
    metadata = {DESCRIPTION: json.dumps(description, sort_keys=True)}
    write_bytes(path, save(tensors, metadata=metadata))


def load_steerer(name_or_path: str | Path = "people") -> tuple[Model, Skeleton]:
    """Return a network and its vocabulary: a shipped one by its skeleton's name, or from a file.

    The weights of the paper's network have names like "people_token". Raises FormatError.
    """
    with resources.as_file(weights_of(str(name_or_path))) as path:
        return _read(path)


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
        model = LifterModule(ModelConfig(**size))
    model.load_state_dict(_read_tensors(path))
    return model.eval(), parse_skeleton(description["skeleton"], str(path))
