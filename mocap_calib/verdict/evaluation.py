"""Compare a rig with a reference."""

from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from mocap_calib.config import RIG_ERROR_THRESHOLDS_DEG
from mocap_calib.errors import MismatchError
from mocap_calib.geometry.alignment import align_by_similarity
from mocap_calib.geometry.rotation import angle_between, direction_angle
from mocap_calib.records import Record
from mocap_calib.types import CameraRig, Floats, Views

# Points on the cameras' axes take part in the alignment, so near to the centres (in spreads of the
# centres) that they decide only what the centres leave open.
_AXIS_LENGTH = 1e-3


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

    def __repr__(self) -> str:
        rotation = _median_and_max_text(np.degrees(self.rotation_error))
        translation = _median_and_max_text(np.degrees(self.translation_error))
        missing = f", missing: {', '.join(self.missing)}" if self.missing else ""
        return (
            f"Evaluation({len(self.pairs)} pairs, median / max: rotation {rotation} deg, "
            f"translation {translation} deg{missing})"
        )


def evaluate(rig: CameraRig, reference: CameraRig) -> Evaluation:
    """Compare all pairs of the reference's cameras, and the cameras after an alignment.

    The alignment is a similarity: rotation, translation and scale. Raises MismatchError where the
    rig has fewer than two cameras of the reference.
    """
    names = tuple(sorted(name for name in reference.names if name in rig.names))
    if len(names) < 2:
        raise MismatchError(
            f"expected at least two cameras of the reference ({', '.join(reference.names)}), "
            f"found {', '.join(rig.names)}; match their names"
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
    points, targets = (with_axes(each.select(views)) for each in (rig, reference))
    scale, turn, shift = align_by_similarity(points, targets)
    centres = scale * rig.centres @ turn.T + shift
    return replace(rig, unit=reference.unit).stand(rig.rotation @ turn.T, centres)


def with_axes(rig: CameraRig) -> Floats:
    """Return the centres, and near each six points on the camera's axes, `[7 camera, 3]`.

    Where the centres are on a line, those of two cameras for instance, they leave the rotation
    about it open, and the axes decide.
    """
    offset = rig.centres - rig.centres.mean(0)
    spread = np.sqrt((offset**2).sum(1).mean())
    # rows of cam_from_world are the camera's axes in world coordinates
    axes = _AXIS_LENGTH * spread * rig.rotation.reshape(-1, 3)
    origins = np.repeat(rig.centres, 3, axis=0)
    return np.concatenate([rig.centres, origins + axes, origins - axes])


def _pair_error(rig: CameraRig, reference: CameraRig, a: str, b: str) -> tuple[float, float]:
    """Return the angles in radians between rotations and between directions of b_from_a.

    pi where the rig lacks one of the two cameras.
    """
    if not {a, b} <= set(rig.names):
        return np.pi, np.pi
    rotation, translation = _relative_named(rig, a, b)
    true_rotation, true_translation = _relative_named(reference, a, b)
    rotation_error = angle_between(rotation, true_rotation)
    translation_error = direction_angle(translation, true_translation)
    return float(rotation_error), float(translation_error)


def _relative_named(rig: CameraRig, a: str, b: str) -> tuple[Floats, Floats]:
    """Return R `[3, 3]` and t `[3]` of b_from_a, for the cameras named a and b."""
    return rig.relative(rig.names.index(a), rig.names.index(b))


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
    return {
        "pairs": _pairs_to_list(evaluation),
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


def _pairs_to_list(evaluation: Evaluation) -> list[dict[str, Any]]:
    """Return the errors of each pair in degrees."""
    rotation = np.degrees(evaluation.rotation_error).tolist()
    translation = np.degrees(evaluation.translation_error).tolist()
    return [
        {"a": a, "b": b, "rotation_error_deg": turn, "translation_error_deg": direction}
        for (a, b), turn, direction in zip(evaluation.pairs, rotation, translation, strict=True)
    ]


def _median_and_max_text(values: Floats) -> str:
    """Return the median and the maximum of values `[N]` as `0.12 / 0.34`."""
    return f"{np.median(values):.2f} / {values.max():.2f}"


def median_and_max(values: Floats) -> dict[str, float]:
    """Return the median and the maximum of values `[N]`."""
    return {"median": float(np.median(values)), "max": float(np.max(values))}
