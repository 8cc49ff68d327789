"""The networks in torch: the factorised SteerPose and the paper's with a rotation token.

Projection is linear in the 3D pose, so the minimiser of the squared keypoint error of SteerPose
(Lee et al., BMVC 2025, eq. 1) is q*(R) = P R E[X | p]: the posterior mean of the 3D pose X given
the 2D pose p, rotated by R and projected by P. The factorised network therefore estimates X from p
alone; it is covariant to R by construction, and another R costs no network pass. The rotation-token
network (section 3.1 and appendix C) is kept as a measured reference.
"""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import torch
from safetensors.torch import save
from torch import Tensor, nn

from mocap_calib.config import ENCODER_HEADS
from mocap_calib.io.atomic import write_bytes
from mocap_calib.lift.lifter import (
    DESCRIPTION,
    LOG_DEVIATIONS,
    Lifter,
    ModelConfig,
    check_weights,
    describe_model,
    load_lifter,
    load_network,
)
from mocap_calib.types import Bools, Floats32, Skeleton


class LifterModule(nn.Module):
    """Lift a 2D pose, seen by a virtual camera that looks at the body, to 3D with its uncertainty.

    What is trained, and what computes on a GPU; `lifter.Lifter` computes the same without torch.

    One token a joint (a projection of its position, or a learnt vector where it is missing, plus a
    learnt embedding of which joint it is), a transformer encoder, one linear head for all tokens.
    """

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self.position = nn.Linear(2, config.width)
        self.missing, self.joint = _learnt_tokens(config.joints, config.width)
        self.encoder = transformer_encoder(config.width, heads=config.heads, layers=config.layers)
        self.head = nn.Linear(config.width, 5)

    def forward(self, pose: Tensor, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Lift a batch of poses.

        pose: `[B, J, 2]` positions, centred and scaled by `normalise`; seen: `[B, J]` bool.
        Returns joints `[B, J, 3]` in the same units (x right, y down, z away from the camera) and
        `[B, J, 2]` logarithms of their standard deviations, across the ray and along it.
        """
        known = torch.where(seen[..., None], pose, torch.zeros_like(pose))  # (B, J, 2)
        token = torch.where(seen[..., None], self.position(known), self.missing)  # (B, J, C)
        token = token + self.joint  # (B, J, C)
        out = self.head(self.encoder(token))  # (B, J, 5)
        across, along = out[..., :2], out[..., 2:3]
        joints = torch.cat([known + across, along], dim=-1)  # (B, J, 3)
        log_deviation = out[..., 3:].clamp(*LOG_DEVIATIONS)  # (B, J, 2)
        return joints, log_deviation


def module_of(lifter: Lifter) -> LifterModule:
    """Return the module of a trained lifter."""
    module = LifterModule(lifter.config)
    module.load_state_dict({name: torch.tensor(each) for name, each in lifter.weights.items()})
    return module.eval()


@dataclass(frozen=True, eq=False)
class DeviceLifter(Lifter):
    """A lifter whose network runs in torch on a device such as "cuda:1"."""

    device: str

    @torch.no_grad()
    def __call__(self, pose: Floats32, seen: Bools) -> tuple[Floats32, Floats32]:
        """Return joints `[B, J, 3]` and log standard deviations `[B, J, 2]`, see `Lifter`."""
        given = (torch.from_numpy(values).to(self.device) for values in (pose, seen))
        joints, log_deviation = self._module(*given)
        return joints.cpu().numpy(), log_deviation.cpu().numpy()

    @cached_property
    def _module(self) -> LifterModule:
        """The network in torch, on the device."""
        return module_of(self).to(self.device)


def _learnt_tokens(tokens: int, width: int) -> tuple[nn.Parameter, nn.Parameter]:
    """Return what stands for a missing position `[width]`, and for each token `[token, width]`."""
    missing, own = torch.randn(width), torch.randn(tokens, width)
    return nn.Parameter(0.02 * missing), nn.Parameter(0.5 * own)


def transformer_encoder(width: int, *, heads: int, layers: int) -> nn.TransformerEncoder:
    """Return the encoder `[B, T, width]` -> `[B, T, width]` of both architectures."""
    layer = nn.TransformerEncoderLayer(
        width,
        heads,
        2 * width,
        dropout=0.0,
        activation="gelu",
        batch_first=True,
        norm_first=True,
    )
    return nn.TransformerEncoder(
        layer, layers, norm=nn.LayerNorm(width), enable_nested_tensor=False
    )


def normalise(pose: Tensor, seen: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Centre poses on their visible joints and scale those to an RMS radius of 1.

    pose: `[B, J, 2]`; seen: `[B, J]` bool. Returns the pose `[B, J, 2]`, the centre `[B, 2]` and
    the scale `[B]`, in the units of the input.
    """
    weight = seen.to(pose.dtype)[..., None]  # (B, J, 1)
    count = weight.sum(1).clamp_min(1.0)  # (B, 1)
    known = torch.where(seen[..., None], pose, torch.zeros_like(pose))
    centre = known.sum(1) / count
    offset = (known - centre[:, None]) * weight  # (B, J, 2)
    square = offset.square().sum((1, 2)) / count[:, 0]  # (B,)
    scale = square.sqrt().clamp_min(1e-9)
    return offset / scale[:, None, None], centre, scale


@dataclass(frozen=True)
class TokenConfig:
    """Size of the paper's network; saved inside the checkpoint.

    The paper does not give the number of heads and the width of the feed-forward layers.
    """

    joints: int
    width: int = 32  # of a token
    layers: int = 5  # of the encoder
    heads: int = ENCODER_HEADS


class TokenSteerer(nn.Module):
    """Predict a 2D pose in a rotated view from the pose and the rotation: q(R) of section 3.1.

    N joint tokens and one rotation token, each through an MLP, plus N + 1 learnt positional
    embeddings; a transformer encoder; mean pooling to one vector; an MLP to N x 2. A joint that is
    not seen is masked: a learnt vector takes the place of its token.
    """

    def __init__(self, config: TokenConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.position = _mlp(2, width, width)
        self.rotation = _mlp(3, width, width)
        self.missing, self.embedding = _learnt_tokens(config.joints + 1, width)
        self.encoder = transformer_encoder(width, heads=config.heads, layers=config.layers)
        self.head = _mlp(width, 4 * width, 2 * config.joints)

    def forward(self, pose: Tensor, seen: Tensor, vector: Tensor) -> Tensor:
        """Steer a batch of poses.

        pose: `[B, J, 2]` centred and scaled by `model.normalise`; seen: `[B, J]` bool; vector:
        `[B, 3]` Rodrigues vector, in radians, of the rotation from the pose's view to the other.
        Returns `[B, J, 2]` in the units of the input.
        """
        known = torch.where(seen[..., None], pose, torch.zeros_like(pose))  # (B, J, 2)
        joints = torch.where(seen[..., None], self.position(known), self.missing)  # (B, J, C)
        rotation = self.rotation(vector)[:, None]  # (B, 1, C)
        token = torch.cat([joints, rotation], dim=1) + self.embedding  # (B, J + 1, C)
        pooled = self.encoder(token).mean(1)  # (B, C)
        return self.head(pooled).view(len(pose), -1, 2)  # (B, J, 2)


def _mlp(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    """Return a perceptron with one hidden layer."""
    return nn.Sequential(nn.Linear(inputs, hidden), nn.GELU(), nn.Linear(hidden, outputs))


Model = LifterModule | TokenSteerer


def steer(model: Model, pose: Tensor, seen: Tensor, vector: Tensor) -> Tensor:
    """Return q(R) of the paper (section 3.1): the poses `[B, J, 2]` in the rotated views.

    pose: `[B, J, 2]` centred and scaled by `model.normalise`; seen: `[B, J]` bool; vector: `[B, 3]`
    Rodrigues vectors in radians. The result is in the units of the input, and complete: joints
    that are not seen are predicted. A vector of zeros completes the pose in its own view.
    """
    return prepare_steering(model, pose, seen)(vector)


def prepare_steering(model: Model, pose: Tensor, seen: Tensor) -> Callable[[Tensor], Tensor]:
    """Return a function from rotation vectors `[B, 3]` to the steered poses `[B, J, 2]`.

    For many rotations of the same poses, as in `steer`: what does not depend on R is done once. The
    factorised model lifts here and only rotates afterwards; the rotation-token model needs the
    whole network for each rotation.
    """
    if not isinstance(model, LifterModule):
        return lambda vector: model(pose, seen, shortest(vector))
    body, _ = model(pose, seen)  # (B, J, 3)

    def rotate_and_project(vector: Tensor) -> Tensor:
        """Return P R X `[B, J, 2]` of rotation vectors `[B, 3]`."""
        projection = matrix_from_vector(vector)[:, :2]  # (B, 2, 3)
        return torch.einsum("bij,bkj->bki", projection, body)  # (B, J, 2)

    return rotate_and_project


def matrix_from_vector(vector: Tensor) -> Tensor:
    """Return the rotation matrices `[..., 3, 3]` of Rodrigues vectors `[..., 3]` in radians.

    Rodrigues' formula, differentiable also at zero. The numpy form is
    `geometry.rotation.matrix_from_vector`; this one has gradients.
    """
    angle2 = vector.square().sum(-1)[..., None, None]  # (..., 1, 1)
    small = angle2 <= 1e-12
    safe = torch.where(angle2 > 1e-12, angle2, torch.ones_like(angle2)).sqrt()
    first = torch.where(small, 1 - angle2 / 6, safe.sin() / safe)
    second = torch.where(small, 0.5 - angle2 / 24, (1 - safe.cos()) / safe.square())
    cross = skew(vector)
    eye = torch.eye(3, dtype=vector.dtype, device=vector.device)
    return eye + first * cross + second * (cross @ cross)


def skew(vector: Tensor) -> Tensor:
    """Return the cross product with vectors `[..., 3]` as matrices `[..., 3, 3]`.

    The numpy form is `geometry.rotation.skew`; this one has gradients.
    """
    x, y, z = vector.unbind(-1)
    zero = torch.zeros_like(x)
    entries = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1)  # (..., 9)
    return entries.reshape(*vector.shape, 3)  # (..., 3, 3)


def shortest(vector: Tensor) -> Tensor:
    """Return the Rodrigues vectors `[..., 3]` of the same rotations that are at most pi long.

    The rotation-token network was trained with no others.
    """
    angle = vector.norm(dim=-1, keepdim=True).clamp_min(1e-9)
    turns = torch.round(angle / (2 * torch.pi)).detach()
    return vector * (1 - 2 * torch.pi * turns / angle)


# --- files of weights


def save_model(path: Path, model: Model, skeleton: Skeleton, card: dict[str, object]) -> None:
    """Write weights, size of the network, vocabulary and model card into one file."""
    names = skeleton.keypoints
    description = {
        "architecture": "factorised" if isinstance(model, LifterModule) else "token",
        "model": asdict(model.config),
        "skeleton": {  # as `parse_skeleton` reads it
            "name": skeleton.name,
            "keypoints": names,
            "edges": [[names[parent], names[child]] for parent, child in skeleton.edges],
            "aliases": skeleton.aliases,
            "layouts": {str(k): layout for k, layout in enumerate(skeleton.layouts)},
        },
        "card": card,
    }
    tensors = {
        name: value.detach().cpu().contiguous() for name, value in model.state_dict().items()
    }
    metadata = {DESCRIPTION: json.dumps(description, sort_keys=True)}
    write_bytes(path, save(tensors, metadata=metadata))


def load_steerer(name_or_path: str | Path = "people") -> tuple[Model, Skeleton]:
    """Return a network and its vocabulary: a shipped one by its skeleton's name, or from a file.

    The weights of the paper's network have names like "people_token". Without torch,
    `lift.lifter` reads those that lift. Raises FormatError.
    """
    description = describe_model(name_or_path)
    if description.get("architecture") != "token":
        lifter, skeleton = load_lifter(name_or_path)
        return module_of(lifter), skeleton
    size, skeleton, weights = load_network(name_or_path, TokenConfig, description)
    with torch.device("meta"):  # without memory
        model = TokenSteerer(size)
    shapes = {name: tuple(value.shape) for name, value in model.state_dict().items()}
    check_weights(shapes, weights, str(name_or_path))
    model.load_state_dict(
        {name: torch.from_numpy(weight) for name, weight in weights.items()}, assign=True
    )
    return model.eval(), skeleton
