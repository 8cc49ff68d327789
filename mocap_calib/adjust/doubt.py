"""Which detections an adjustment does without: the least confident, where their errors repeat.

Errors that chance makes anew in each frame average out, and leaving detections out loses what they
tell. Errors that a detector repeats from frame to frame do not average out, and pull the rig.
"""

import numpy as np

from mocap_calib.config import AdjustConfig
from mocap_calib.rig.noise import MeasuredSample
from mocap_calib.types import Bools, CameraRig, Floats, Ints, Matches

_LARGEST = 3.0  # medians: an error that is larger counts as so large


def without_doubtful(confidence: Floats, config: AdjustConfig) -> Floats:
    """Return the confidence `[view, N]` with 0 for the least confident share of each view.

    Where detections are few, a doubtful one is better than none.
    """
    doubtful = _find_doubtful(confidence, config.doubtful_share, config.enough_detections)
    return np.where(doubtful, 0.0, confidence)


def _find_doubtful(confidence: Floats, share: float, enough: int) -> Bools:
    """Return the least confident share of each view's detections, `[view, N]`.

    confidence: `[view, N]`, 0 = missing. enough: as long as so many of the view are left.
    """
    doubtful = np.zeros(confidence.shape, dtype=bool)
    for found, in_view in zip(doubtful, confidence, strict=True):
        seen = in_view[in_view > 0]
        if len(seen):
            spare = max(0.0, 1.0 - enough / len(seen))
            found[:] = (in_view > 0) & (in_view < np.quantile(seen, min(share, spare)))
    return doubtful


def doubtful_errors_repeat(
    rig: CameraRig, measured: MeasuredSample, names: Ints, config: AdjustConfig
) -> bool:
    """Return whether errors of the least confident detections are alike from frame to frame.

    names: `[frame, group]` who the groups of detections are in the frames that were measured, -1 =
    nobody. Where too few detections follow each other to tell, their errors are taken to be alike;
    so are those of two cameras, half of which show in no residual.
    """
    seen, points = measured.seen, measured.points
    doubtful = _find_doubtful(seen.confidence, config.doubtful_share, 0)
    if len(rig.cameras) == 2 or not doubtful.any():
        return True
    view, point = np.nonzero(doubtful & measured.counted)
    keypoints = points.shape[1] // names.size
    frame, group, keypoint = np.unravel_index(point, (*names.shape, keypoints))
    whose = (view * (names.max() + 2) + names[frame, group]) * keypoints + keypoint
    following = _follow_each_other(whose, frame)
    if len(following[0]) < config.least_following:
        return True
    error = _errors(rig, points[:, point], seen.rays[view, :, point], view)
    error = _limit(error, measured.angle[view, point])
    return _correlation(*(error[index] for index in following)) > config.repeated_errors


def names_of_groups(matches: Matches, in_frame: Matches) -> Ints:
    """Return the names `[frame, group]` of groups that were numbered in each frame, -1 = none."""
    view, frame, instance = np.nonzero(matches.labels >= 0)
    names = np.full((matches.labels.shape[1], in_frame.individuals), -1)
    names[frame, in_frame.labels[view, frame, instance]] = matches.labels[view, frame, instance]
    return names


def _errors(rig: CameraRig, points: Floats, rays: Floats, view: Ints) -> Floats:
    """Return how far the directions of points `[3, n]` are from rays `[n, 3]` of views `[n]`."""
    in_camera = np.einsum("nij,jn->ni", rig.rotation[view], points) + rig.translation[view]
    return np.asarray(in_camera / np.linalg.norm(in_camera, axis=1, keepdims=True) - rays)


def _limit(errors: Floats, angle: Floats) -> Floats:
    """Return errors `[n, 3]` none of which is larger than some usual ones; angle: their sizes."""
    most = _LARGEST * np.median(angle)
    return np.asarray(errors * np.minimum(1.0, most / np.maximum(angle, 1e-300))[:, None])


def _follow_each_other(whose: Ints, frame: Ints) -> tuple[Ints, Ints]:
    """Return the indices `[n]` of detections of the same in a frame and the next.

    whose: `[N]` a number for each view, individual and keypoint. frame: `[N]`.
    """
    order = np.lexsort((frame, whose))
    first, second = order[:-1], order[1:]
    follow = (whose[first] == whose[second]) & (frame[second] == frame[first] + 1)
    return first[follow], second[follow]


def _correlation(first: Floats, second: Floats) -> float:
    """Return the correlation of vectors `[n, 3]` about zero."""
    both = np.sqrt((first**2).sum() * (second**2).sum())
    return float((first * second).sum() / max(both, 1e-300))
