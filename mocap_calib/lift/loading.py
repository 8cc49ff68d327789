"""Load the networks that lift: shipped ones, those of a file, and the one of a recording."""

from dataclasses import replace
from importlib import resources
from pathlib import Path

from safetensors import safe_open

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.lift.lifter import Lifter, ModelConfig
from mocap_calib.lift.weights import (
    GEOMETRY_ALONE,
    is_token,
    lifter_beside,
    load_vocabulary,
    read_description,
    weights_of,
)
from mocap_calib.recording.joints import match_names
from mocap_calib.recording.skeleton_fields import parse_skeleton
from mocap_calib.types import Recording, Skeleton

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
