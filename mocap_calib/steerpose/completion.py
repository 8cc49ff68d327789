"""Keypoint completion: the identity rotation through SteerPose fills joints that were not seen, and bridges skeletons (appendix D of the paper)."""

import numpy as np
import torch
from torch import Tensor

from mocap_calib.geometry.projection import pixels_from_points
from mocap_calib.steerpose.steer import Model, steer
from mocap_calib.types import Bools, Floats, LiftedPoses, Sample

_SURE = 0.2  # body sizes: a joint that the network knows to this much counts exp(-1) as much
_MOST = 0.5  # what is guessed never counts more than half of what was seen


@torch.no_grad()
def complete(model: Model, pose: Tensor, seen: Tensor) -> Tensor:
    """`[B, J, 2]` poses (centred and scaled by `model.normalise`) with the joints that are not seen where the network puts them."""
    still = steer(
        model, pose, seen, torch.zeros(len(pose), 3, dtype=pose.dtype, device=pose.device)
    )
    return torch.where(seen[..., None], pose, still)


def completed(some: Sample, lifted: LiftedPoses) -> tuple[Floats, Floats]:
    """The same in the images of a recording, through perspective and lens, in the joints of the model.

    Returns positions `[view, frame, instance, joint, 2]` in pixels and confidence `[view, frame, instance, joint]`. What was seen stays as it
    was; the rest is projected from the lifted body, with a confidence of at most half of the detection's mean, less where the network
    is less sure. Detections that were not lifted keep what they have.
    """
    points = lifted.body + lifted.centre[..., None, :]
    positions = np.stack(
        [pixels_from_points(camera, own) for camera, own in zip(some.cameras, points, strict=True)]
    )
    confidence = _MOST * _mean_confidence(some)[..., None] * np.exp(-lifted.spread / _SURE)
    known = some.vocabulary >= 0
    joints = some.vocabulary[known]
    seen: Bools = some.seen[..., known]
    positions[..., joints, :] = np.where(
        seen[..., None], some.positions[..., known, :], positions[..., joints, :]
    )
    confidence[..., joints] = np.where(seen, some.confidence[..., known], confidence[..., joints])
    there = np.isfinite(positions).all(-1) & (confidence > 0)
    return np.where(there[..., None], positions, np.nan), np.where(there, confidence, 0.0)


def _mean_confidence(some: Sample) -> Floats:
    """`[view, frame, instance]` of the keypoints that were seen."""
    count = some.seen.sum(-1)
    return some.confidence.sum(-1) / np.maximum(count, 1)
