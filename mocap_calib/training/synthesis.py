"""Synthesise training data from 3D poses: random bodies seen by random cameras.

After appendix C of the paper (Lee et al., BMVC 2025): `PairSynthesiser` as it is, two orthographic
views of one pose and the rotation between them; `Synthesiser` with what real detections need:
perspective, upright cameras, other bodies, other joint layouts. All of it is drawn anew for each
batch; nothing is stored.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from mocap_calib.config import LEAST_JOINTS
from mocap_calib.geometry.rotation import looking_along, vector_from_matrix
from mocap_calib.synthetic.signals import turn_about
from mocap_calib.training import HIDDEN_LIMBS, OUTLIER_NOISE, PairsConfig, TrainConfig
from mocap_calib.training.model import normalise
from mocap_calib.training.poses import PoseSet, Split, every_tenth
from mocap_calib.types import Floats, Skeleton

_LEG = ("hip", "knee", "ankle")
_DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True)
class Batch:
    """Input and target of a lifter.

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


@dataclass(frozen=True)
class SteerBatch:
    """Input and target of the paper's network.

    pose: `[B, J, 2]` in the first view, centred and scaled by `model.normalise`.
    seen: `[B, J]` bool.
    vector: `[B, 3]` Rodrigues vector, in radians, of second_from_first.
    target: `[B, J, 2]` the pose in the second view, in the units of the first.
    """

    pose: Tensor
    seen: Tensor
    vector: Tensor
    target: Tensor


class _Source:
    """Random draws of poses and joints; the same seed gives the same ones in the same order."""

    def __init__(self, poses: PoseSet, skeleton: Skeleton, seed: int) -> None:
        self.poses = torch.from_numpy(poses.poses).float()
        self.weight = torch.from_numpy(poses.weight)
        self.skeleton = skeleton
        self.generator = torch.Generator().manual_seed(seed)
        # joints that a layout has or lacks together: pairs of left and right, and single joints
        paired = {joint for pair in skeleton.symmetries for joint in pair}
        single = [(joint,) for joint in range(len(skeleton.keypoints)) if joint not in paired]
        self.classes = [*skeleton.symmetries, *single]
        self.class_of_joint = torch.empty(len(skeleton.keypoints), dtype=torch.long)
        for k, joints in enumerate(self.classes):
            self.class_of_joint[list(joints)] = k

    def uniform(self, *shape: int) -> Tensor:
        """Return uniform numbers `[shape]` in 0..1."""
        return torch.rand(*shape, generator=self.generator)

    def normal(self, *shape: int) -> Tensor:
        """Return normal numbers `[shape]` with variance 1."""
        return torch.randn(*shape, generator=self.generator)

    def log_uniform(self, bounds: tuple[float, float], *shape: int) -> Tensor:
        """Return numbers `[shape]` within the bounds whose logarithms are uniform."""
        low, high = np.log(bounds[0]), np.log(bounds[1])
        return torch.exp(self.uniform(*shape) * (high - low) + low)

    def draw_poses(self, size: int) -> Tensor:
        """Return poses `[size, J, 3]`, drawn with replacement by their weights."""
        return self.poses[
            torch.multinomial(self.weight, size, replacement=True, generator=self.generator)
        ]

    def draw_absent(self, size: int, dropout: float) -> Tensor:
        """Return the joints `[size, J]` (bool) that a detector's layout lacks, for each example.

        dropout: the largest share of the joints.
        """
        chance = self.uniform(size, len(self.classes))
        absent = chance < dropout * self.uniform(size, 1)  # (B, class)
        return absent[:, self.class_of_joint]

    def detect(self, image: Tensor, seen: Tensor, noise: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Add a detector's noise to image points `[B, J, 2]`, then centre and scale them.

        noise: `[B | 1, J | 1]` standard deviation, of the visible pose's RMS radius.

        Returns the pose, the centre `[B, 2]` and the scale `[B]` of `model.normalise`.
        """
        _, _, radius = normalise(image, seen)
        deviation = (noise * radius[:, None])[..., None]
        return normalise(image + deviation * self.normal(*image.shape), seen)


class Synthesiser(_Source):
    """A source of batches for a lifter from a pose set."""

    def __init__(
        self, poses: PoseSet, skeleton: Skeleton, config: TrainConfig, *, seed: int
    ) -> None:
        super().__init__(poses, skeleton, seed)
        self.config = config
        # `[edge, J]` the joints at and beyond the child of each edge
        self.limbs = torch.eye(len(skeleton.keypoints), dtype=torch.bool)[
            [child for _, child in skeleton.edges]
        ]
        for parent, child in skeleton.edges:
            self.limbs[:, child] |= self.limbs[:, parent]

    def batch(self, size: int) -> Batch:
        """Return `size` new examples."""
        poses = self.draw_poses(size)
        known = torch.isfinite(poses[..., 0])  # (B, J)
        body = self._vary_limbs(self._fill_missing(poses))
        body = _unit_size(body, known)
        body = body + self.config.joint_spread * self.normal(*body.shape)
        points = torch.einsum("bij,bkj->bki", self._views(size), body)  # (B, J, 3)
        distance = self.log_uniform(self.config.distance, size, 1)
        depth = points[..., 2] + distance
        image = points[..., :2] / depth[..., None]
        seen = self._hide_joints(known)
        noise = self.log_uniform(self.config.noise, size, 1)
        outlier = self.uniform(*seen.shape) < self.config.outliers
        noise = torch.where(outlier, OUTLIER_NOISE, noise)  # (B, J)
        pose, centre, scale = self.detect(image, seen, noise)
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
        normal = self.normal(len(body), len(self.classes))
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
        part = self.config.straighten * self.uniform(len(body), 1)
        index = {name: k for k, name in enumerate(self.skeleton.keypoints)}
        for names in ([f"{side}_{joint}" for joint in _LEG] for side in ("left", "right")):
            if not set(names) <= set(index):
                continue
            hip, knee, ankle = (index[name] for name in names)
            leg = body[:, ankle] - body[:, hip]
            thigh = body[:, knee] - body[:, hip]
            square = leg.square().sum(1, keepdim=True).clamp_min(1e-9)
            along = (thigh * leg).sum(1, keepdim=True) / square
            straight = body[:, hip] + along * leg
            straightened[:, knee] += part * (straight - body[:, knee])
        return straightened

    def _views(self, size: int) -> Tensor:
        """Return cam_from_world `[B, 3, 3]` of nearly upright cameras that look at the body."""
        config = self.config
        azimuth = 2 * np.pi * self.uniform(size).numpy()
        low, high = np.deg2rad(config.elevation_deg)
        even = self.uniform(size).numpy()
        lowered = self.uniform(size).numpy() ** config.elevation_skew
        elevation = low + (high - low) * even * lowered
        roll = np.deg2rad(config.roll_deg) * self.normal(size).numpy()
        across = np.cos(elevation)
        centre = [across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)]
        upright = looking_along(-np.stack(centre, axis=-1), _DOWN)
        return torch.from_numpy(turn_about(roll) @ upright).float()

    def _hide_joints(self, known: Tensor) -> Tensor:
        """Return which of the joints `[B, J]` that the data have are seen; at least four stay.

        Hidden are joints that another layout lacks, a limb of some bodies, and scattered joints.
        """
        size, joints = known.shape
        absent = self.draw_absent(size, self.config.joint_dropout)
        hidden_limb = self.limbs[torch.randint(len(self.limbs), (size,), generator=self.generator)]
        hides_limb = self.uniform(size, 1) < HIDDEN_LIMBS
        chance = self.uniform(size, joints)
        occlusion = self.config.occlusion * self.uniform(size, 1)
        seen = known & ~absent & ~(hidden_limb & hides_limb) & (chance >= occlusion)
        too_few = seen.sum(1) < LEAST_JOINTS
        seen[too_few] = known[too_few]
        return seen


def _unit_size(body: Tensor, known: Tensor) -> Tensor:
    """Centre and scale bodies `[B, J, 3]` over the joints `[B, J]` that the data have."""
    share = (known / known.sum(1, keepdim=True))[..., None]
    centred = body - (share * body).sum(1, keepdim=True)
    radius = (share * centred.square()).sum((1, 2)).sqrt()
    return centred / radius[:, None, None]


def _target(
    points: Tensor, depth: Tensor, seen: Tensor, *, centre: Tensor, scale: Tensor
) -> Tensor:
    """Return the target `[B, J, 3]` of a lifter, in the units of the detected pose.

    points: `[B, J, 3]` in the camera's axes about the body; depth: `[B, J]` from the camera;
    centre: `[B, 2]` and scale: `[B]` of the pose.
    """
    weight = seen.float()
    mean_depth = (depth * weight).sum(1, keepdim=True) / weight.sum(1, keepdim=True)  # (B, 1)
    projected = points[..., :2] / mean_depth[..., None]
    across = (projected - centre[:, None]) / scale[:, None, None]
    along = (depth - mean_depth) / (mean_depth * scale[:, None])
    return torch.cat([across, along[..., None]], dim=-1)


class PairSynthesiser(_Source):
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
        super().__init__(poses, skeleton, seed)
        self.config = config
        views = hemisphere_views(config.cameras, config.rolls)
        drawn = np.random.default_rng(config.seed).integers(len(views), size=(config.pairs, 2))
        pairs = drawn[every_tenth(len(drawn), split)]
        first, second = views[pairs[:, 0]], views[pairs[:, 1]]
        second_from_first = second @ np.swapaxes(first, 1, 2)
        self.first = torch.from_numpy(first).float()
        self.rotation = torch.from_numpy(second_from_first).float()
        self.vector = torch.from_numpy(vector_from_matrix(second_from_first)).float()

    def batch(self, size: int) -> SteerBatch:
        """Return `size` new examples, in units of the visible RMS radius of the first view."""
        poses = self.draw_poses(size)
        pair = torch.randint(len(self.vector), (size,), generator=self.generator)
        # the headings of the clips themselves are few
        heading = torch.from_numpy(turn_about(2 * np.pi * self.uniform(size).numpy())).float()
        points = torch.einsum("bij,bkj->bki", self.first[pair] @ heading, poses)
        seen = self._hide_joints(*points.shape[:2])
        noise = torch.full((1, 1), self.config.noise)
        pose, centre, scale = self.detect(points[..., :2], seen, noise)
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
        share = low + (high - low) * self.uniform(size, 1)
        rank = self.uniform(size, joints).argsort(1).argsort(1)
        seen = rank >= (share * joints).round()
        absent = self.draw_absent(size, TrainConfig.joint_dropout)
        seen &= ~(absent & (self.uniform(size, 1) < self.config.layouts))
        seen[seen.sum(1) < LEAST_JOINTS] = True
        return seen


def hemisphere_views(cameras: int, rolls: int) -> Floats:
    """Return cam_from_world `[cameras * rolls, 3, 3]` of cameras on the hemisphere (appendix C).

    All look at the origin and are rolled evenly about their axes. Each has the same area of the
    hemisphere: heights are evenly spaced (Archimedes: equal bands have equal areas), azimuths
    advance by the golden angle (Gonzalez 2010).
    """
    k = np.arange(cameras)
    height = (k + 0.5) / cameras
    azimuth = np.pi * (3 - np.sqrt(5)) * k
    across = np.sqrt(1 - height**2)
    centre = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), height], axis=-1)
    turn = turn_about(2 * np.pi * np.arange(rolls) / rolls)
    return (turn[None] @ looking_along(-centre, _DOWN)[:, None]).reshape(-1, 3, 3)
