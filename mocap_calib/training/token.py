"""The paper's SteerPose: a rotation token among joint tokens.

Lee et al., BMVC 2025, section 3.1 and appendix C. Kept as a measured reference; the factorised
model in `model.py` is the program's own.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from mocap_calib.config import ENCODER_HEADS, PAPER_LAYERS, PAPER_WIDTH
from mocap_calib.training.model import transformer_encoder


@dataclass(frozen=True)
class TokenConfig:
    """Size of the network; saved inside the checkpoint.

    The paper does not give the number of heads and the width of the feed-forward layers.
    """

    joints: int
    width: int = PAPER_WIDTH
    layers: int = PAPER_LAYERS
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
        self.missing = nn.Parameter(0.02 * torch.randn(width))
        self.embedding = nn.Parameter(0.5 * torch.randn(config.joints + 1, width))
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
