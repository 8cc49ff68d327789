"""Complete keypoints that were not seen, and bridge skeletons: SteerPose with no rotation.

Appendix D of the paper (Lee et al., BMVC 2025); `steer.complete` is its form for either network.
"""

from collections.abc import Sequence

import numpy as np

from mocap_calib.config import COMPLETION_CONFIDENCE, COMPLETION_SPREAD
from mocap_calib.geometry.projection import pixels_from_points
from mocap_calib.recording.views import split_by_view
from mocap_calib.results import LiftedPoses
from mocap_calib.types import Bools, Floats, Keypoints2D, Sample, Skeleton


def complete_sample(
    sample: Sample, lifted: LiftedPoses, vocabulary: Skeleton
) -> tuple[Keypoints2D, ...]:
    """Complete the detections of a sample in their images, through perspective and lens.

    Returns the keypoints of each view, which are the joints of the model. What was seen stays as
    it was. The rest is projected from the lifted body, with a confidence of at most half of the
    detection's mean, less where the network is less sure. Detections that were not lifted keep
    what they have.

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
    """Return which points `[view, frame, instance, keypoint]` the detector had not seen.

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
    """Return the confidence `[view, frame, instance, joint]` that lifted joints deserve."""
    seen_keypoints = np.maximum(sample.seen.sum(-1), 1)
    mean_confidence = sample.confidence.sum(-1) / seen_keypoints  # [view, frame, instance]
    certainty = np.exp(-lifted.spread / COMPLETION_SPREAD)
    return COMPLETION_CONFIDENCE * mean_confidence[..., None] * certainty
