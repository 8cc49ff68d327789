"""The factorised SteerPose: lift a 2D pose, rotate it analytically, project it.

Projection is linear in the 3D pose, so the minimiser of the squared keypoint error of SteerPose
(Lee et al., BMVC 2025, eq. 1) is q*(R) = P R E[X | p]: the posterior mean of the 3D pose X given
the 2D pose p, rotated by R and projected by P. The network therefore estimates X from p alone; it
is covariant to R by construction, and another R costs no network pass.
"""

import torch
from torch import Tensor, nn

from mocap_calib.lift.lifter import LOG_DEVIATIONS, Lifter, ModelConfig


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
        self.missing = nn.Parameter(0.02 * torch.randn(config.width))
        self.joint = nn.Parameter(0.5 * torch.randn(config.joints, config.width))
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


def lifter_of(module: LifterModule) -> Lifter:
    """Return what a module has learnt, without torch."""
    return Lifter(
        module.config, {name: each.cpu().numpy() for name, each in module.state_dict().items()}
    )


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
