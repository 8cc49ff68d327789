"""Weights as safetensors files that describe themselves."""

import json
from dataclasses import asdict
from importlib import resources
from pathlib import Path

from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from mocap_calib.errors import FormatError
from mocap_calib.io.atomic import write_bytes
from mocap_calib.skeleton import parse_skeleton
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
        },
        "card": card,
    }
    tensors = {name: value.detach().cpu().contiguous() for name, value in lifter.state_dict().items()}
    write_bytes(path, save(tensors, metadata={_KEY: json.dumps(description, sort_keys=True)}))


def load_lifter(path: Path | None = None) -> tuple[Lifter, Skeleton]:
    """The factorised network and its vocabulary from a file, or the shipped ones for people. Raises FormatError."""
    model, skeleton = load_steerer(path)
    if not isinstance(model, Lifter):
        raise FormatError(f"{path}: expected weights of the factorised architecture, found those of the rotation token; use them with --solver paper")
    return model, skeleton


def load_steerer(path: Path | None = None, *, architecture: Architecture = "factorised") -> tuple[Model, Skeleton]:
    """A network of either architecture from a file, or the shipped one for people of the given. Raises FormatError."""
    if path is None:
        name = "people.safetensors" if architecture == "factorised" else "people_token.safetensors"
        with resources.as_file(resources.files("mocap_calib") / "weights" / name) as shipped:
            return _read(shipped)
    return _read(path)


def _read(path: Path) -> tuple[Model, Skeleton]:
    try:
        with safe_open(path, framework="pt") as file:
            description = json.loads((file.metadata() or {})[_KEY])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  (not a dictionary)
    except FileNotFoundError:
        raise FormatError(f"{path}: expected a weights file, found none") from None
    except (SafetensorError, KeyError, ValueError) as error:
        raise FormatError(f"{path}: not weights of mocap-calib: {str(error).splitlines()[0]}") from None
    token = description.get("architecture") == "token"
    lifter: Model = TokenSteerer(TokenConfig(**description["model"])) if token else Lifter(ModelConfig(**description["model"]))
    lifter.load_state_dict(tensors)
    return lifter.eval(), parse_skeleton(description["skeleton"], str(path))
