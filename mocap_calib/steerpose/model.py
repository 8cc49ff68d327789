"""The factorised SteerPose: lift a 2D pose, rotate it analytically, project it.

Projection is linear in the 3D pose, so the minimiser of the squared keypoint error of SteerPose (Lee et al.,
BMVC 2025, eq. 1) is q*(R) = P R E[X | p]: the posterior mean 3D pose, rotated. The network therefore gives X
from p alone; it is covariant to R by construction and R costs no network pass.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn


@dataclass(frozen=True)
class ModelConfig:
    """Size of the network; saved inside the checkpoint."""

    joints: int
    width: int = 64
    layers: int = 4
    heads: int = 4


class Lifter(nn.Module):
    """2D pose in a virtual camera that looks at the body -> 3D pose in that camera's axes, with its uncertainty.

    One token per joint (a projection of its position, or a learnt vector where it is missing, plus a learnt
    embedding of which joint it is), a transformer encoder, one head per token.
    """

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self.position = nn.Linear(2, config.width)
        self.missing = nn.Parameter(0.02 * torch.randn(config.width))
        self.joint = nn.Parameter(0.5 * torch.randn(config.joints, config.width))
        layer = nn.TransformerEncoderLayer(
            config.width,
            config.heads,
            2 * config.width,
            dropout=0.0,
            activation="gelu",
            batch_first=True,
            norm_first=True,
        )
        self.encoder = nn.TransformerEncoder(
            layer, config.layers, norm=nn.LayerNorm(config.width), enable_nested_tensor=False
        )
        self.head = nn.Linear(config.width, 5)

    def forward(self, pose: Tensor, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Lifts a batch of poses.

        pose: `[B, J, 2]` positions, centred and scaled by `normalise`; seen: `[B, J]` bool.
        Returns `[B, J, 3]` joints in the same units (x right, y down, z away from the camera) and `[B, J, 2]`
        log standard deviations: across the ray, and along it.
        """
        known = torch.where(seen[..., None], pose, torch.zeros_like(pose))
        token = (
            torch.where(seen[..., None], self.position(known), self.missing) + self.joint
        )  # (B, J, C)
        out = self.head(self.encoder(token))  # (B, J, 5)
        joints = torch.cat([known + out[..., :2], out[..., 2:3]], dim=-1)
        return joints, out[..., 3:].clamp(-6.0, 3.0)


def normalise(pose: Tensor, seen: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Centres poses on their visible joints and scales those to an RMS radius of 1.

    pose: `[B, J, 2]`, seen: `[B, J]`. Returns the pose, the centre `[B, 2]` and the scale `[B]`.
    """
    weight = seen.to(pose.dtype)[..., None]
    count = weight.sum(1).clamp_min(1.0)
    known = torch.where(seen[..., None], pose, torch.zeros_like(pose))
    centre = known.sum(1) / count
    offset = (known - centre[:, None]) * weight
    scale = (offset.square().sum((1, 2)) / count[:, 0]).sqrt().clamp_min(1e-9)
    return offset / scale[:, None, None], centre, scale
