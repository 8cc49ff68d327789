"""Mental rotation for both architectures: from a 2D pose and a rotation to the pose in that view.

`matrix_from_vector` and `skew` do in torch what `geometry.rotation` does in numpy: the paper's
solver needs gradients, and geometry must not import torch.
"""

from collections.abc import Callable
from typing import Literal

import torch
from torch import Tensor

from mocap_calib.training.model import LifterModule
from mocap_calib.training.token import TokenSteerer

Architecture = Literal["token", "factorised"]
Model = LifterModule | TokenSteerer


def steer(model: Model, pose: Tensor, seen: Tensor, vector: Tensor) -> Tensor:
    """Return q(R) of the paper (section 3.1): the poses `[B, J, 2]` in the rotated views.

    pose: `[B, J, 2]` centred and scaled by `model.normalise`; seen: `[B, J]` bool; vector: `[B, 3]`
    Rodrigues vectors in radians. The result is in the units of the input, and complete: joints
    that are not seen are predicted. A vector of zeros completes the pose in its own view.
    """
    return prepare_steering(model, pose, seen)(vector)


@torch.no_grad()
def complete(model: Model, pose: Tensor, seen: Tensor) -> Tensor:
    """Return poses `[B, J, 2]` with the joints that are not seen where the network expects them.

    By no rotation: appendix D of the paper. pose: `[B, J, 2]` centred and scaled by
    `model.normalise`; seen: `[B, J]` bool.
    """
    no_rotation = torch.zeros(len(pose), 3, dtype=pose.dtype, device=pose.device)
    predicted = steer(model, pose, seen, no_rotation)  # (B, J, 2)
    return torch.where(seen[..., None], pose, predicted)


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
