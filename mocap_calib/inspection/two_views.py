"""What the images of one subject show of where cameras stand, before anything is calibrated.

Matches are known where each camera sees one body. From them follow, without intrinsics, the
fundamental matrix and the epipoles: where each camera has the other one in its image (Hartley and
Zisserman 2004, sections 9.2 and 11.1). If a homography explains the matches as well, all of them
lie in one plane.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_calib.config import LEAST_JOINTS
from mocap_calib.geometry.alignment import mean_of_known
from mocap_calib.geometry.epipolar import fundamental_matrix, homography_errors, sampson_distance
from mocap_calib.inspection.config import InspectConfig
from mocap_calib.inspection.finding import Finding, warning
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


def find_poor_views(
    usable: Sequence[Keypoints2D],
    pairs: Sequence[Mapping[str, Any]],
    meanings: Mapping[str, str],
    config: InspectConfig,
) -> list[Finding]:
    """Warn of a single subject that lies in one plane, and of two cameras that look at each other.

    Of these only where no third camera sees the same.

    pairs: of the report. meanings: of the names of keypoints.
    """
    view_of = {view.camera: view for view in usable}
    together = [
        (pair["a"], pair["b"])
        for pair in pairs
        if pair["covisible"] >= config.enough_frames and {pair["a"], pair["b"]} <= set(view_of)
    ]
    alone = _find_alone(together)
    some = evenly_spaced(np.arange(len(together)), config.most_pairs).tolist()
    compared = {
        (a, b): found
        for a, b in dict.fromkeys([*alone, *(together[k] for k in some)])
        if (found := compare_views(view_of[a], view_of[b], meanings, config)) is not None
        and found.error < config.most_error
    }
    if not compared:
        return []
    depth = np.median([found.plane_error / found.error for found in compared.values()])
    if depth < config.least_depth:
        return [
            warning(
                "all that was seen may as well lie in one plane, or the cameras stand side by "
                "side, so that other rigs would fit, too; let the subject come closer, rise, jump "
                "or tilt, or move the cameras apart"
            )
        ]
    return [
        warning(
            f"{a} and {b} look at each other, and no third camera sees the same: points between "
            "them will be uncertain along that line; add a camera that looks from the side, or let "
            "the subject keep off the line"
        )
        for (a, b), found in compared.items()
        if found.mirrored and found.epipole < 1 and (a, b) in alone
    ]


def _find_alone(together: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """Return the pairs of cameras of which neither sees enough together with a third one.

    together: the pairs that do.
    """
    number = Counter(name for pair in together for name in pair)
    return [(a, b) for a, b in together if number[a] == number[b] == 1]


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
