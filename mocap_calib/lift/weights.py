"""Load the networks that lift, and the descriptions and vocabularies in files of weights."""

import hashlib
import json
from dataclasses import replace
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open

from mocap_calib.errors import FormatError, MismatchError, suggest
from mocap_calib.lift.lifter import Lifter, ModelConfig
from mocap_calib.recording.joints import SHIPPED, load_skeleton, match_names, parse_skeleton
from mocap_calib.types import Recording, Skeleton

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
    """Return the identity of a model: the SHA-256 of its weights, if it has any.

    For a rotation token also that of the weights that lift for it.
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
    """Return the shipped model with the joints of a rotation token, which lifts in its place.

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
    """Return the description in a file of weights. Raises FormatError."""
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


AUTO = "auto"  # asks for the model that the recording was made for


def load_lifter(name_or_path: str | Path = "people") -> tuple[Lifter, Skeleton]:
    """Return a lifter and its vocabulary: a shipped one by name, or one from a file.

    Raises FormatError.
    """
    with resources.as_file(weights_of(str(name_or_path))) as path:
        return _read(path)


def _read(path: Path) -> tuple[Lifter, Skeleton]:
    """Read a lifter and its vocabulary. Raises FormatError."""
    description = read_description(path)
    if description.get("architecture") == "token":
        raise FormatError(
            f"{path}: expected weights that lift, found the paper's, whose rotation token cannot; "
            "`run` and `pairwise` take them with --solver paper"
        )
    with safe_open(path, framework="np") as file:
        weights = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no dict
    lifter = Lifter(ModelConfig(**description["model"]), weights)
    return lifter, parse_skeleton(description["skeleton"], str(path))


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


def load_model(name: str = "people", *, pair_solver: str = "search") -> Lifter:
    """Return the lifter of a shipped skeleton, or that in a weights file. Raises FormatError.

    For geometry alone any will do, as it is given no joint. The paper's solver may steer by a
    rotation token; then the shipped model of the same joints lifts, for what it finds to be scored.

    pair_solver: what will calibrate the pairs, one of `config.PAIR_SOLVERS`.
    """
    if name == GEOMETRY_ALONE:
        name = "people"
    elif pair_solver == "paper" and is_token(name):
        name = lifter_beside(name)
    lifter, _ = load_lifter(name)
    return lifter
