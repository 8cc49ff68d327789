"""Lift every detection of a sample, each in a virtual camera that looks straight at it.

How a body looks depends on the direction it is seen from, so the rays of each detection are turned
into the axes of a virtual camera that looks at it, and the lifted body is turned back. Cameras
stand upright or are turned by a quarter: each view is lifted in the quarter turn of the image under
which the network is surest.
"""

from dataclasses import dataclass

import numpy as np

from mocap_calib.compute.parallel import map_in_threads, single_threaded_libraries
from mocap_calib.config import (
    LEAST_JOINTS,
    LIFT_BEST_PERCENTILE,
    LIFT_CONFIDENCE,
    LIFT_LEAST_DEPTH,
    LIFT_LEAST_FORWARD,
    LIFT_UPRIGHT_SAMPLE,
)
from mocap_calib.geometry.rotation import looking_along
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.recording.synchronise import check_joints
from mocap_calib.steerpose.device import CPU, Network, network_on
from mocap_calib.steerpose.lifter import Floats32, Lifter
from mocap_calib.steerpose.rays import rays_by_joint
from mocap_calib.types import Bools, Floats, LiftedPoses, Progress, Sample

_BLOCK = 1024  # detections at a time

# The directions in a view's image that may be down: as the camera says, or turned by quarters.
_DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [-1.0, 0.0, 0.0]])


@dataclass(frozen=True)
class _Bodies:
    """Lifted detections of one view, as in `LiftedPoses`.

    body: `[..., joint, 3]`; centre: `[..., 3]`; spread: `[..., joint]`.
    """

    body: Floats
    centre: Floats
    spread: Floats


def lift(sample: Sample, lifter: Lifter, *, device: str = CPU, progress: Progress) -> LiftedPoses:
    """Lift all detections that surely show at least four joints of the model's vocabulary.

    The lifted body (E[X | p] of `model.py`) is freed of the virtual camera and scaled to unit size;
    its centre is where perspective puts it, in body sizes.

    Raises MismatchError where the model knows too few joints and several subjects make it needed;
    a single subject can be calibrated by geometry alone.
    """
    check_joints(sample)
    network = network_on(device, lifter)
    rays = rays_by_joint(_confident_rays(sample), sample.vocabulary, lifter.config.joints)
    views = len(rays)

    def lift_view(view: int) -> _Bodies:
        """Lift the detections of one view (index)."""
        return _lift_view(rays[view], network)

    lifted: list[_Bodies] = []
    with single_threaded_libraries():
        for bodies in map_in_threads(lift_view, range(views)):
            lifted.append(bodies)
            progress("lift", len(lifted), views)
    return LiftedPoses(
        body=np.stack([bodies.body for bodies in lifted]),
        centre=np.stack([bodies.centre for bodies in lifted]),
        spread=np.stack([bodies.spread for bodies in lifted]),
    )


def _confident_rays(sample: Sample) -> Floats:
    """Return the rays `[view, frame, instance, keypoint, 3]` worth lifting, NaN elsewhere.

    Detectors also report, with little confidence, joints that they do not see; the network has
    learnt joints that are seen or not.
    """
    best = np.array([_best_confidence(confidence) for confidence in sample.confidence])
    least = LIFT_CONFIDENCE * best[:, None, None, None]
    confident = sample.seen & (sample.confidence >= least)
    return np.where(confident[..., None], sample.rays, np.nan)


def _best_confidence(confidence: Floats) -> float:
    """Return the confidence that a view reaches at its best, 1 where it sees nothing."""
    positive = confidence[confidence > 0]
    return float(np.percentile(positive, LIFT_BEST_PERCENTILE)) if len(positive) else 1.0


def _lift_view(rays: Floats, network: Network) -> _Bodies:
    """Lift the detections of one view, rays `[frame, instance, joint, 3]`; NaN for the others."""
    enough = np.isfinite(rays[..., 0]).sum(-1) >= LEAST_JOINTS  # [frame, instance]
    lifted = _Bodies(
        body=np.full(rays.shape, np.nan),
        centre=np.full((*enough.shape, 3), np.nan),
        spread=np.full(rays.shape[:3], np.nan),
    )
    if enough.any():
        found = _lift_in_blocks(rays[enough], network)
        lifted.body[enough] = found.body
        lifted.centre[enough] = found.centre
        lifted.spread[enough] = found.spread
    return lifted


def _lift_in_blocks(rays: Floats, network: Network) -> _Bodies:
    """Lift the detections `[B, J, 3]` of one view, with the view's own direction of down."""
    down = _direction_of_down(rays, network)
    blocks = [
        _lift_rays(rays[start : start + _BLOCK], down, network)
        for start in range(0, len(rays), _BLOCK)
    ]
    return _Bodies(
        body=np.concatenate([block.body for block in blocks]),
        centre=np.concatenate([block.centre for block in blocks]),
        spread=np.concatenate([block.spread for block in blocks]),
    )


def _direction_of_down(rays: Floats, network: Network) -> Floats:
    """Return the direction `[3]` in a view's image under which the network is surest.

    rays: `[B, J, 3]` of the view's detections, of which a sample is lifted. Smaller samples than
    this one chose wrongly in real recordings, however clear their answer was.
    """
    sample = rays[evenly_spaced(np.arange(len(rays)), LIFT_UPRIGHT_SAMPLE)]
    spread = [np.median(_lift_rays(sample, down, network).spread) for down in _DOWN]
    return _DOWN[int(np.argmin(spread))]


def _lift_rays(rays: Floats, down: Floats, network: Network) -> _Bodies:
    """Lift rays `[B, J, 3]` in one camera's axes, the direction `down` `[3]` being down."""
    seen = np.isfinite(rays[..., 0])
    virtual_from_camera = looking_along(np.nansum(rays, axis=1), down)
    image = _project(rays, seen, virtual_from_camera)
    joints, deviation = _apply_network(image, seen, network)
    body = joints - joints.mean(1, keepdims=True)
    size = np.sqrt((body**2).sum(-1).mean(-1))[:, None]
    body = body / size[..., None]
    centre = _centre(body, image, seen)
    camera_from_virtual = np.swapaxes(virtual_from_camera, 1, 2)
    return _Bodies(
        body=np.einsum("bij,bkj->bki", camera_from_virtual, body),
        centre=np.einsum("bij,bj->bi", camera_from_virtual, centre),
        spread=np.hypot(deviation[..., 0], deviation[..., 1]) / size,
    )


def _project(rays: Floats, seen: Bools, virtual_from_camera: Floats) -> Floats:
    """Return the normalised image points `[B, J, 2]` of rays `[B, J, 3]` in virtual cameras."""
    known = np.where(seen[..., None], rays, [0.0, 0.0, 1.0])
    turned = np.einsum("bij,bkj->bki", virtual_from_camera, known)
    return turned[..., :2] / np.maximum(turned[..., 2:], LIFT_LEAST_FORWARD)


def _apply_network(image: Floats, seen: Bools, network: Network) -> tuple[Floats, Floats]:
    """Return joints `[B, J, 3]` and their standard deviations `[B, J, 2]` across and along the ray.

    image: `[B, J, 2]` normalised image points in the virtual cameras; seen: `[B, J]`.
    """
    joints, log_deviation = network(_normalise(image, seen), seen)
    return joints.astype(np.float64), np.exp(log_deviation.astype(np.float64))


def _normalise(image: Floats, seen: Bools) -> Floats32:
    """Centre image points `[B, J, 2]` on those seen `[B, J]`, scaled to an RMS radius of 1.

    What `model.normalise` does in training. What is not seen is 0.
    """
    weight = seen[..., None]
    count = np.maximum(weight.sum(1), 1)  # [B, 1]
    centre = np.where(weight, image, 0.0).sum(1) / count
    offset = np.where(weight, image - centre[:, None], 0.0)
    scale = np.sqrt((offset**2).sum((1, 2)) / count[:, 0])
    return (offset / np.maximum(scale, 1e-9)[:, None, None]).astype(np.float32)


def _centre(body: Floats, image: Floats, seen: Bools) -> Floats:
    """Return the centres `[B, 3]` that put bodies `[B, J, 3]` where their joints are seen.

    The least-squares solution c of (X + c)_xy = x (X + c)_z over the joints that are seen, X being
    a joint of the body and x its normalised image point `[B, J, 2]`.
    """
    weight = seen.astype(np.float64)
    count = weight.sum(1)
    offset = image * body[..., 2:] - body[..., :2]  # c_xy - x c_z = x X_z - X_xy
    mean_image = (weight[..., None] * image).sum(1) / count[:, None]
    mean_offset = (weight[..., None] * offset).sum(1) / count[:, None]
    image_deviation = (image - mean_image[:, None]) * weight[..., None]
    offset_deviation = (offset - mean_offset[:, None]) * weight[..., None]
    covariance = (image_deviation * offset_deviation).sum((1, 2))
    variance = (image_deviation**2).sum((1, 2))
    depth = np.maximum(-covariance / np.maximum(variance, 1e-18), LIFT_LEAST_DEPTH)
    across = mean_offset + mean_image * depth[:, None]
    return np.concatenate([across, depth[:, None]], axis=1)
