"""Mental rotation, the same for both architectures: a 2D pose and a rotation to the 2D pose in the rotated view."""

from collections.abc import Callable
from typing import Literal

import torch
from torch import Tensor

from mocap_calib.steerpose.model import Lifter
from mocap_calib.steerpose.token import TokenSteerer

Architecture = Literal["token", "factorised"]
Model = Lifter | TokenSteerer


def steer(model: Model, pose: Tensor, seen: Tensor, vector: Tensor) -> Tensor:
    """q(R) of the paper (section 3.1): `[B, J, 2]` poses in the view rotated by the Rodrigues vectors `[B, 3]`.

    pose: `[B, J, 2]` centred and scaled by `model.normalise`; seen: `[B, J]`. The result is in the units of the input,
    and complete: joints that are not seen are predicted. A vector of zeros completes the pose as it is seen.
    """
    return steering(model, pose, seen)(vector)


def steering(model: Model, pose: Tensor, seen: Tensor) -> Callable[[Tensor], Tensor]:
    """`steer` for many rotations of the same poses: what does not depend on R is done once.

    The factorised model lifts here and only rotates afterwards; the rotation token takes the whole network each time.
    """
    if isinstance(model, Lifter):
        body, _ = model(pose, seen)
        return lambda vector: torch.einsum("bij,bkj->bki", matrix_from_vector(vector)[:, :2], body)
    return lambda vector: model(pose, seen, shortest(vector))


def matrix_from_vector(vector: Tensor) -> Tensor:
    """Rodrigues' formula, differentiable also at zero: `[..., 3]` radians -> `[..., 3, 3]`."""
    angle2 = vector.square().sum(-1)[..., None, None]
    safe = torch.where(angle2 > 1e-12, angle2, torch.ones_like(angle2)).sqrt()
    small = angle2 <= 1e-12
    first = torch.where(small, 1 - angle2 / 6, safe.sin() / safe)
    second = torch.where(small, 0.5 - angle2 / 24, (1 - safe.cos()) / safe.square())
    k = skew(vector)
    return torch.eye(3, dtype=vector.dtype, device=vector.device) + first * k + second * (k @ k)


def skew(vector: Tensor) -> Tensor:
    """The cross product as a matrix, `[..., 3]` -> `[..., 3, 3]`."""
    x, y, z = vector.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*vector.shape, 3)


def shortest(vector: Tensor) -> Tensor:
    """The vector of the same rotation that is at most pi long, as all are that the network was trained with."""
    angle = vector.norm(dim=-1, keepdim=True).clamp_min(1e-9)
    turns = torch.round(angle / (2 * torch.pi)).detach()
    return vector * (1 - 2 * torch.pi * turns / angle)
