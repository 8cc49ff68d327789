"""A trained network that lifts 2D poses: its weights as arrays, and what it computes in numpy.

The same function as `model.LifterModule`, which torch trains; a test holds the two together. torch
takes more than a second to import, and is no quicker for networks as small as these.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mocap_calib.config import ENCODER_HEADS
from mocap_calib.kernels.lifter import activate
from mocap_calib.types import Bools, Floats32

LOG_DEVIATIONS = (-6.0, 3.0)  # the least and the largest that a network states
_BLOCK = 32  # poses at a time: what they need stays in the cache of a core
_NAMES = ("weight", "bias")
_EPSILON = np.float32(1e-5)  # of torch's LayerNorm
# of a query and a key, whose exponentials are good in 32 bits as they are: no score of the networks
# that are shipped can be above 67, as their weights tell, and those of recordings are below 20
_LARGEST_SCORE = np.float32(70)


@dataclass(frozen=True)
class ModelConfig:
    """Size of the network; saved inside the checkpoint."""

    joints: int
    width: int = 64
    layers: int = 4
    heads: int = ENCODER_HEADS


@dataclass(frozen=True)
class _Linear:
    """x -> x @ matrix + bias. matrix: `[input, output]`; bias: `[output]`."""

    matrix: Floats32
    bias: Floats32

    def __call__(self, values: Floats32) -> Floats32:
        """Return `[..., output]` of values `[..., input]`."""
        result: Floats32 = values @ self.matrix
        result += self.bias
        return result


@dataclass(frozen=True)
class _Layer:
    """A layer of the encoder.

    The gains and offsets of its norms are part of `attend` and `widen`, the scale of the scores of
    the queries in `attend`. What `project` and `narrow` add to a token has mean 0.
    """

    attend: _Linear  # to queries, keys and values, of each the heads
    project: _Linear
    widen: _Linear
    narrow: _Linear


@dataclass(frozen=True)
class _Encoder:
    """What a network computes.

    The mean of a token says nothing, as each layer begins with a norm: it is taken away from all
    that is added up to one.

    missing: `[C]`; joint: `[J, C]` parts of tokens.
    """

    position: _Linear  # to a part of a token
    missing: Floats32
    joint: Floats32
    layers: tuple[_Layer, ...]
    head: _Linear  # from a token, whose last norm is a part of it, to a joint


@dataclass(frozen=True, eq=False)  # its weights are many: a lifter is equal to itself alone
class Lifter:
    """Lifts 2D poses, seen by a virtual camera that looks at the body, to 3D with uncertainty.

    weights: float32 arrays by the names that torch gives them (`model.LifterModule`).
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
        for start in range(0, len(pose), _BLOCK):
            block = slice(start, start + _BLOCK)
            out[block] = self._apply(known[block], seen[block])
        joints = np.concatenate([known + out[..., :2], out[..., 2:3]], axis=-1)
        return joints, np.clip(out[..., 3:], *LOG_DEVIATIONS)

    def _apply(self, known: Floats32, seen: Bools) -> Floats32:
        """Return what the head says `[B, J, 5]` of poses `[B, J, 2]`, 0 where not seen."""
        size, encoder = self.config, self._encoder
        token = np.where(seen[..., None], encoder.position(known), encoder.missing)
        token += encoder.joint
        token = token.reshape(-1, size.width)  # [B J, C]
        standard = np.empty_like(token)
        _standardise(token, standard)
        for layer in encoder.layers:
            heads = layer.attend(standard).reshape(len(seen), size.joints, 3, size.heads, -1)
            _add(layer.project, _attend(heads).reshape(token.shape), token, standard)
            _add(layer.narrow, _activate(layer.widen, standard), token, standard)
        return encoder.head(standard).reshape(len(seen), size.joints, 5)

    @cached_property
    def _encoder(self) -> _Encoder:
        """What the weights compute."""
        return _Encoder(
            position=_centred(self.weights["position.weight"], self.weights["position.bias"]),
            missing=_centred_vectors(self.weights["missing"]),
            joint=_centred_vectors(self.weights["joint"]),
            layers=tuple(self._list_layers()),
            head=self._linear_of_norm("encoder.norm", "head.weight", "head.bias"),
        )

    def _list_layers(self) -> Iterator[_Layer]:
        """Yield the layers of the encoder."""
        size = self.config
        scale = np.ones(3 * size.width)
        scale[: size.width] = (size.width // size.heads) ** -0.5
        for number in range(size.layers):
            layer = f"encoder.layers.{number}"
            inward = f"{layer}.self_attn.in_proj"
            outward = f"{layer}.self_attn.out_proj"
            attend = self._linear_of_norm(f"{layer}.norm1", f"{inward}_weight", f"{inward}_bias")
            # a bias of keys adds the same to all scores of a query, which changes nothing
            attend.bias[size.width : 2 * size.width] = 0
            widen = (f"{layer}.linear1.weight", f"{layer}.linear1.bias")
            narrow = (f"{layer}.linear2.weight", f"{layer}.linear2.bias")
            yield _Layer(
                attend=_linear(attend.matrix.T * scale[:, None], attend.bias * scale),
                project=_centred(*(self.weights[f"{outward}.{name}"] for name in _NAMES)),
                widen=self._linear_of_norm(f"{layer}.norm2", *widen),
                narrow=_centred(*(self.weights[name] for name in narrow)),
            )

    def _linear_of_norm(self, norm: str, weight: str, bias: str) -> _Linear:
        """Return the linear map of those names after the gain and the offset of a norm."""
        matrix = self.weights[weight].astype(np.float64)
        offset = matrix @ self.weights[f"{norm}.bias"]
        return _linear(matrix * self.weights[f"{norm}.weight"], self.weights[bias] + offset)


def _linear(weight: NDArray[np.floating], bias: NDArray[np.floating]) -> _Linear:
    """Return the linear map of a weight `[output, input]` and a bias `[output]`."""
    return _Linear(np.ascontiguousarray(weight.T, dtype=np.float32), bias.astype(np.float32))


def _centred(weight: Floats32, bias: Floats32) -> _Linear:
    """Return the linear map to a part of a token, whose mean is taken away."""
    return _linear(_centred_vectors(weight.T).T, _centred_vectors(bias))


def _centred_vectors(vectors: Floats32) -> Floats32:
    """Return vectors `[..., C]` less their means."""
    mean = vectors.mean(-1, keepdims=True, dtype=np.float64)
    return (vectors - mean).astype(np.float32)


def _standardise(token: Floats32, standard: Floats32) -> None:
    """Set `standard` to tokens `[N, C]` of mean 0 with variance 1: LayerNorm but for its gain."""
    deviation = np.einsum("nc,nc->n", token, token)
    deviation /= np.float32(token.shape[-1])
    deviation += _EPSILON
    np.sqrt(deviation, out=deviation)
    np.divide(token, deviation[:, None], out=standard)


def _add(linear: _Linear, values: Floats32, token: Floats32, standard: Floats32) -> None:
    """Add a linear map of values `[N, input]` to tokens `[N, C]`, and standardise those."""
    token += values @ linear.matrix
    token += linear.bias
    _standardise(token, standard)


def _attend(heads: Floats32) -> Floats32:
    """Return what each joint gathers from all joints of its pose, `[B, J, head, C / heads]`.

    heads: `[B, J, 3, head, C / heads]` queries, which are scaled, keys and values.
    """
    query, key, value = heads.transpose(2, 0, 3, 1, 4)  # [B, head, J, C / heads] each
    score = query @ np.swapaxes(key, -1, -2)  # [B, head, J, J]
    if max(score.max(), -score.min()) > _LARGEST_SCORE:  # of a network that somebody trained
        score -= score.max(-1, keepdims=True)
    np.exp(score, out=score)
    joints = score.shape[-1]
    total = score.reshape(-1, joints) @ np.ones((joints, 1), dtype=np.float32)
    gathered: Floats32 = score @ value
    gathered /= total.reshape(*score.shape[:-1], 1)
    return np.swapaxes(gathered, 1, 2)


def _activate(linear: _Linear, values: Floats32) -> Floats32:
    """Return the GELU of a linear map of values `[N, input]`."""
    wide: Floats32 = values @ linear.matrix
    activate(wide, linear.bias)
    return wide
