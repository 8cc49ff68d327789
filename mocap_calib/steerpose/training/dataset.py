"""Training pairs synthesised from 3D poses: random bodies seen by random cameras.

After appendix C of the paper, with what real detections need: perspective, upright cameras, other bodies, other
joint layouts. All of it is drawn anew for each batch; nothing is stored.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from mocap_calib.config import TrainConfig
from mocap_calib.steerpose.model import normalise
from mocap_calib.steerpose.training.poses import PoseSet
from mocap_calib.types import Skeleton


@dataclass(frozen=True)
class Batch:
    """What the network sees and should say. pose: `[B, J, 2]`, seen: `[B, J]`, target: `[B, J, 3]`, NaN for joints that the data lack."""

    pose: Tensor
    seen: Tensor
    target: Tensor


class Synthesiser:
    """Draws batches from a pose set."""

    def __init__(self, poses: PoseSet, skeleton: Skeleton, config: TrainConfig, seed: int) -> None:
        self.poses = torch.from_numpy(poses.poses).float()
        self.weight = torch.from_numpy(poses.weight)
        self.skeleton = skeleton
        self.config = config
        self.generator = torch.Generator().manual_seed(seed)
        self.pairs = _symmetry_classes(skeleton)
        self.below = _subtrees(skeleton)

    def batch(self, size: int) -> Batch:
        """`size` new examples."""
        config = self.config
        index = torch.multinomial(self.weight, size, replacement=True, generator=self.generator)
        known = torch.isfinite(self.poses[index, :, 0])
        body = self._other_bodies(self._filled(self.poses[index]))
        share = (known / known.sum(1, keepdim=True))[..., None]
        centred = body - (share * body).sum(1, keepdim=True)
        centred = centred / (share * centred.square()).sum((1, 2)).sqrt()[:, None, None]
        body = centred + config.joint_spread * self._normal(centred.shape)
        camera = torch.einsum("bij,bkj->bki", self._views(size), body)
        low, high = np.log(config.distance[0]), np.log(config.distance[1])
        depth = camera[..., 2] + torch.exp(self._uniform(size, 1) * (high - low) + low)
        image = camera[..., :2] / depth[..., None]
        seen = self._seen(known)
        batch = self._normalised(image, camera, depth, seen)
        return Batch(batch.pose, seen, torch.where(known[..., None], batch.target, torch.nan))

    def _filled(self, body: Tensor) -> Tensor:
        """Puts joints that the data lack where their nearest ancestor is, so that limbs beyond them can be moved."""
        known = torch.isfinite(body[..., :1])
        here = torch.where(known, body, torch.nan)
        out = torch.where(known, body, here.nanmean(1, keepdim=True))
        for parent, child in self.skeleton.edges:
            out[:, child] = torch.where(known[:, child], out[:, child], out[:, parent])
        return out

    def _normalised(self, image: Tensor, camera: Tensor, depth: Tensor, seen: Tensor) -> Batch:
        """Adds the detector's noise, then centres and scales input and target alike."""
        config = self.config
        _, _, radius = normalise(image, seen)
        low, high = np.log(config.noise[0]), np.log(config.noise[1])
        noise = torch.exp(self._uniform(len(image), 1) * (high - low) + low)
        noise = torch.where(
            self._uniform(*seen.shape) < config.outliers, torch.full_like(noise, 0.5), noise
        )
        pose, centre, scale = normalise(
            image + (noise * radius[:, None])[..., None] * self._normal(image.shape), seen
        )
        weight = seen.float()
        middle = (depth * weight).sum(1, keepdim=True) / weight.sum(1, keepdim=True)
        across = (camera[..., :2] / middle[..., None] - centre[:, None]) / scale[:, None, None]
        along = (depth - middle) / (middle * scale[:, None])
        return Batch(pose, seen, torch.cat([across, along[..., None]], dim=-1))

    def _other_bodies(self, body: Tensor) -> Tensor:
        """Rescales every limb, both sides alike; the knees of fitted skeletons are straightened at random."""
        size, config = len(body), self.config
        body = self._straighten(body) if config.straighten else body
        stretch = torch.exp(config.length_spread * self._normal((size, len(self.pairs))))
        joint_class = torch.empty(body.shape[1], dtype=torch.long)
        for k, members in enumerate(self.pairs):
            joint_class[list(members)] = k
        out = body.clone()
        for parent, child in self.skeleton.edges:
            out[:, child] = out[:, parent] + stretch[:, joint_class[child], None] * (
                body[:, child] - body[:, parent]
            )
        return out

    def _straighten(self, body: Tensor) -> Tensor:
        """Moves each middle joint of a chain of three a random part of the way to the straight line."""
        names = {name: k for k, name in enumerate(self.skeleton.keypoints)}
        legs = [
            [f"{side}_{joint}" for joint in ("hip", "knee", "ankle")] for side in ("left", "right")
        ]
        chains = [[names[joint] for joint in leg] for leg in legs if set(leg) <= set(names)]
        out, part = body.clone(), self.config.straighten * self._uniform(len(body), 1)
        for above, middle, under in chains:
            bone = body[:, under] - body[:, above]
            along = ((body[:, middle] - body[:, above]) * bone).sum(
                1, keepdim=True
            ) / bone.square().sum(1, keepdim=True).clamp_min(1e-9)
            out[:, middle] += part * (body[:, above] + along * bone - body[:, middle])
        return out

    def _views(self, size: int) -> Tensor:
        """`[B, 3, 3]` cam_from_world of cameras that look at the body: x right, y down, z forward."""
        config = self.config
        azimuth = 2 * np.pi * self._uniform(size)
        low, high = np.deg2rad(config.elevation_deg)
        elevation = (
            low + (high - low) * self._uniform(size) * self._uniform(size) ** config.elevation_skew
        )
        forward = torch.stack(
            [-elevation.cos() * azimuth.cos(), -elevation.cos() * azimuth.sin(), -elevation.sin()],
            1,
        )
        up = torch.tensor([0.0, 0.0, 1.0]).expand_as(forward)
        right = torch.nn.functional.normalize(torch.cross(forward, up, dim=1), dim=1)
        upright = torch.stack([right, torch.cross(forward, right, dim=1), forward], 1)
        roll = np.deg2rad(config.roll_deg) * self._normal((size,))
        zero, one = torch.zeros_like(roll), torch.ones_like(roll)
        turn = torch.stack(
            [roll.cos(), -roll.sin(), zero, roll.sin(), roll.cos(), zero, zero, zero, one], 1
        ).view(-1, 3, 3)
        return turn @ upright

    def _seen(self, known: Tensor) -> Tensor:
        """`[B, J]` another layout (left and right go together), a hidden limb, scattered misses; at least four stay."""
        config, (size, joints) = self.config, known.shape
        absent = self._uniform(size, len(self.pairs)) < config.joint_dropout * self._uniform(
            size, 1
        )
        seen = known.clone()
        for k, members in enumerate(self.pairs):
            seen[:, list(members)] &= ~absent[:, k, None]
        limb = torch.randint(len(self.below), (size,), generator=self.generator)
        seen &= ~(self.below[limb] & (self._uniform(size, 1) < 0.2))
        seen &= self._uniform(size, joints) >= config.occlusion * self._uniform(size, 1)
        lost = seen.sum(1) < 4
        seen[lost] = known[lost]
        return seen

    def _uniform(self, *shape: int) -> Tensor:
        return torch.rand(*shape, generator=self.generator)

    def _normal(self, shape: tuple[int, ...] | torch.Size) -> Tensor:
        return torch.randn(shape, generator=self.generator)


def _symmetry_classes(skeleton: Skeleton) -> list[tuple[int, ...]]:
    """Joints that a layout has together: left and right twins, and each other joint by itself."""
    paired = {k for pair in skeleton.symmetries for k in pair}
    return [
        *skeleton.symmetries,
        *((k,) for k in range(len(skeleton.keypoints)) if k not in paired),
    ]


def _subtrees(skeleton: Skeleton) -> Tensor:
    """`[edge, J]` the joints at and beyond each edge's child."""
    below = torch.zeros(len(skeleton.edges), len(skeleton.keypoints), dtype=torch.bool)
    for row, (_, root) in enumerate(skeleton.edges):
        below[row, root] = True
        for parent, child in skeleton.edges:
            below[row, child] |= below[row, parent]
    return below
