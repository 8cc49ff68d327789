"""The network that lifts 2D poses to 3D, computed in numpy, and its files of weights.

torch, which trains it as `training.model.LifterModule`, takes more than a second to import, and is
no quicker for networks as small as these; a test holds the two together.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import load_file

from mocap_calib.config import ENCODER_HEADS
from mocap_calib.errors import FormatError, MismatchError, argument, suggest
from mocap_calib.io.document import typed
from mocap_calib.io.hdf5 import damage_refused
from mocap_calib.kernels.lifter import activate
from mocap_calib.recording.joints import SHIPPED, load_skeleton, match_names, parse_skeleton
from mocap_calib.types import Bools, Floats32, Recording, Skeleton

LOG_DEVIATIONS = (-6.0, 3.0)  # the least and the largest that a network states
_BLOCK = 32  # poses at a time: what they need stays in the cache of a core
_EPSILON = np.float32(1e-5)  # of torch's LayerNorm
# of attention, whose exponentials are finite in 32 bits; those of shipped networks are below 20
_LARGEST_SCORE = 70.0

AUTO = "auto"  # asks for the model that the recording was made for
GEOMETRY_ALONE = "none"  # asks for no model: it knows no joint, and the geometry must do
DESCRIPTION = "mocap_calib"  # key of the description in the metadata of a file of weights


_TRAIN_AGAIN = "the file is damaged: copy it again, or write it by `mocap-calib train`"


@dataclass(frozen=True)
class ModelConfig:
    """Size of the network; saved inside the checkpoint."""

    joints: int
    width: int = 64
    layers: int = 4
    heads: int = ENCODER_HEADS


Size = TypeVar("Size")


class _Linear(NamedTuple):
    """x -> x @ matrix `[input, output]` + bias `[output]`."""

    matrix: Floats32
    bias: Floats32

    def __call__(self, values: Floats32) -> Floats32:
        """Return `[..., output]` of values `[..., input]`."""
        result: Floats32 = values @ self.matrix
        result += self.bias
        return result


class _Layer(NamedTuple):
    """A layer of the encoder; `attend` and `widen` take standardised tokens."""

    attend: _Linear  # to queries, keys and values
    project: _Linear
    widen: _Linear
    narrow: _Linear


@dataclass(frozen=True, eq=False)  # its weights are many: a lifter is equal to itself alone
class Lifter:
    """Lifts 2D poses, seen by a virtual camera that looks at the body, to 3D with uncertainty.

    weights: float32 arrays by the names that torch gives them.
    """

    config: ModelConfig
    weights: Mapping[str, Floats32]

    def __call__(self, pose: Floats32, seen: Bools) -> tuple[Floats32, Floats32]:
        """Lift a batch of poses.

        pose: `[B, J, 2]` positions, centred and scaled by `normalise`; seen: `[B, J]`.
        Returns joints `[B, J, 3]` in the same units (x right, y down, z away from the camera) and
        `[B, J, 2]` logarithms of their standard deviations, across the ray and along it.
        """
        known = np.where(seen[..., None], pose, np.float32(0))
        out = np.empty((*seen.shape, 5), dtype=np.float32)
        # large weights, as of a damaged file, give what is not finite, which no pair fits
        with np.errstate(all="ignore"):
            for start in range(0, len(pose), _BLOCK):
                block = slice(start, start + _BLOCK)
                out[block] = self._apply(known[block], seen[block])
        joints = np.concatenate([known + out[..., :2], out[..., 2:3]], axis=-1)
        return joints, np.clip(out[..., 3:], *LOG_DEVIATIONS)

    def _apply(self, known: Floats32, seen: Bools) -> Floats32:
        """Return the output `[B, J, 5]` of the head for poses `[B, J, 2]`, 0 where not seen."""
        position = self._linear("position.")(known)
        token = np.where(seen[..., None], position, self.weights["missing"]) + self.weights["joint"]
        token = token.reshape(-1, self.config.width)  # [B J, C]: numpy multiplies 2D arrays fastest
        for layer in self._layers:
            token += layer.project(self._attend(layer.attend(_standardise(token))))
            wide = _standardise(token) @ layer.widen.matrix
            activate(wide, layer.widen.bias)
            token += layer.narrow(wide)
        return self._head(_standardise(token)).reshape(*seen.shape, -1)

    @cached_property
    def _layers(self) -> tuple[_Layer, ...]:
        """The layers of the encoder."""
        names = [f"encoder.layers.{number}" for number in range(self.config.layers)]
        return tuple(
            _Layer(
                attend=self._linear(f"{name}.self_attn.in_proj_", after=f"{name}.norm1"),
                project=self._linear(f"{name}.self_attn.out_proj."),
                widen=self._linear(f"{name}.linear1.", after=f"{name}.norm2"),
                narrow=self._linear(f"{name}.linear2."),
            )
            for name in names
        )

    @cached_property
    def _head(self) -> _Linear:
        """What makes the output of tokens."""
        return self._linear("head.", after="encoder.norm")

    def _linear(self, name: str, *, after: str = "") -> _Linear:
        """Return a linear map by its name, with the gain and the offset of the norm before it."""
        matrix, bias = self.weights[f"{name}weight"].T, self.weights[f"{name}bias"]
        if after:
            bias = bias + self.weights[f"{after}.bias"] @ matrix
            matrix = self.weights[f"{after}.weight"][:, None] * matrix
        return _Linear(np.ascontiguousarray(matrix), bias)

    def _attend(self, heads: Floats32) -> Floats32:
        """Return what each joint gathers from all joints of its pose, `[B J, C]`.

        heads: `[B J, 3 C]` queries, keys and values of each joint.
        """
        size = self.config
        heads = heads.reshape(-1, size.joints, 3, size.heads, size.width // size.heads)
        query, key, value = heads.transpose(2, 0, 3, 1, 4)  # [B, head, J, C / heads] each
        score = (query * np.float32(query.shape[-1] ** -0.5)) @ np.swapaxes(key, -1, -2)
        if max(score.max(), -score.min()) > _LARGEST_SCORE:
            score -= score.max(-1, keepdims=True)
        np.exp(score, out=score)  # [B, head, J, J]
        gathered = score @ value
        gathered /= np.einsum("bhij->bhi", score)[..., None]
        return np.swapaxes(gathered, 1, 2).reshape(-1, size.width)


def _standardise(token: Floats32) -> Floats32:
    """Return tokens `[N, C]` with mean 0 and variance 1: LayerNorm without gain and offset."""
    standard = token - token.mean(-1, keepdims=True)
    variance = np.einsum("nc,nc->n", standard, standard) / np.float32(token.shape[-1])
    standard /= np.sqrt(variance + _EPSILON)[:, None]
    return standard


# --- files of weights


def shipped_weights(name: str) -> Traversable:
    """Return the place of weights in the package, which may not be there."""
    return resources.files("mocap_calib") / "weights" / f"{name}.safetensors"


def shipped_tokens() -> tuple[str, ...]:
    """Return the names of the shipped weights of the paper's architecture."""
    names = (f"{name}_token" for name in SHIPPED)
    return tuple(name for name in names if shipped_weights(name).is_file())


def weights_of(name_or_path: str) -> Traversable:
    """Return the place of the weights of a shipped model, or the file of that name."""
    shipped = name_or_path in (*SHIPPED, *shipped_tokens())
    return shipped_weights(name_or_path) if shipped else Path(name_or_path)


def digest(name_or_path: str) -> str:
    """Return the SHA-256 of the weights of a model: a shipped one, or one in a file."""
    return hashlib.sha256(weights_of(name_or_path).read_bytes()).hexdigest()


def identify_model(name: str) -> str:
    """Return the identity of a model: the SHA-256 of its weights, if it has any.

    For a rotation token also that of the weights that lift for it.
    """
    if name == GEOMETRY_ALONE:
        return GEOMETRY_ALONE
    return digest(name) + (digest(lifter_beside(name)) if is_token(name) else "")


def describe_model(name_or_path: str | Path) -> dict[str, Any]:
    """Return the description in a file of weights, or in those of a shipped model.

    Raises FormatError.
    """
    with resources.as_file(weights_of(str(name_or_path))) as path:
        try:
            with safe_open(path, framework="np") as file:
                return dict(json.loads((file.metadata() or {})[DESCRIPTION]))
        except FileNotFoundError:
            raise FormatError(
                path,
                f"a shipped model ({', '.join(SHIPPED)}), a file of weights, or none",
                "neither",
                suggest(str(path), SHIPPED),
            ) from None
        except (SafetensorError, KeyError, ValueError, TypeError, RecursionError) as error:
            reason = str(error).splitlines()[0]
            raise FormatError(
                path, "weights that `train` wrote", f"another file ({reason})", "check the path"
            ) from None


def models() -> dict[str, dict[str, Any]]:
    """Return the model card of each shipped lifter, by the name of its skeleton."""
    there = [name for name in SHIPPED if shipped_weights(name).is_file()]
    return {name: describe_model(name)["card"] for name in there}


def load_vocabulary(name: str) -> Skeleton:
    """Return the joints that a model knows: none for geometry alone. Raises FormatError."""
    if name == GEOMETRY_ALONE:
        return Skeleton(GEOMETRY_ALONE, keypoints=(), edges=(), symmetries=(), aliases={})
    return parse_skeleton(describe_model(name).get("skeleton"), name)


def is_token(name_or_path: str) -> bool:
    """Return whether weights are of the paper's architecture. Raises FormatError."""
    return describe_model(name_or_path).get("architecture") == "token"


def lifter_beside(token: str) -> str:
    """Return the shipped model with the joints of a rotation token, which lifts in its place.

    token: a shipped one, or one in a file. Raises FormatError where none has the same joints.
    """
    joints = load_vocabulary(token)
    if joints.name in SHIPPED and load_skeleton(joints.name).keypoints == joints.keypoints:
        return joints.name
    raise FormatError(
        token,
        f"a rotation token with the joints of a shipped model ({', '.join(SHIPPED)}), which lifts "
        "where it steers",
        f"others ({joints.name})",
        f"train it with {argument('skeleton')} and a name of these",
    )


def load_lifter(name_or_path: str | Path = "people") -> tuple[Lifter, Skeleton]:
    """Return a lifter and its vocabulary: a shipped one by name, or one from a file.

    Raises FormatError.
    """
    description = describe_model(name_or_path)
    if description.get("architecture") == "token":
        raise FormatError(
            name_or_path,
            "weights that lift",
            "the paper's, whose rotation token cannot",
            f"`run` and `pairwise` take them with {argument('solver', 'paper')}",
        )
    size, skeleton, weights = load_network(name_or_path, ModelConfig, description)
    check_weights(_shapes(size), weights, str(name_or_path))
    return Lifter(size, weights), skeleton


def load_network(
    name_or_path: str | Path, kind: type[Size], description: Mapping[str, Any]
) -> tuple[Size, Skeleton, dict[str, Floats32]]:
    """Return the size of a network, its vocabulary and its weights.

    kind: of the size: `ModelConfig`, or another with the same fields. description: of the file.

    Raises FormatError where the size is not that of the weights.
    """
    source = str(name_or_path)
    with resources.as_file(weights_of(source)) as path, damage_refused(source, "weights"):
        weights = load_file(path)
    skeleton = parse_skeleton(description.get("skeleton"), source)
    size: Any = typed(description.get("model"), kind, source)
    expected = (len(skeleton.keypoints), weights.get("missing", np.empty(0)).size)
    is_possible = 0 < size.layers <= len(weights) and 0 < size.heads <= size.width
    if (size.joints, size.width) != expected or not is_possible or size.width % size.heads:
        said = "a network as large as its skeleton and its weights"
        raise FormatError(source, said, size, _TRAIN_AGAIN)
    return size, skeleton, weights


def check_weights(
    expected: Mapping[str, tuple[int, ...]], weights: Mapping[str, Floats32], source: str
) -> None:
    """Raise FormatError where tensors have other names or shapes, or are no finite 32-bit floats.

    expected: shapes by the names of tensors. Another shape might broadcast, to another network.
    """
    found = {name: weight.shape for name, weight in weights.items()}
    for name in sorted({*expected, *found}):
        shapes = [f"shape {list(of[name])}" if name in of else "none" for of in (expected, found)]
        if shapes[0] != shapes[1]:
            raise FormatError(source, f"weights `{name}`: {shapes[0]}", shapes[1], _TRAIN_AGAIN)
        if weights[name].dtype != np.float32 or not np.isfinite(weights[name]).all():
            said = f"finite 32-bit floats as weights `{name}`"
            raise FormatError(source, said, "others", _TRAIN_AGAIN)


def _shapes(size: ModelConfig) -> dict[str, tuple[int, ...]]:
    """Return the shape of each tensor of a lifter, by the names that torch gives them."""
    width, norms = size.width, ["encoder.norm."]
    linear = {"position.": (width, 2), "head.": (5, width)}
    for number in range(size.layers):
        layer = f"encoder.layers.{number}."
        norms += [f"{layer}norm1.", f"{layer}norm2."]
        linear[f"{layer}self_attn.in_proj_"] = (3 * width, width)
        linear[f"{layer}self_attn.out_proj."] = (width, width)
        linear[f"{layer}linear1."] = (2 * width, width)
        linear[f"{layer}linear2."] = (width, 2 * width)
    shapes: dict[str, tuple[int, ...]] = {"joint": (size.joints, width), "missing": (width,)}
    shapes |= {f"{name}{part}": (width,) for name in norms for part in ("weight", "bias")}
    shapes |= {f"{name}weight": shape for name, shape in linear.items()}
    return shapes | {f"{name}bias": shape[:1] for name, shape in linear.items()}


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


def choose_model(
    recording: Recording, model: str | Path | Lifter, *, pair_solver: str = "search"
) -> tuple[Recording, Lifter]:
    """Return the lifter of a recording, and the recording with its joints in that vocabulary.

    model: "auto", the name of a shipped model, a file of weights, or "none" for geometry alone;
        or a lifter, whose joints the recording's vocabulary already means. Where it is not the
        model that the recording was made for, keypoints are matched to its joints by name.
    pair_solver: what will calibrate the pairs, see `load_model`.

    Raises FormatError, and MismatchError where a lifter has too few joints for the vocabulary.
    """
    if isinstance(model, Lifter):
        needed = int(recording.vocabulary.max(initial=-1)) + 1
        if model.config.joints < needed:
            raise MismatchError(
                "",
                f"a network of the {needed} joints or more that the recording has in the "
                f"vocabulary of {recording.model}",
                f"one of {model.config.joints}",
                "give the model by its name or file",
            )
        return recording, model
    name = recording.model if model == AUTO else str(model)
    if name != recording.model:
        vocabulary = match_names(recording.keypoints, load_vocabulary(name))
        recording = replace(recording, vocabulary=vocabulary, model=name)
    return recording, load_model(name, pair_solver=pair_solver)
