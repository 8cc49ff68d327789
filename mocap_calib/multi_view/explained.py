"""How much of what was seen a result explains: the yardstick for whether a mend is right."""

import numpy as np

from mocap_calib.config import REPORT_FRAMES
from mocap_calib.multi_view.triangulation import gather_observations, project
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import CalibrationResult, Floats, GroupResult, Recording


def explained_share(result: CalibrationResult, recording: Recording, width: float) -> float:
    """Return the share (0..1) of all detected keypoints that the largest group explains.

    A keypoint counts 1 / (1 + (e / width)^2), e being its angle from the triangulated point, and
    nothing where it was matched with nobody or its camera was left out.

    recording: of all cameras, in the frames of the groups. width: radians.
    """
    group = result.groups[0]
    frames = evenly_spaced(np.arange(len(recording.frames)), REPORT_FRAMES)
    detected = int(np.isfinite(recording.positions[:, frames, ..., 0]).sum())
    fit = 1 / (1 + (angles_from_points(group) / width) ** 2)
    return float(np.nansum(fit)) / max(detected, 1)


def usual_angle(result: CalibrationResult) -> float:
    """Return the median angle in radians of keypoints from the points of the largest group."""
    angle = angles_from_points(result.groups[0])
    return float(np.median(angle[np.isfinite(angle)]))


def angles_from_points(group: GroupResult) -> Floats:
    """Return the distances of matched keypoints from the triangulated points, in radians.

    `[view, frame, individual, keypoint]`, of an even sample of the frames, NaN = missing.
    """
    frames = evenly_spaced(np.arange(len(group.recording.frames)), REPORT_FRAMES)
    pixels = gather_observations(group.recording, group.matches, frames).pixels
    points = group.poses.positions[frames]
    gap = project(group.rig, points.reshape(-1, 3).T) - pixels
    focal = np.array([camera.focal for camera in group.rig.cameras])
    angle = np.linalg.norm(gap, axis=1) / focal[:, None]
    return angle.reshape(len(angle), *points.shape[:3])
