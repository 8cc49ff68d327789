"""Whether subjects move: what stands still shows all frames alike, and does not determine a rig.

The errors of a detector on a still subject are the same in all frames: they do not average out,
and the rig bends to fit them.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mocap_calib.config import LEAST_JOINTS
from mocap_calib.geometry.alignment import mean_of_known
from mocap_calib.inspection.config import InspectConfig
from mocap_calib.inspection.finding import Finding, warning
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import Floats, Keypoints2D


def measure_motion(view: Keypoints2D, config: InspectConfig) -> float | None:
    """Return how far from each other the detections of two frames are, in sizes of their bodies.

    From a detection to the nearest one of another frame, whoever that is: the median distance of
    their keypoints over the RMS distance of its keypoints from their middle. The 90th percentile
    of that over pairs of frames, which are evenly spread. None where no two frames can be compared.
    """
    seen = np.isfinite(view.positions[..., 0]).sum(-1) >= LEAST_JOINTS  # [frame, instance]
    frames = evenly_spaced(np.flatnonzero(seen.any(1)), config.motion_frames)
    shown = seen[frames]
    positions = np.asarray(view.positions[frames], dtype=float)
    positions = np.where(shown[..., None, None], positions, np.nan)
    distances = [
        _nearest(positions[k], np.delete(positions, k, axis=0))[:, shown[k]].ravel()
        for k in range(len(frames))  # all pairs at once may be gigabytes
    ]
    found = np.concatenate(distances) if distances else np.empty(0)
    found = found[np.isfinite(found)]
    return float(np.percentile(found, config.motion_percentile)) if len(found) else None


def find_still_subjects(
    usable: Sequence[Keypoints2D], cameras: Sequence[Mapping[str, Any]], config: InspectConfig
) -> list[Finding]:
    """Say that hardly anything moves, where that is so. cameras: of the report."""
    names = {view.camera for view in usable}
    motion = [each["motion"] for each in cameras if each["name"] in names]
    known = [value for value in motion if value is not None]
    if not known or np.median(known) >= config.least_motion:
        return []
    return [
        warning(
            f"hardly anything moves: between frames bodies are {np.median(known):.0%} of their "
            f"size apart, expected {config.least_motion:.0%} or more; still subjects do not "
            "determine where cameras stand: let somebody walk about and turn"
        )
    ]


def _nearest(detections: Floats, others: Floats) -> Floats:
    """Return how far the nearest detection of other frames is, `[frame, instance]`, in body sizes.

    detections: `[instance, keypoint, 2]` of one frame. others: `[frame, instance, keypoint, 2]`.
    It is NaN where nothing can be compared.
    """
    spread = detections - mean_of_known(detections, 1)[:, None]
    size = np.sqrt(mean_of_known((spread**2).sum(-1), 1))  # [instance]
    gap = np.linalg.norm(detections[None, :, None] - others[:, None], axis=-1)
    comparable = np.isfinite(gap).sum(-1) >= LEAST_JOINTS  # [frame, instance, other instance]
    gap = np.where(comparable[..., None], gap, np.inf)
    # of those that are missing none is the nearest; NaN goes last in the order
    order = np.sort(gap, axis=-1)
    middle = (np.isfinite(gap).sum(-1, keepdims=True) - 1).clip(0) // 2
    median = np.take_along_axis(order, middle, axis=-1)[..., 0]
    nearest = median.min(-1, initial=np.inf) / np.maximum(size, 1e-9)
    return np.where(np.isfinite(nearest), nearest, np.nan)
