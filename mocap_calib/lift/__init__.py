"""Predict the 3D body of every detection of a sample from its view alone.

The rays of each detection are rotated into a virtual camera that looks straight at it, and the
predicted body is rotated back. Images may be rotated by quarter turns: each view is lifted in the
quarter turn under which the network states the smallest standard deviations.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import NamedTuple

import numpy as np

from mocap_calib.compute.parallel import map_in_threads, single_threaded_libraries
from mocap_calib.config import (
    LEAST_FORWARD,
    LEAST_JOINTS,
    LEAST_LIFT_SPREAD,
    LIFT_BEST_PERCENTILE,
    LIFT_CONFIDENCE,
    LIFT_LEAST_DEPTH,
)
from mocap_calib.geometry.lens import pixels_from_points
from mocap_calib.geometry.rotation import looking_along
from mocap_calib.lift.lifter import Lifter
from mocap_calib.recording.sampling import check_joints, evenly_spaced
from mocap_calib.recording.synchronise import split_by_view
from mocap_calib.results import LiftedPoses
from mocap_calib.types import Bools, Floats, Floats32, Ints, Keypoints2D, Progress, Sample, Skeleton

# detections at a time, and those of a view that determine which way is down in its images
_BLOCK = 128
_PARTS = 4  # of a sample: most directions have lost after one
# The directions in a view's image that may be down: as the camera says, or turned by quarters.
_DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [-1.0, 0.0, 0.0]])


class _Bodies(NamedTuple):
    """Lifted detections, as in `LiftedPoses`.

    body: `[B, joint, 3]`; centre: `[B, 3]`; spread: `[B, joint]`.
    """

    body: Floats
    centre: Floats
    spread: Floats


def lift(sample: Sample, lifter: Lifter, *, progress: Progress) -> LiftedPoses:
    """Lift all detections with at least four confident joints of the model's vocabulary.

    The lifted body (E[X | p] of `model.py`) is freed of the virtual camera and scaled to unit size;
    its centre is where perspective puts it, in body sizes.

    Raises MismatchError where the model knows too few joints and several subjects make it needed;
    a single subject can be calibrated by geometry alone.
    """
    check_joints(sample)
    rays = rays_by_joint(_confident_rays(sample), sample.vocabulary, lifter.config.joints)
    enough = np.isfinite(rays[..., 0]).sum(-1) >= LEAST_JOINTS  # [view, frame, instance]
    bodies = _lift_views(rays[enough], np.nonzero(enough)[0], lifter, progress)
    found = [np.full((*enough.shape, *values.shape[1:]), np.nan) for values in bodies]
    for values, of_enough in zip(found, bodies, strict=True):
        values[enough] = of_enough
    return LiftedPoses(*found)


def _confident_rays(sample: Sample) -> Floats:
    """Return the rays `[view, frame, instance, keypoint, 3]` of confident joints, NaN elsewhere.

    Detectors report hidden joints with low confidence; the network was trained on joints that are
    either seen or missing.
    """
    best = np.array([_best_confidence(confidence) for confidence in sample.confidence])
    least = LIFT_CONFIDENCE * best[:, None, None, None]
    confident = sample.seen & (sample.confidence >= least)
    return np.where(confident[..., None], sample.rays, np.nan)


def _best_confidence(confidence: Floats) -> float:
    """Return a high percentile of the confidences of a view, 1 where it has no detection."""
    positive = confidence[confidence > 0]
    return float(np.percentile(positive, LIFT_BEST_PERCENTILE)) if len(positive) else 1.0


def rays_by_joint(rays: Floats, vocabulary: Ints, joints: int) -> Floats:
    """Return rays `[..., joint, 3]` in the joint order of a model, NaN for joints without keypoint.

    rays: `[..., keypoint, 3]`; vocabulary: `[keypoint]` index of the model's joint, -1 = none.
    """
    known = vocabulary >= 0
    ordered = np.full((*rays.shape[:-2], joints, 3), np.nan)
    ordered[..., vocabulary[known], :] = rays[..., known, :]
    return ordered


@single_threaded_libraries()
def _lift_views(rays: Floats, view: Ints, lifter: Lifter, progress: Progress) -> _Bodies:
    """Return the lifted bodies, in each view with its own direction of down.

    That is the direction with the smallest median standard deviation over a sample of its
    detections. Smaller samples chose wrongly in real recordings.

    rays: `[B, joint, 3]`; view: `[B]` in which each detection is.
    """
    bodies = _lift_blocks(rays, np.tile(_DOWN[0], (len(rays), 1)), lifter, progress)
    views = np.unique(view)
    samples = [evenly_spaced(np.flatnonzero(view == each), _BLOCK) for each in views]
    upright = [float(np.median(bodies.spread[sample])) for sample in samples]
    others = map_in_threads(
        lambda each: _doubt(rays[each[0][0]], each[1], least=each[0][1], lifter=lifter),
        product(zip(samples, upright, strict=True), _DOWN[1:]),
    )
    doubt = np.column_stack([upright, np.reshape(list(others), (len(views), len(_DOWN) - 1))])
    best = doubt.argmin(1)[np.searchsorted(views, view)]
    turned = best > 0  # of few recordings
    again = _lift_blocks(rays[turned], _DOWN[best[turned]], lifter, progress)
    for values, found in zip(bodies, again, strict=True):
        values[turned] = found
    return bodies


def _doubt(rays: Floats, down: Floats, *, least: float, lifter: Lifter) -> float:
    """Return the median standard deviation of rays `[B, J, 3]` under a direction of down.

    Infinite as soon as three of four joints have `least` or more.
    """
    spread = np.zeros(rays.shape[:2])
    for start in range(0, len(rays), _BLOCK // _PARTS):
        part = slice(start, start + _BLOCK // _PARTS)
        spread[part] = _lift_rays(rays[part], down, lifter).spread
        if np.mean(spread[: part.stop] >= least) > 0.75:
            return np.inf
    return float(np.median(spread))


def _lift_blocks(rays: Floats, down: Floats, lifter: Lifter, progress: Progress) -> _Bodies:
    """Return the lifted bodies of rays `[B, J, 3]`, whose directions `[B, 3]` are down."""
    blocks = [slice(start, start + _BLOCK) for start in range(0, len(rays), _BLOCK)]
    bodies = _Bodies(np.empty(rays.shape), np.empty((len(rays), 3)), np.empty(rays.shape[:2]))
    lifted = map_in_threads(lambda block: _lift_rays(rays[block], down[block], lifter), blocks)
    for block, found in zip(blocks, lifted, strict=True):
        for values, of_block in zip(bodies, found, strict=True):
            values[block] = of_block
        progress("lift", min(block.stop, len(rays)), len(rays))
    return bodies


def _lift_rays(rays: Floats, down: Floats, lifter: Lifter) -> _Bodies:
    """Lift rays `[B, J, 3]` in cameras' axes, directions `down` `[3]` or `[B, 3]` being down."""
    seen = np.isfinite(rays[..., 0])
    virtual_from_camera = looking_along(np.nansum(rays, axis=1), down)
    image = _project(rays, seen, virtual_from_camera)
    found, log_deviation = lifter(_normalise(image, seen), seen)
    joints = found.astype(np.float64)
    deviation = np.exp(log_deviation.astype(np.float64))  # [B, J, 2] across and along the ray
    body = joints - joints.mean(1, keepdims=True)
    size = np.sqrt((body**2).sum(-1).mean(-1))[:, None]
    body = body / size[..., None]
    centre = _centre(body, image, seen)
    return _Bodies(
        body=body @ virtual_from_camera,  # in rows: turned by the transpose
        centre=np.einsum("bji,bj->bi", virtual_from_camera, centre),
        spread=np.hypot(deviation[..., 0], deviation[..., 1]) / size,
    )


def _project(rays: Floats, seen: Bools, virtual_from_camera: Floats) -> Floats:
    """Return the normalised image points `[B, J, 2]` of rays `[B, J, 3]` in virtual cameras."""
    known = np.where(seen[..., None], rays, [0.0, 0.0, 1.0])
    turned = known @ np.swapaxes(virtual_from_camera, 1, 2)
    return turned[..., :2] / np.maximum(turned[..., 2:], LEAST_FORWARD)


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


@dataclass
class RememberedLift:
    """Lifts samples as `lift` does; one that equals the last one is not lifted again."""

    lifter: Lifter
    progress: Progress
    _last: list[tuple[Sample, LiftedPoses]] = field(default_factory=list, init=False)

    def __call__(self, sample: Sample) -> LiftedPoses:
        """Return the lifted detections of a sample. Raises what `lift` raises."""
        if not self._last or self._last[0][0] != sample:
            lifted = lift(sample, self.lifter, progress=self.progress)
            self._last = [(sample, lifted)]
        return self._last[0][1]


def complete_sample(
    sample: Sample, lifted: LiftedPoses, vocabulary: Skeleton
) -> tuple[Keypoints2D, ...]:
    """Complete the missing joints of the detections of a sample in their images.

    Returns the keypoints of each view, which are the joints of the model. Detected joints stay
    unchanged. The others are projected from the lifted body (appendix D of Lee et al., BMVC 2025),
    with a confidence of at most half of the detection's mean, less for uncertain joints. Detections
    that were not lifted stay incomplete.

    vocabulary: of the model that lifted the sample.
    """
    known = sample.vocabulary >= 0
    joints = sample.vocabulary[known]
    seen: Bools = sample.seen[..., known]
    positions = _project_lifted(sample, lifted)
    confidence = _confidence_of_lifted(sample, lifted)
    positions[..., joints, :] = np.where(
        seen[..., None], sample.positions[..., known, :], positions[..., joints, :]
    )
    confidence[..., joints] = np.where(seen, sample.confidence[..., known], confidence[..., joints])
    present = np.isfinite(positions).all(-1) & (confidence > 0)
    return split_by_view(
        sample.cameras,
        keypoints=vocabulary.keypoints,
        frames=sample.frames,
        positions=np.where(present[..., None], positions, np.nan),
        confidence=np.where(present, confidence, 0.0),
        tracked=sample.tracked,
        source="completed",
    )


def find_completed(sample: Sample, views: Sequence[Keypoints2D]) -> Bools:
    """Return which points `[view, frame, instance, keypoint]` were completed.

    sample: that was completed. views: what `complete_sample` returned.
    """
    known = sample.vocabulary >= 0
    present = np.stack([np.isfinite(view.positions[..., 0]) for view in views])
    seen = np.zeros_like(present)
    seen[..., sample.vocabulary[known]] = sample.seen[..., known]
    completed: Bools = present & ~seen
    return completed


def _project_lifted(sample: Sample, lifted: LiftedPoses) -> Floats:
    """Return the pixels `[view, frame, instance, joint, 2]` of the lifted bodies."""
    points = lifted.body + lifted.centre[..., None, :]
    return np.stack(
        [
            pixels_from_points(camera, points_in_camera)
            for camera, points_in_camera in zip(sample.cameras, points, strict=True)
        ]
    )


def _confidence_of_lifted(sample: Sample, lifted: LiftedPoses) -> Floats:
    """Return the confidence `[view, frame, instance, joint]` of completed joints.

    Of a joint that is as certain as a lifted one can be it is half of the detection's mean.
    """
    seen_keypoints = np.maximum(sample.seen.sum(-1), 1)
    mean_confidence = sample.confidence.sum(-1) / seen_keypoints  # [view, frame, instance]
    certainty = LEAST_LIFT_SPREAD / (
        LEAST_LIFT_SPREAD + np.maximum(lifted.spread, LEAST_LIFT_SPREAD)
    )
    return mean_confidence[..., None] * certainty
