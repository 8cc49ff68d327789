"""Lifting every detection of a recording, each in a virtual camera that looks at it.

The appearance of a body depends on the ray it is seen along, so the rays of each detection are turned into a camera
that looks straight at it; the lifted body is turned back. Rigs are upright or turned by a quarter: the quarter turn
under which the network is surest is taken for each view.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch

from mocap_calib.compute.parallel import in_order
from mocap_calib.config import LEAST_JOINTS
from mocap_calib.geometry.rotation import looking_along
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.recording.synchronise import check_joints
from mocap_calib.steerpose.model import Lifter, normalise
from mocap_calib.types import Bools, Floats, LiftedPoses, Progress, Sample

_DOUBTFUL = 0.4  # of the confidence that a view reaches at its best; the network knows joints that are seen or not
_BEST = 90.0  # percentile
_BLOCK = 1024
_SAMPLE = 128
_DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [-1.0, 0.0, 0.0]])


def lift(
    recording: Sample, lifter: Lifter, *, device: str = "cpu", progress: Progress
) -> LiftedPoses:
    """Lifts all detections that show at least four joints of the model's vocabulary for sure.

    The body of the network (eq. 1's q*(R) = P R E[X | p]) is freed of the virtual camera and scaled to unit size;
    its centre is where perspective puts it, in body sizes. Raises MismatchError where the model knows too few joints and
    several subjects make it needed; a single subject can be calibrated by geometry alone.
    """
    lifter = lifter.to(device)
    known = recording.vocabulary >= 0
    check_joints(recording)
    views, frames, instances = recording.positions.shape[:3]
    joints = lifter.config.joints
    rays = np.full((views, frames, instances, joints, 3), np.nan)
    rays[..., recording.vocabulary[known], :] = np.where(
        _sure(recording)[..., known, None], recording.rays[..., known, :], np.nan
    )
    enough = np.isfinite(rays[..., 0]).sum(-1) >= LEAST_JOINTS
    body = np.full_like(rays, np.nan)
    centre = np.full((views, frames, instances, 3), np.nan)
    spread = np.full((views, frames, instances, joints), np.nan)

    def work(view: int) -> None:
        where = np.flatnonzero(enough[view].reshape(-1))
        chosen = rays[view].reshape(-1, joints, 3)[where]
        if len(chosen):
            down = _down(chosen, lifter, device)
            blocks = [
                _lift_rays(chosen[k : k + _BLOCK], down, lifter, device)
                for k in range(0, len(chosen), _BLOCK)
            ]
            body[view].reshape(-1, joints, 3)[where] = np.concatenate([b[0] for b in blocks])
            centre[view].reshape(-1, 3)[where] = np.concatenate([b[1] for b in blocks])
            spread[view].reshape(-1, joints)[where] = np.concatenate([b[2] for b in blocks])

    with _one_thread():
        for view, _ in enumerate(in_order(work, range(views))):
            progress("lift", view + 1, views)
    return LiftedPoses(body, centre, spread)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Torch on one thread for each of ours: such small networks are slower on more, and their last digits differ."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _sure(recording: Sample) -> Bools:
    """`[view, frame, instance, keypoint]` joints that are worth lifting: detectors also report, doubtfully, what they do not see."""
    best = [
        np.percentile(own[own > 0], _BEST) if (own > 0).any() else 1.0
        for own in recording.confidence
    ]
    return recording.seen & (recording.confidence >= _DOUBTFUL * np.reshape(best, (-1, 1, 1, 1)))


def _down(rays: Floats, lifter: Lifter, device: str) -> Floats:
    """`[3]` the quarter turn of the image plane that makes the network surest of a sample of this view's detections."""
    some = rays[evenly_spaced(np.arange(len(rays)), _SAMPLE)]
    doubt = [np.median(_lift_rays(some, down, lifter, device)[2]) for down in _DOWN]
    return _DOWN[int(np.argmin(doubt))]


@torch.no_grad()
def _lift_rays(
    rays: Floats, down: Floats, lifter: Lifter, device: str
) -> tuple[Floats, Floats, Floats]:
    """Body `[B, J, 3]`, centre `[B, 3]` and spread `[B, J]` of rays `[B, J, 3]` in one camera's axes."""
    seen = np.isfinite(rays[..., 0])
    virtual_from_camera = looking_along(np.nansum(rays, axis=1), down)
    turned = np.einsum(
        "bij,bkj->bki", virtual_from_camera, np.where(seen[..., None], rays, [0.0, 0.0, 1.0])
    )
    image = turned[..., :2] / np.maximum(turned[..., 2:], 0.1)
    pose, _, _ = normalise(
        torch.from_numpy(image).float().to(device), torch.from_numpy(seen).to(device)
    )
    joints, log_spread = lifter(pose, torch.from_numpy(seen).to(device))
    body = joints.double().cpu().numpy()
    body -= body.mean(1, keepdims=True)
    size = np.sqrt((body**2).sum(-1).mean(-1))[:, None]
    body /= size[..., None]
    across, along = np.moveaxis(np.exp(log_spread.double().cpu().numpy()), -1, 0)
    centre = _centre(body, image, seen)
    back = np.swapaxes(virtual_from_camera, 1, 2)
    return (
        np.einsum("bij,bkj->bki", back, body),
        np.einsum("bij,bj->bi", back, centre),
        np.hypot(across, along) / size,
    )


def _centre(body: Floats, image: Floats, seen: Bools) -> Floats:
    """`[B, 3]` c that puts the bodies where their joints are seen: (X + c)_xy = x (X + c)_z in the least-squares sense."""
    weight = seen.astype(np.float64)
    count = weight.sum(1)
    offset = image * body[..., 2:] - body[..., :2]  # c_xy - x c_z = x X_z - X_xy
    mean_x = (weight[..., None] * image).sum(1) / count[:, None]
    mean_o = (weight[..., None] * offset).sum(1) / count[:, None]
    dx, do = (
        (image - mean_x[:, None]) * weight[..., None],
        (offset - mean_o[:, None]) * weight[..., None],
    )
    depth = -(dx * do).sum((1, 2)) / np.maximum((dx**2).sum((1, 2)), 1e-18)
    depth = np.maximum(depth, 0.5)
    return np.concatenate([mean_o + mean_x * depth[:, None], depth[:, None]], axis=1)
