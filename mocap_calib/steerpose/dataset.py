"""Training pairs synthesised from 3D poses: random bodies seen by random cameras.

After appendix C of the paper, with what real detections need: perspective, upright cameras, other bodies, other
joint layouts. All of it is drawn anew for each batch; nothing is stored.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from mocap_calib.config import TrainConfig
from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.skeleton import match_names
from mocap_calib.steerpose.model import normalise
from mocap_calib.types import Bools, Floats, Skeleton

Split = Literal["train", "val", "test"]


@dataclass(frozen=True)
class PoseSet:
    """3D poses, +z up. poses: `[pose, joint, 3]`; weight: `[pose]` how often to draw each."""

    poses: Floats
    weight: Floats


@dataclass(frozen=True)
class Batch:
    """What the network sees and should say. pose: `[B, J, 2]`, seen: `[B, J]`, target: `[B, J, 3]`."""

    pose: Tensor
    seen: Tensor
    target: Tensor


def load_poses(path: Path, skeleton: Skeleton, split: Split) -> PoseSet:
    """Reads an npz with `poses [S, J, 3]` (+z up), `joints [J]` and optionally `split` and `subject` `[S]`.

    Poses are drawn by subject and by the square root of its number of frames, so that one long dance does not
    rule. Raises FormatError, and MismatchError where the joints are not those of the skeleton.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            fields = {name: file[name] for name in file.files if name in ("poses", "joints", "split", "subject")}
    except (OSError, ValueError) as error:
        raise FormatError(f"{path}: expected an npz file of 3D poses: {error}") from None
    if not {"poses", "joints"} <= set(fields):
        raise FormatError(f"{path}: expected the arrays `poses` and `joints`, found {', '.join(fields) or 'neither'}")
    found = match_names(tuple(str(name) for name in fields["joints"]), skeleton)
    order = [int(np.flatnonzero(found == k)[0]) for k in range(len(skeleton.keypoints)) if k in found]
    if len(order) < len(skeleton.keypoints):
        missing = [name for k, name in enumerate(skeleton.keypoints) if k not in found]
        raise MismatchError(f"{path}: joints of skeleton {skeleton.name} are missing: {', '.join(missing)}")
    keep = fields["split"] == split if "split" in fields else _every_tenth(len(fields["poses"]), split)
    subject = fields["subject"][keep] if "subject" in fields else np.zeros(int(keep.sum()), dtype=np.int64)
    _, which, count = np.unique(subject, return_inverse=True, return_counts=True)
    weight = 1.0 / np.sqrt(count[which])
    return PoseSet(fields["poses"][keep][:, order].astype(np.float64), weight / weight.sum())


def _every_tenth(n: int, split: Split) -> Bools:
    """7:2:1 in blocks of time, where a set does not bring its own split."""
    tenth = np.arange(n) * 10 // max(n, 1)
    return {"train": tenth < 7, "val": (tenth >= 7) & (tenth < 9), "test": tenth == 9}[split]


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
        body = self._other_bodies(self.poses[index])
        centred = body - body.mean(1, keepdim=True)
        centred = centred / centred.square().sum(2).mean(1).sqrt()[:, None, None]
        body = centred + config.joint_spread * self._normal(centred.shape)
        camera = torch.einsum("bij,bkj->bki", self._views(size), body)
        low, high = np.log(config.distance[0]), np.log(config.distance[1])
        depth = camera[..., 2] + torch.exp(self._uniform(size, 1) * (high - low) + low)
        image = camera[..., :2] / depth[..., None]
        seen = self._seen(size)
        return self._normalised(image, camera, depth, seen)

    def _normalised(self, image: Tensor, camera: Tensor, depth: Tensor, seen: Tensor) -> Batch:
        """Adds the detector's noise, then centres and scales input and target alike."""
        config = self.config
        _, _, radius = normalise(image, seen)
        low, high = np.log(config.noise[0]), np.log(config.noise[1])
        noise = torch.exp(self._uniform(len(image), 1) * (high - low) + low)
        noise = torch.where(self._uniform(*seen.shape) < config.outliers, torch.full_like(noise, 0.5), noise)
        pose, centre, scale = normalise(image + (noise * radius[:, None])[..., None] * self._normal(image.shape), seen)
        weight = seen.float()
        middle = (depth * weight).sum(1, keepdim=True) / weight.sum(1, keepdim=True)
        across = (camera[..., :2] / middle[..., None] - centre[:, None]) / scale[:, None, None]
        along = (depth - middle) / (middle * scale[:, None])
        return Batch(pose, seen, torch.cat([across, along[..., None]], dim=-1))

    def _other_bodies(self, body: Tensor) -> Tensor:
        """Rescales every limb, both sides alike; the knees of fitted skeletons are straightened at random."""
        size, config = len(body), self.config
        body = self._straighten(body)
        stretch = torch.exp(config.length_spread * self._normal((size, len(self.pairs))))
        joint_class = torch.empty(body.shape[1], dtype=torch.long)
        for k, members in enumerate(self.pairs):
            joint_class[list(members)] = k
        out = body.clone()
        for parent, child in self.skeleton.edges:
            out[:, child] = out[:, parent] + stretch[:, joint_class[child], None] * (body[:, child] - body[:, parent])
        return out

    def _straighten(self, body: Tensor) -> Tensor:
        """Moves each middle joint of a chain of three a random part of the way to the straight line."""
        names = {name: k for k, name in enumerate(self.skeleton.keypoints)}
        legs = [[f"{side}_{joint}" for joint in ("hip", "knee", "ankle")] for side in ("left", "right")]
        chains = [[names[joint] for joint in leg] for leg in legs if set(leg) <= set(names)]
        out, part = body.clone(), 0.7 * self._uniform(len(body), 1)
        for above, middle, under in chains:
            bone = body[:, under] - body[:, above]
            along = ((body[:, middle] - body[:, above]) * bone).sum(1, keepdim=True) / bone.square().sum(1, keepdim=True).clamp_min(1e-9)
            out[:, middle] += part * (body[:, above] + along * bone - body[:, middle])
        return out

    def _views(self, size: int) -> Tensor:
        """`[B, 3, 3]` cam_from_world of cameras that look at the body: x right, y down, z forward."""
        config = self.config
        azimuth = 2 * np.pi * self._uniform(size)
        low, high = np.deg2rad(config.elevation_deg)
        elevation = low + (high - low) * self._uniform(size) * self._uniform(size).sqrt()
        forward = torch.stack([-elevation.cos() * azimuth.cos(), -elevation.cos() * azimuth.sin(), -elevation.sin()], 1)
        up = torch.tensor([0.0, 0.0, 1.0]).expand_as(forward)
        right = torch.nn.functional.normalize(torch.cross(forward, up, dim=1), dim=1)
        upright = torch.stack([right, torch.cross(forward, right, dim=1), forward], 1)
        roll = np.deg2rad(config.roll_deg) * self._normal((size,))
        zero, one = torch.zeros_like(roll), torch.ones_like(roll)
        turn = torch.stack([roll.cos(), -roll.sin(), zero, roll.sin(), roll.cos(), zero, zero, zero, one], 1).view(-1, 3, 3)
        return turn @ upright

    def _seen(self, size: int) -> Tensor:
        """`[B, J]` another layout (left and right go together), a hidden limb, scattered misses; at least four stay."""
        config, joints = self.config, len(self.skeleton.keypoints)
        absent = self._uniform(size, len(self.pairs)) < config.joint_dropout * self._uniform(size, 1)
        seen = torch.ones(size, joints, dtype=torch.bool)
        for k, members in enumerate(self.pairs):
            seen[:, list(members)] &= ~absent[:, k, None]
        limb = torch.randint(len(self.below), (size,), generator=self.generator)
        seen &= ~(self.below[limb] & (self._uniform(size, 1) < 0.2))
        seen &= self._uniform(size, joints) >= config.occlusion * self._uniform(size, 1)
        lost = seen.sum(1) < 4
        seen[lost] = True
        return seen

    def _uniform(self, *shape: int) -> Tensor:
        return torch.rand(*shape, generator=self.generator)

    def _normal(self, shape: tuple[int, ...] | torch.Size) -> Tensor:
        return torch.randn(shape, generator=self.generator)


def _symmetry_classes(skeleton: Skeleton) -> list[tuple[int, ...]]:
    """Joints that a layout has together: left and right twins, and each other joint by itself."""
    paired = {k for pair in skeleton.symmetries for k in pair}
    return [*skeleton.symmetries, *((k,) for k in range(len(skeleton.keypoints)) if k not in paired)]


def _subtrees(skeleton: Skeleton) -> Tensor:
    """`[edge, J]` the joints at and beyond each edge's child."""
    below = torch.zeros(len(skeleton.edges), len(skeleton.keypoints), dtype=torch.bool)
    for row, (_, root) in enumerate(skeleton.edges):
        below[row, root] = True
        for parent, child in skeleton.edges:
            below[row, child] |= below[row, parent]
    return below
