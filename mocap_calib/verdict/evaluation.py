"""Compare a rig with a reference, or with a rig that was adjusted anew.

The calibration and the adjusted rig differ by a similarity, which means nothing, by what the
keypoints leave open, which the covariance of the adjustment has, by what models of lenses and
detectors do not know, which all cameras share, and where a camera was moved. Cameras are set free
one after the other until the rest agree: a camera was moved where the rest agree so much better
without it that chance does not explain it (Fisher's ratio of variances).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np

from mocap_calib.config import RIG_ERROR_THRESHOLDS_DEG, SOUND_DEG, VERDICT_LIMITS_DEG
from mocap_calib.errors import MismatchError
from mocap_calib.geometry.rotation import (
    align_by_similarity,
    angle_between,
    direction_angle,
    gauge_of,
    rig_size,
    vector_from_matrix,
)
from mocap_calib.results import RigCovariance
from mocap_calib.types import POSE, Bools, CameraRig, Floats, Record, Views

# Points on the cameras' axes take part in the alignment, so near to the centres (in spreads of the
# centres) that they decide only what the centres leave open.
_AXIS_LENGTH = 1e-3

# Chance that any camera of a rig that did not move is said to have moved, if the errors of the rest
# were normal: a ratio of variances of 29, 10, 7 and 6 for 3, 4, 5 and 6 cameras. Measured by
# references of fifteen recordings: 0.2 to 5.2, and 69 of a mouse whose cameras are not determined,
# where none is named; where one camera is turned by 1 degree, 10 and more in nine of them (medians
# 32 to 280), median 11 in one of few keypoints (Pose2Sim), and 1.5 to 4 where references differ by
# 2 to 6 degrees from ours.
_FALSE_NAME = 3e-3
# Of two cameras, with no third one to compare with, from which on they do not go together.
# Measured: 0.3 to 2.2 in eleven recordings, 3 to 5.5 in three whose references differ from ours.
_PAIR_MISFIT = 6.0
_UNKNOWN_DEG = 0.02  # what models of lenses and detectors do not know of any camera, at least


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation(Record):
    """A rig against a reference.

    names: cameras of the reference that the rig has.
    missing: cameras of the reference that the rig lacks.
    pairs: `[pair]` names of all pairs of the reference's cameras.
    rotation_error: `[pair]` radians between the relative rotations, pi where a camera is missing.
    translation_error: `[pair]` radians between the directions of the relative translations, pi
        where a camera is missing.
    camera_rotation: `[camera]` radians between the rotations, after an alignment of the centres.
    centre_error: `[camera]` distance of the centres in the reference's unit, after the alignment.
    unit: of the reference.
    """

    names: tuple[str, ...]
    missing: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    rotation_error: Floats
    translation_error: Floats
    camera_rotation: Floats
    centre_error: Floats
    unit: str


def evaluate(rig: CameraRig, reference: CameraRig) -> Evaluation:
    """Compare all pairs of the reference's cameras, and the cameras after an alignment.

    The alignment is a similarity: rotation, translation and scale. Raises MismatchError where the
    rig has fewer than two cameras of the reference.
    """
    names = tuple(sorted(name for name in reference.names if name in rig.names))
    if len(names) < 2:
        raise MismatchError(
            "",
            f"at least two cameras of the reference ({', '.join(reference.names)})",
            ", ".join(rig.names),
            "match their names",
        )
    pairs = tuple(combinations(sorted(reference.names), 2))
    errors = np.array([_pair_error(rig, reference, a, b) for a, b in pairs])
    found, true = lay_over(rig.select(names), reference, names), reference.select(names)
    return Evaluation(
        names=names,
        missing=tuple(sorted(set(reference.names) - set(names))),
        pairs=pairs,
        rotation_error=errors[:, 0],
        translation_error=errors[:, 1],
        camera_rotation=angle_between(found.rotation, true.rotation),
        centre_error=np.linalg.norm(found.centres - true.centres, axis=1),
        unit=reference.unit,
    )


def lay_over(rig: CameraRig, reference: CameraRig, views: Views) -> CameraRig:
    """Return a rig in the world of a reference, as some views have it in both.

    By the best similarity; views: indices or names, of both alike.
    """
    points, targets = (with_axes(each.select(views)).reshape(-1, 3) for each in (rig, reference))
    scale, turn, shift = align_by_similarity(points, targets)
    centres = scale * rig.centres @ turn.T + shift
    return replace(rig, unit=reference.unit).stand(rig.rotation @ turn.T, centres)


def with_axes(rig: CameraRig) -> Floats:
    """Return the centre of each camera, and near it six points on its axes, `[camera, 7, 3]`.

    Where the centres are on a line, those of two cameras for instance, they leave the rotation
    about it open, and the axes decide.
    """
    offset = rig.centres - rig.centres.mean(0)
    spread = np.sqrt((offset**2).sum(1).mean())
    # rows of cam_from_world are the camera's axes in world coordinates
    axes, centres = _AXIS_LENGTH * spread * rig.rotation, rig.centres[:, None]
    return np.concatenate([centres, centres + axes, centres - axes], axis=1)


def _pair_error(rig: CameraRig, reference: CameraRig, a: str, b: str) -> tuple[float, float]:
    """Return the angles in radians between rotations and between directions of b_from_a.

    pi where the rig lacks one of the two cameras.
    """
    if not {a, b} <= set(rig.names):
        return np.pi, np.pi
    turn, way = rig.select((a, b)).relative(0, 1)
    true_turn, true_way = reference.select((a, b)).relative(0, 1)
    return float(angle_between(turn, true_turn)), float(direction_angle(way, true_way))


def accuracy(error: Floats, degrees: float) -> float:
    """Return the share of pairs whose error `[pair]` (radians) is below a threshold: RRA, RTA."""
    return float((np.degrees(error) < degrees).mean())


def area_under_curve(rotation_error: Floats, translation_error: Floats, degrees: int) -> float:
    """Return AUC@degrees: the mean of min(RRA, RTA) at the thresholds 1, 2, ..., degrees.

    rotation_error, translation_error: `[pair]` in radians. As in DUSt3R (Wang et al. 2024).
    """
    accuracies = [
        min(accuracy(rotation_error, threshold), accuracy(translation_error, threshold))
        for threshold in range(1, degrees + 1)
    ]
    return float(np.mean(accuracies))


def evaluation_to_dict(evaluation: Evaluation) -> dict[str, Any]:
    """Return the figures under the keys of `mocap-calib evaluate --json`; angles in degrees."""
    rotation, translation = evaluation.rotation_error, evaluation.translation_error
    degrees = (np.degrees(each).tolist() for each in (rotation, translation))
    return {
        "pairs": [
            {"a": a, "b": b, "rotation_error_deg": turn, "translation_error_deg": direction}
            for (a, b), turn, direction in zip(evaluation.pairs, *degrees, strict=True)
        ],
        "rotation_error_deg": median_and_max(np.degrees(rotation)),
        "translation_error_deg": median_and_max(np.degrees(translation)),
        "rra": {str(t): accuracy(rotation, t) for t in RIG_ERROR_THRESHOLDS_DEG},
        "rta": {str(t): accuracy(translation, t) for t in RIG_ERROR_THRESHOLDS_DEG},
        "auc": {
            str(t): area_under_curve(rotation, translation, t) for t in RIG_ERROR_THRESHOLDS_DEG
        },
        "camera_rotation_error_deg": median_and_max(np.degrees(evaluation.camera_rotation)),
        "centre_error": median_and_max(evaluation.centre_error),
        "unit": evaluation.unit,
        "cameras": list(evaluation.names),
        "missing": list(evaluation.missing),
    }


def median_and_max(values: Floats) -> dict[str, float]:
    """Return the median and the maximum of values `[N]`."""
    return {"median": float(np.median(values)), "max": float(np.max(values))}


# --- which cameras differ


@dataclass(frozen=True)
class RigChange:
    """How a rig that was adjusted anew differs from the calibration that was given.

    moved: `[view]` cameras that are elsewhere than the others have them. Of two cameras it is not
        known which one moved: both or none.
    size, sigma: `[view, 2]` turn (radians) and shift (rig sizes) by which a camera is elsewhere, if
        it and the moved ones alone may, and their RMS errors. Shifts are NaN where a single other
        camera is left: two are aligned at any distance.
    refitted: the rig that was adjusted, in the coordinates and the unit of the given one.
    """

    moved: Bools
    size: Floats
    sigma: Floats
    refitted: CameraRig


def find_changes(
    given: CameraRig,
    adjusted: CameraRig,
    covariances: tuple[RigCovariance, RigCovariance],
) -> RigChange:
    """Return which cameras moved between two rigs of the same cameras, and by how much.

    covariances: of the adjusted rig, as of `cautious_covariances`. That of independent errors has
        the shape which says best what the images show, the other one the size that errors have.
    """
    views, size = range(len(given)), POSE * len(given)
    real, independent = (each.matrix.reshape(size, size) for each in covariances)
    excess = max(1.0, np.trace(real) / np.trace(independent))
    shared = np.deg2rad(_UNKNOWN_DEG) ** 2 * np.eye(size)
    moves = partial(_find_moves, given, adjusted, excess * independent + shared)
    moved = _find_moved(moves, len(given))
    alone = [moves([*(each for each in moved if each != view), view]) for view in views]
    is_moved = np.isin(views, moved)
    if len(given) == 2:
        turn = np.rad2deg(angle_between(given.relative(0, 1)[0], adjusted.relative(0, 1)[0]))
        is_moved |= turn > VERDICT_LIMITS_DEG[0] and moves([]).misfit > _PAIR_MISFIT
    return RigChange(
        moved=is_moved,
        size=np.array([each.size[-1] for each in alone]),
        sigma=np.array([each.sigma[-1] for each in alone]),
        refitted=lay_over(adjusted, given, np.setdiff1d(views, moved)),
    )


@dataclass(frozen=True)
class _Moves:
    """How some cameras moved between two rigs, as the others have them.

    misfit: RMS of what the others differ by, in standard deviations.
    size, sigma: `[camera, 2]` as of `RigChange`. chance: `[camera]` how likely one that was not
    moved would differ as much, by Fisher's ratio of variances.
    """

    misfit: float
    size: Floats
    sigma: Floats
    chance: Floats


def _find_moves(
    given: CameraRig, adjusted: CameraRig, covariance: Floats, free: Sequence[int]
) -> _Moves:
    """Return how some views (indices) moved, by generalised least squares.

    covariance: `[6 view, 6 view]` of the difference of the rigs. Where a single other view is left,
    the last one shows as well how the rigs lie to each other.
    """
    from scipy.special import fdtrc  # noqa: PLC0415 - 0.2 s, which no other command needs

    rest = np.setdiff1d(range(len(given)), free)
    before = lay_over(given, adjusted, rest if len(rest) > 1 else np.append(rest, free[-1]))
    turn = vector_from_matrix(np.swapaxes(adjusted.rotation, 1, 2) @ before.rotation)
    shift = (before.centres - adjusted.centres) / rig_size(adjusted)
    difference = np.concatenate([turn, shift], axis=1).ravel()
    size = len(difference)
    own = np.eye(size).reshape(size, -1, POSE)[:, list(free)].reshape(size, -1)
    gauge = gauge_of(adjusted).reshape(size, -1)
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    design = whiten @ np.concatenate([own, gauge], axis=1)
    inverse = np.linalg.pinv(design)
    found = inverse @ whiten @ difference
    degrees = size - design.shape[1]
    misfit = float(np.linalg.norm(whiten @ difference - design @ found) / np.sqrt(max(degrees, 1)))
    # the errors hold also where the others disagree by more than they should
    excess = max(1.0, misfit**2)
    move, by_camera = found[: own.shape[1]].reshape(-1, POSE), inverse[: own.shape[1]]
    by_camera = by_camera.reshape(-1, POSE, size)
    errors = excess * by_camera @ by_camera.swapaxes(1, 2)
    ratio = np.einsum("ci,cij,cj->c", move, np.linalg.pinv(errors, hermitian=True), move)
    variance = np.einsum("cii->ci", errors)
    unknown = [1.0, np.nan if len(rest) < 2 else 1.0]
    return _Moves(
        misfit=misfit,
        size=np.linalg.norm(move.reshape(-1, 2, 3), axis=2) * unknown,
        sigma=np.sqrt(variance.reshape(-1, 2, 3).sum(2)) * unknown,
        chance=np.asarray(fdtrc(POSE, degrees, ratio / POSE)),
    )


def _find_moved(moves: Callable[[Sequence[int]], _Moves], views: int) -> list[int]:
    """Return the views that certainly moved, and by enough to matter; of two cameras none.

    Those that explain most of the difference are set free, one after the other, until half of the
    cameras, and two, are left: if more moved it is another rig. Then the least certain one is put
    back until all are certain.

    moves: of some views (indices). views: how many there are.
    """
    free = list[int]()
    while len(free) < min((views - 1) // 2, views - 2):
        rest = np.setdiff1d(range(views), free).tolist()
        free.append(min(rest, key=lambda view: moves([*free, view]).misfit))
    while free:
        found = moves(free)
        small = found.size.max(1) < np.deg2rad(SOUND_DEG / 2)  # less is no reason for a verdict
        chance = np.where(small, 1.0, found.chance)
        if chance.max() * views < _FALSE_NAME:
            break
        del free[int(chance.argmax())]
    return free
