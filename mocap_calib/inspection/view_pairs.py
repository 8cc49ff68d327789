"""What views show together, before anything is calibrated: frame numbers, and the rig's geometry.

Where each camera sees one body, matches are known. From them follow, without intrinsics, the
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
from mocap_calib.errors import argument, count
from mocap_calib.geometry.epipolar import fundamental_matrix
from mocap_calib.geometry.rotation import mean_of_known
from mocap_calib.inspection.finding import Finding, InspectConfig, critical, warning
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import Floats, Keypoints2D


def find_clock_problems(
    usable: Sequence[Keypoints2D], pairs: Sequence[Mapping[str, Any]], config: InspectConfig
) -> list[Finding]:
    """Name the frame numbers that do not go together. pairs: of the report."""
    names = {view.camera for view in usable}
    pairs = [pair for pair in pairs if _names(pair) <= names]
    if not pairs:
        return []
    most = max(pair["covisible"] for pair in pairs)
    if most == 0:
        return [
            critical(
                f"no two cameras see anything in the same frame ({_frame_ranges(usable)}); number "
                f"the frames of all cameras on one clock ({argument('frame_offset')}), or check "
                "that the files are of one recording"
            )
        ]
    return [
        *_find_little_overlap(usable, pairs, config),
        *_find_lonely_cameras(usable, pairs),
        *_find_separate_groups(usable, pairs),
        *_find_other_frames(usable),
    ]


def _find_little_overlap(
    usable: Sequence[Keypoints2D], pairs: Sequence[Mapping[str, Any]], config: InspectConfig
) -> list[Finding]:
    """Name the cameras that see too little together with any other. pairs: of the report."""
    enough = config.enough_frames
    if max(pair["covisible"] for pair in pairs) < enough:
        return [
            warning(
                f"no two cameras see something together in {enough} frames or more; record longer"
            )
        ]
    most = {
        view.camera: max(pair["covisible"] for pair in pairs if view.camera in _names(pair))
        for view in usable
    }
    return [
        warning(
            f"{name}: sees something together with another camera in {count(frames, 'frame')}, "
            f"expected {enough} or more; record longer, or let somebody pass where both see"
        )
        for name, frames in most.items()
        if 0 < frames < enough
    ]


def _find_separate_groups(
    usable: Sequence[Keypoints2D], pairs: Sequence[Mapping[str, Any]]
) -> list[Finding]:
    """Say which cameras no chain of pairs joins that see something together.

    pairs: of the report. Cameras that see nothing together with any other are left out.
    """
    groups = [{view.camera} for view in usable]
    for pair in pairs:
        if pair["covisible"]:
            joined = [group for group in groups if group & _names(pair)]
            groups = [group for group in groups if group not in joined] + [set().union(*joined)]
    groups = [group for group in groups if len(group) > 1]
    if len(groups) < 2:
        return []
    in_order = [[view.camera for view in usable if view.camera in group] for group in groups]
    listed = " | ".join(", ".join(names) for names in in_order)
    return [
        warning(
            f"{len(groups)} groups of cameras see nothing in the same frames ({listed}), and will "
            "be calibrated each by itself; let somebody go from one to the other"
        )
    ]


def _names(pair: Mapping[str, Any]) -> set[str]:
    """Return the names of the two cameras of a pair of the report."""
    return {pair["a"], pair["b"]}


def _find_lonely_cameras(
    usable: Sequence[Keypoints2D], pairs: Sequence[Mapping[str, Any]]
) -> list[Finding]:
    """Name the cameras that see nothing together with another. pairs: of the report."""
    covisible = [pair for pair in pairs if pair["covisible"]]
    in_company = {pair[side] for pair in covisible for side in ("a", "b")}
    return [
        warning(
            f"{view.camera}: sees nothing in a frame in which another camera does, "
            "and will be left out; check its frame numbers"
        )
        for view in usable
        if view.camera not in in_company
    ]


def _find_other_frames(usable: Sequence[Keypoints2D]) -> list[Finding]:
    """Say where the frame numbers of the views differ, and whether some may count from 1."""
    starts = {int(view.frames[0]) for view in usable}
    lengths = {len(view.frames) for view in usable}
    ranges = _frame_ranges(usable)
    first, second = min(starts), max(starts)
    if len(starts) == 2 and second - first == 1 and len(lengths) == 1:
        late = next(view.camera for view in usable if view.frames[0] == second)
        return [
            warning(
                f"equally long recordings start at frame {first} and at frame {second} "
                f"({ranges}); say {argument('frame_offset', f'{late}:-1')} for each such camera, "
                "if they count from 1"
            )
        ]
    ends = {(int(view.frames[0]), int(view.frames[-1])) for view in usable}
    if len(ends) == 1:
        return []
    return [
        warning(
            f"the cameras' frames differ ({ranges}); only frames that two of them have are used"
        )
    ]


def _frame_ranges(usable: Sequence[Keypoints2D]) -> str:
    """Return the first and the last frame number of each view as a text."""
    return ", ".join(f"{view.camera} {view.frames[0]}-{view.frames[-1]}" for view in usable)


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


_STEPS = 6  # of reweighting


def homography_errors(points: Floats, images: Floats) -> Floats:
    """Return the errors `[N]` of the homography that maps most points to their images.

    By direct linear transform (Hartley and Zisserman 2004, section 4.1), reweighted by Cauchy's
    loss at two medians.

    points, images: `[N, 2]`; the errors are in the unit of the images.
    """
    (points, _), (images, scale) = _normalise(points), _normalise(images)
    points = np.column_stack([points, np.ones(len(points))])
    weight, depth = np.ones(len(points)), np.ones(len(points))
    for _ in range(_STEPS):
        rows = np.zeros((2, len(points), 9))
        rows[0, :, :3], rows[1, :, 3:6] = points, points
        rows[..., 6:] = -images.T[..., None] * points
        rows *= (np.sqrt(weight) / depth)[:, None]
        flat = rows.reshape(-1, 9)
        matrix = np.linalg.eigh(flat.T @ flat)[1][:, 0].reshape(3, 3)
        mapped = points @ matrix.T
        depth = np.maximum(np.abs(mapped[:, 2]), 1e-9)
        mapped = mapped[:, :2] / np.where(mapped[:, 2:] < 0, -depth[:, None], depth[:, None])
        error = np.linalg.norm(mapped - images, axis=1)
        weight = 1 / (1 + (error / (2 * np.median(error) + 1e-12)) ** 2)
    return np.asarray(error * scale)


def _normalise(points: Floats) -> tuple[Floats, float]:
    """Return points `[n, 2]` about their middle in units of their usual distance, and this unit."""
    offset = points - np.median(points, axis=0)
    scale = float(np.median(np.linalg.norm(offset, axis=1))) + 1e-12
    return offset / scale, scale
