"""Training pairs of the paper: two orthographic views of one pose, and the rotation between them.

Lee et al., BMVC 2025, appendix C.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from mocap_calib.geometry.rotation import vector_from_matrix
from mocap_calib.training.config import LAYOUT_DROPOUT, TRAINING_JOINTS, PairsConfig
from mocap_calib.training.draws import (
    Draws,
    class_of_joint,
    hemisphere_views,
    rotation_about_z,
    symmetry_classes,
)
from mocap_calib.training.model import normalise
from mocap_calib.training.poses import PoseSet, Split
from mocap_calib.types import Ints, Skeleton


@dataclass(frozen=True)
class SteerBatch:
    """What the network sees and should say.

    pose: `[B, J, 2]` in the first view, centred and scaled by `model.normalise`.
    seen: `[B, J]` bool.
    vector: `[B, 3]` Rodrigues vector, in radians, of second_from_first.
    target: `[B, J, 2]` the pose in the second view, in the units of the first.
    """

    pose: Tensor
    seen: Tensor
    vector: Tensor
    target: Tensor


class PairSynthesiser:
    """A source of batches: poses turned about the vertical, seen by camera pairs of a split."""

    def __init__(
        self,
        poses: PoseSet,
        skeleton: Skeleton,
        config: PairsConfig,
        *,
        split: Split,
        seed: int,
    ) -> None:
        views = hemisphere_views(config.cameras, config.rolls)
        pairs = _pairs_of_views(len(views), config, split)
        first, second = views[pairs[:, 0]], views[pairs[:, 1]]
        second_from_first = second @ np.swapaxes(first, 1, 2)
        self.first = torch.from_numpy(first).float()
        self.rotation = torch.from_numpy(second_from_first).float()
        self.vector = torch.from_numpy(vector_from_matrix(second_from_first)).float()
        self.poses = torch.from_numpy(poses.poses).float()
        self.weight = torch.from_numpy(poses.weight)
        self.classes = symmetry_classes(skeleton)
        self.class_of_joint = class_of_joint(self.classes)
        self.config = config
        self.draws = Draws(seed)

    def batch(self, size: int) -> SteerBatch:
        """Return `size` new examples, in units of the visible RMS radius of the first view."""
        index = self.draws.weighted_index(self.weight, size)
        pair = self.draws.index(len(self.vector), size)
        # the headings of the clips themselves are few
        heading = rotation_about_z(2 * torch.pi * self.draws.uniform(size))
        points = torch.einsum("bij,bkj->bki", self.first[pair] @ heading, self.poses[index])
        seen = self._hide_joints(*points.shape[:2])
        pose, centre, scale = self._detect(points[..., :2], seen)
        depth = (points[..., 2] * seen).sum(1) / seen.sum(1)
        middle = torch.cat([centre, depth[:, None]], dim=1)  # (B, 3)
        body = (points - middle[:, None]) / scale[:, None, None]  # (B, J, 3)
        target = torch.einsum("bij,bkj->bki", self.rotation[pair][:, :2], body)  # (B, J, 2)
        return SteerBatch(pose, seen, self.vector[pair], target)

    def _hide_joints(self, size: int, joints: int) -> Tensor:
        """Return which joints `[B, J]` are seen: 10-30 % are masked; at least four stay.

        Of some poses all joints that another layout lacks are hidden besides.
        """
        low, high = self.config.masked
        share = low + (high - low) * self.draws.uniform(size, 1)
        rank = self.draws.uniform(size, joints).argsort(1).argsort(1)
        seen = rank >= (share * joints).round()
        chance = self.draws.uniform(size, len(self.classes))
        absent = chance < LAYOUT_DROPOUT * self.draws.uniform(size, 1)
        absent &= self.draws.uniform(size, 1) < self.config.layouts
        seen &= ~absent[:, self.class_of_joint]
        seen[seen.sum(1) < TRAINING_JOINTS] = True
        return seen

    def _detect(self, image: Tensor, seen: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Add the detector's noise to image points `[B, J, 2]`, then centre and scale them.

        Returns the pose, the centre `[B, 2]` and the scale `[B]` of `model.normalise`.
        """
        _, _, radius = normalise(image, seen)
        deviation = self.config.noise * radius[:, None, None]
        return normalise(image + deviation * self.draws.normal(*image.shape), seen)


def _pairs_of_views(views: int, config: PairsConfig, split: Split) -> Ints:
    """Return the pairs `[pair, 2]` of views (indices) of a split, 7:2:1."""
    pairs = np.random.default_rng(config.seed).integers(views, size=(config.pairs, 2))
    tenth = config.pairs // 10
    parts = {
        "train": slice(0, 7 * tenth),
        "val": slice(7 * tenth, 9 * tenth),
        "test": slice(9 * tenth, None),
    }
    return pairs[parts[split]]
