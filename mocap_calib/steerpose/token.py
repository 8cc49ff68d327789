"""The paper's SteerPose: a rotation token among joint tokens (Lee et al., BMVC 2025, section 3.1 and appendix C).

Kept as a measured reference; the factorised model in `model.py` is the program's own.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn


@dataclass(frozen=True)
class TokenConfig:
    """Size of the network; saved inside the checkpoint. Heads and the feed-forward width are not in the paper."""

    joints: int
    width: int = 32
    layers: int = 5
    heads: int = 4


class TokenSteerer(nn.Module):
    """2D pose + relative rotation -> 2D pose in the rotated view: q(R) of the paper.

    N joint tokens and one rotation token, each through an MLP, plus a learnable positional embedding of N + 1; a
    transformer encoder; mean pooling to one vector; an MLP to N x 2. The token of a joint that is not seen is masked: a
    learnt vector stands for it.
    """

    def __init__(self, config: TokenConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.position = _mlp(2, width, width)
        self.rotation = _mlp(3, width, width)
        self.missing = nn.Parameter(0.02 * torch.randn(width))
        self.embedding = nn.Parameter(0.5 * torch.randn(config.joints + 1, width))
        layer = nn.TransformerEncoderLayer(
            width,
            config.heads,
            2 * width,
            dropout=0.0,
            activation="gelu",
            batch_first=True,
            norm_first=True,
        )
        self.encoder = nn.TransformerEncoder(
            layer, config.layers, norm=nn.LayerNorm(width), enable_nested_tensor=False
        )
        self.head = _mlp(width, 4 * width, 2 * config.joints)

    def forward(self, pose: Tensor, seen: Tensor, vector: Tensor) -> Tensor:
        """Steers a batch of poses.

        pose: `[B, J, 2]` centred and scaled by `model.normalise`; seen: `[B, J]` bool; vector: `[B, 3]` Rodrigues vector
        of the rotation from the pose's view to the other, radians. Returns `[B, J, 2]` in units of the input.
        """
        known = torch.where(seen[..., None], pose, torch.zeros_like(pose))
        joints = torch.where(seen[..., None], self.position(known), self.missing)
        token = (
            torch.cat([joints, self.rotation(vector)[:, None]], dim=1) + self.embedding
        )  # (B, J + 1, C)
        return self.head(self.encoder(token).mean(1)).view(len(pose), -1, 2)


def _mlp(inside: int, hidden: int, outside: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inside, hidden), nn.GELU(), nn.Linear(hidden, outside))
