"""Training pairs of the paper: two orthographic views of one pose, and the rotation between them (appendix C)."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from mocap_calib.config import PairsConfig
from mocap_calib.geometry.rotation import looking_along, matrix_from_vector, vector_from_matrix
from mocap_calib.steerpose.model import normalise
from mocap_calib.steerpose.training.dataset import _symmetry_classes
from mocap_calib.steerpose.training.poses import PoseSet, Split
from mocap_calib.types import Floats, Skeleton

_DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True)
class SteerBatch:
    """What the network sees and should say. pose: `[B, J, 2]`, seen: `[B, J]`, vector: `[B, 3]`, target: `[B, J, 2]`."""

    pose: Tensor
    seen: Tensor
    vector: Tensor
    target: Tensor


def fibonacci_hemisphere(count: int) -> Floats:
    """`[count, 3]` unit vectors with z > 0, each with the same area of the hemisphere to itself.

    The heights are evenly spaced (Archimedes: equal bands have equal areas), the azimuths advance by the golden angle.
    """
    k = np.arange(count)
    height = (k + 0.5) / count
    azimuth = np.pi * (3 - np.sqrt(5)) * k
    out = np.sqrt(1 - height**2)
    return np.stack([out * np.cos(azimuth), out * np.sin(azimuth), height], axis=-1)


def hemisphere_views(cameras: int, rolls: int) -> Floats:
    """`[cameras * rolls, 3, 3]` cam_from_world of cameras on the hemisphere that look at the origin, rolled evenly."""
    upright = looking_along(-fibonacci_hemisphere(cameras), _DOWN)
    roll = 2 * np.pi * np.arange(rolls) / rolls
    turn = matrix_from_vector(roll[:, None] * np.array([0.0, 0.0, 1.0]))
    return (turn[None] @ upright[:, None]).reshape(-1, 3, 3)


class PairSynthesiser:
    """Draws batches: a pose of the set and one of the camera pairs of the split, turned about the vertical at random."""

    def __init__(
        self, poses: PoseSet, skeleton: Skeleton, config: PairsConfig, split: Split, seed: int
    ) -> None:
        views = hemisphere_views(config.cameras, config.rolls)
        pairs = np.random.default_rng(config.seed).integers(len(views), size=(config.pairs, 2))
        tenth = config.pairs // 10
        part = {
            "train": pairs[: 7 * tenth],
            "val": pairs[7 * tenth : 9 * tenth],
            "test": pairs[9 * tenth :],
        }[split]
        first, second = views[part[:, 0]], views[part[:, 1]]
        self.first = torch.from_numpy(first).float()
        self.rotation = torch.from_numpy(second @ np.swapaxes(first, 1, 2)).float()
        self.vector = torch.from_numpy(
            vector_from_matrix(second @ np.swapaxes(first, 1, 2))
        ).float()
        self.poses = torch.from_numpy(poses.poses).float()
        self.weight = torch.from_numpy(poses.weight)
        self.classes = _symmetry_classes(skeleton)
        self.config = config
        self.generator = torch.Generator().manual_seed(seed)

    def batch(self, size: int) -> SteerBatch:
        """`size` new examples; poses in units of the visible RMS radius of the first view."""
        index = torch.multinomial(self.weight, size, replacement=True, generator=self.generator)
        pair = torch.randint(len(self.vector), (size,), generator=self.generator)
        camera = torch.einsum(
            "bij,bkj->bki", self.first[pair] @ self._heading(size), self.poses[index]
        )
        seen = self._seen(size, camera.shape[1])
        _, _, radius = normalise(camera[..., :2], seen)
        noise = (
            self.config.noise
            * radius[:, None, None]
            * torch.randn(*camera.shape[:2], 2, generator=self.generator)
        )
        pose, centre, scale = normalise(camera[..., :2] + noise, seen)
        depth = (camera[..., 2] * seen).sum(1) / seen.sum(1)
        middle = torch.cat([centre, depth[:, None]], dim=1)
        body = (camera - middle[:, None]) / scale[:, None, None]
        target = torch.einsum("bij,bkj->bki", self.rotation[pair][:, :2], body)
        return SteerBatch(pose, seen, self.vector[pair], target)

    def _heading(self, size: int) -> Tensor:
        """`[B, 3, 3]` turns about the vertical: the clips' own headings are few."""
        angle = 2 * torch.pi * torch.rand(size, generator=self.generator)
        zero, one = torch.zeros_like(angle), torch.ones_like(angle)
        return torch.stack(
            [angle.cos(), -angle.sin(), zero, angle.sin(), angle.cos(), zero, zero, zero, one], 1
        ).view(-1, 3, 3)

    def _seen(self, size: int, joints: int) -> Tensor:
        """`[B, J]` 10-30 % of the joints masked; of some poses all that another layout of joints lacks besides; four stay."""
        low, high = self.config.masked
        share = low + (high - low) * self._uniform(size, 1)
        order = self._uniform(size, joints).argsort(1).argsort(1)
        seen = order >= (share * joints).round()
        absent = self._uniform(size, len(self.classes)) < 0.6 * self._uniform(size, 1)
        absent &= self._uniform(size, 1) < self.config.layouts
        for k, members in enumerate(self.classes):
            seen[:, list(members)] &= ~absent[:, k, None]
        seen[seen.sum(1) < 4] = True
        return seen

    def _uniform(self, *shape: int) -> Tensor:
        return torch.rand(*shape, generator=self.generator)
