"""The geometry of two views from what both show, before anything is calibrated.

Where each camera sees one body, matches are known. From them follow, without intrinsics, the
fundamental matrix and the epipoles: where each camera has the other one in its image (Hartley and
Zisserman 2004, sections 9.2 and 11.1). If a homography explains the matches as well, all of them
lie in one plane.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mocap_calib.config import LEAST_JOINTS
from mocap_calib.geometry.epipolar import fundamental_matrix, homography_errors
from mocap_calib.geometry.rotation import mean_of_known
from mocap_calib.inspection.contents import InspectConfig
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import Floats, Keypoints2D

_TINY = 1e-9  # of an error, of a size in pixels


@dataclass(frozen=True)
class TwoViews:
    """How the images of one subject in two views go together.

    error: of the fundamental matrix that fits best, the median in sizes of the body. plane_error:
        the same of the homography that fits best; about twice as large where all matches lie in one
        plane. epipole: how far the image of the other camera is from the middle of what is seen, in
        halves of its extent; of both views the larger. mirrored: they see opposite sides of bodies.
    """

    error: float
    plane_error: float
    epipole: float
    mirrored: bool


def compare_views(
    a: Keypoints2D, b: Keypoints2D, meanings: Mapping[str, str], config: InspectConfig
) -> TwoViews | None:
    """Return how two views go together; None where they do not see the same single subject."""
    bodies = _same_bodies(a, b, meanings, config)  # [view, frame, joint, 2]
    both = np.asarray(np.isfinite(bodies).all((0, -1)))
    if both.sum() < config.least_matches:
        return None
    middle = mean_of_known(np.where(both[..., None], bodies, np.nan), 2)
    centred = (bodies - middle[:, :, None])[:, both]
    chosen = evenly_spaced(np.arange(both.sum()), config.most_matches)
    first, second = np.ascontiguousarray(bodies[:, both][:, chosen])
    matrix = fundamental_matrix(first, second)
    if matrix is None:
        return None
    size = np.sqrt((centred[1] ** 2).sum(-1).mean()) + _TINY
    map_of_bodies = np.linalg.lstsq(centred[0], centred[1], rcond=None)[0]
    left, _, right = np.linalg.svd(matrix)
    return TwoViews(
        error=float(np.median(np.abs(sampson_distance(matrix, first, second))) / size) + _TINY,
        plane_error=float(np.median(homography_errors(first, second)) / size),
        epipole=max(_distance(right[2], first), _distance(left[:, 2], second)),
        mirrored=bool(np.linalg.det(map_of_bodies) < 0),
    )


def _same_bodies(
    a: Keypoints2D, b: Keypoints2D, meanings: Mapping[str, str], config: InspectConfig
) -> Floats:
    """Return `[view, frame, joint, 2]` the joints of the only body in each frame, NaN = missing.

    No frames where too many of those in which both views see somebody show more than one body.
    """
    column = {meanings[name]: k for k, name in enumerate(b.keypoints)}
    shared = [(k, column[meanings[n]]) for k, n in enumerate(a.keypoints) if meanings[n] in column]
    frames = evenly_spaced(np.intersect1d(a.frames, b.frames), config.compared_frames)
    rows = [np.searchsorted(view.frames, frames) for view in (a, b)]
    positions = [
        view.positions[own][:, :, [pair[side] for pair in shared]].astype(np.float64)
        for side, (view, own) in enumerate(zip((a, b), rows, strict=True))
    ]
    whole = [np.isfinite(each[..., 0]).sum(-1) >= LEAST_JOINTS for each in positions]
    counts = np.stack([each.sum(-1) for each in whole])  # [view, frame]
    seen, single = (counts > 0).all(0), (counts == 1).all(0)
    alone = single.sum() >= config.single_share * seen.sum()
    chosen = np.flatnonzero(single & alone)
    return np.stack(
        [
            each[chosen, instance[chosen].argmax(-1)]
            for each, instance in zip(positions, whole, strict=True)
        ]
    )


def _distance(epipole: Floats, points: Floats) -> float:
    """Return how far an epipole `[3]` is from the middle of points, in half of their extent."""
    low, high = np.percentile(points, [2, 98], axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.abs(epipole[:2] / epipole[2] - (low + high) / 2) / np.maximum(high - low, _TINY)
    return float(np.nan_to_num(2 * off.max(), nan=np.inf))


def sampson_distance(matrix: Floats, points_a: Floats, points_b: Floats) -> Floats:
    """Return the signed epipolar errors `[N]` of matches in pixels, to first order.

    Sampson's error (Hartley and Zisserman 2004, eq. 11.9).

    matrix: `[3, 3]` fundamental matrix. points_a, points_b: `[N, 2]` pixels.
    """
    ones = np.ones((len(points_a), 1))
    points_a, points_b = np.hstack([points_a, ones]), np.hstack([points_b, ones])
    line_b, line_a = points_a @ matrix.T, points_b @ matrix
    slope = (line_b[:, :2] ** 2).sum(1) + (line_a[:, :2] ** 2).sum(1)
    return np.asarray((line_b * points_b).sum(1) / np.sqrt(np.maximum(slope, 1e-18)))
