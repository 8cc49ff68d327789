"""Synthesise training pairs from 3D poses: random bodies seen by random cameras.

After appendix C of the paper (Lee et al., BMVC 2025), with what real detections need: perspective,
upright cameras, other bodies, other joint layouts. All of it is drawn anew for each batch; nothing
is stored.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from mocap_calib.training.config import HIDDEN_LIMBS, OUTLIER_NOISE, TRAINING_JOINTS, TrainConfig
from mocap_calib.training.draws import (
    Draws,
    class_of_joint,
    limbs,
    rotation_about_z,
    symmetry_classes,
    upright_views,
)
from mocap_calib.training.model import normalise
from mocap_calib.training.poses import PoseSet
from mocap_calib.types import Skeleton

_LEG = ("hip", "knee", "ankle")


@dataclass(frozen=True)
class Batch:
    """What the network sees and should say.

    pose: `[B, J, 2]` centred and scaled by `model.normalise`.
    seen: `[B, J]` bool.
    target: `[B, J, 3]` in the units of the pose, NaN for joints that the data lack.
    """

    pose: Tensor
    seen: Tensor
    target: Tensor

    def to(self, device: str) -> "Batch":
        """Return the batch on a device."""
        return Batch(self.pose.to(device), self.seen.to(device), self.target.to(device))


class Synthesiser:
    """A source of batches from a pose set."""

    def __init__(
        self, poses: PoseSet, skeleton: Skeleton, config: TrainConfig, *, seed: int
    ) -> None:
        self.poses = torch.from_numpy(poses.poses).float()
        self.weight = torch.from_numpy(poses.weight)
        self.skeleton = skeleton
        self.config = config
        self.draws = Draws(seed)
        self.classes = symmetry_classes(skeleton)
        self.class_of_joint = class_of_joint(self.classes)
        self.limbs = limbs(skeleton)

    def batch(self, size: int) -> Batch:
        """Return `size` new examples."""
        index = self.draws.weighted_index(self.weight, size)
        known = torch.isfinite(self.poses[index, :, 0])  # (B, J)
        body = self._vary_limbs(self._fill_missing(self.poses[index]))
        body = _unit_size(body, known)
        body = body + self.config.joint_spread * self.draws.normal(*body.shape)
        points = torch.einsum("bij,bkj->bki", self._views(size), body)  # (B, J, 3)
        distance = self.draws.log_uniform(self.config.distance, size, 1)
        depth = points[..., 2] + distance
        image = points[..., :2] / depth[..., None]
        seen = self._hide_joints(known)
        pose, centre, scale = self._detect(image, seen)
        target = _target(points, depth, seen, centre=centre, scale=scale)
        return Batch(pose, seen, torch.where(known[..., None], target, torch.nan))

    def _fill_missing(self, body: Tensor) -> Tensor:
        """Put joints of `[B, J, 3]` that the data lack where their nearest ancestor is.

        So limbs beyond them can be moved.
        """
        known = torch.isfinite(body[..., :1])
        centroid = torch.where(known, body, torch.nan).nanmean(1, keepdim=True)
        filled = torch.where(known, body, centroid)
        for parent, child in self.skeleton.edges:
            filled[:, child] = torch.where(known[:, child], filled[:, child], filled[:, parent])
        return filled

    def _vary_limbs(self, body: Tensor) -> Tensor:
        """Rescale every limb of `[B, J, 3]`, both sides alike, after straightening the knees."""
        if self.config.straighten:
            body = self._straighten_knees(body)
        normal = self.draws.normal(len(body), len(self.classes))
        stretch = torch.exp(self.config.length_spread * normal)  # (B, class)
        varied = body.clone()
        for parent, child in self.skeleton.edges:
            factor = stretch[:, self.class_of_joint[child], None]
            varied[:, child] = varied[:, parent] + factor * (body[:, child] - body[:, parent])
        return varied

    def _straighten_knees(self, body: Tensor) -> Tensor:
        """Move each knee a random part of the way to the line from hip to ankle.

        The knees of fitted skeletons are too bent.
        """
        straightened = body.clone()
        part = self.config.straighten * self.draws.uniform(len(body), 1)
        for hip, knee, ankle in self._legs():
            leg = body[:, ankle] - body[:, hip]
            thigh = body[:, knee] - body[:, hip]
            square = leg.square().sum(1, keepdim=True).clamp_min(1e-9)
            along = (thigh * leg).sum(1, keepdim=True) / square
            straight = body[:, hip] + along * leg
            straightened[:, knee] += part * (straight - body[:, knee])
        return straightened

    def _legs(self) -> list[list[int]]:
        """Return the indices of hip, knee and ankle of each side that the skeleton has."""
        index = {name: k for k, name in enumerate(self.skeleton.keypoints)}
        sides = [[f"{side}_{joint}" for joint in _LEG] for side in ("left", "right")]
        return [[index[name] for name in names] for names in sides if set(names) <= set(index)]

    def _views(self, size: int) -> Tensor:
        """Return cam_from_world `[B, 3, 3]` of nearly upright cameras that look at the body."""
        config = self.config
        azimuth = 2 * np.pi * self.draws.uniform(size)
        low, high = np.deg2rad(config.elevation_deg)
        even = self.draws.uniform(size)
        lowered = self.draws.uniform(size) ** config.elevation_skew
        elevation = low + (high - low) * even * lowered
        roll = np.deg2rad(config.roll_deg) * self.draws.normal(size)
        return rotation_about_z(roll) @ upright_views(azimuth, elevation)

    def _hide_joints(self, known: Tensor) -> Tensor:
        """Return which of the joints `[B, J]` that the data have are seen; at least four stay.

        Hidden are what another layout lacks (left and right go together), a limb of some bodies,
        and scattered joints.
        """
        size, joints = known.shape
        present = self._draw_layout(size)
        hidden_limb = self.limbs[self.draws.index(len(self.limbs), size)]
        hides_limb = self.draws.uniform(size, 1) < HIDDEN_LIMBS
        chance = self.draws.uniform(size, joints)
        occlusion = self.config.occlusion * self.draws.uniform(size, 1)
        seen = known & present & ~(hidden_limb & hides_limb) & (chance >= occlusion)
        too_few = seen.sum(1) < TRAINING_JOINTS
        seen[too_few] = known[too_few]
        return seen

    def _draw_layout(self, size: int) -> Tensor:
        """Return the joints `[B, J]` (bool) that a detector's layout has, for each example."""
        chance = self.draws.uniform(size, len(self.classes))
        absent = chance < self.config.joint_dropout * self.draws.uniform(size, 1)  # (B, class)
        return ~absent[:, self.class_of_joint]

    def _detect(self, image: Tensor, seen: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Add the detector's noise to image points `[B, J, 2]`, then centre and scale them.

        Returns the pose, the centre `[B, 2]` and the scale `[B]` of `model.normalise`.
        """
        _, _, radius = normalise(image, seen)
        noise = self.draws.log_uniform(self.config.noise, len(image), 1)
        outlier = self.draws.uniform(*seen.shape) < self.config.outliers
        noise = torch.where(outlier, torch.full_like(noise, OUTLIER_NOISE), noise)  # (B, J)
        deviation = (noise * radius[:, None])[..., None]
        return normalise(image + deviation * self.draws.normal(*image.shape), seen)


def _unit_size(body: Tensor, known: Tensor) -> Tensor:
    """Centre and scale bodies `[B, J, 3]` over the joints `[B, J]` that the data have."""
    share = (known / known.sum(1, keepdim=True))[..., None]
    centred = body - (share * body).sum(1, keepdim=True)
    radius = (share * centred.square()).sum((1, 2)).sqrt()
    return centred / radius[:, None, None]


def _target(
    points: Tensor, depth: Tensor, seen: Tensor, *, centre: Tensor, scale: Tensor
) -> Tensor:
    """Return what the network should say, `[B, J, 3]`, in the units of the detected pose.

    points: `[B, J, 3]` in the camera's axes about the body; depth: `[B, J]` from the camera;
    centre: `[B, 2]` and scale: `[B]` of the pose.
    """
    weight = seen.float()
    mean_depth = (depth * weight).sum(1, keepdim=True) / weight.sum(1, keepdim=True)  # (B, 1)
    projected = points[..., :2] / mean_depth[..., None]
    across = (projected - centre[:, None]) / scale[:, None, None]
    along = (depth - mean_depth) / (mean_depth * scale[:, None])
    return torch.cat([across, along[..., None]], dim=-1)
