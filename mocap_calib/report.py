"""A calibration -> numbers: how it compares with a reference, and all that a run has to say of itself."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any

import numpy as np

from mocap_calib import __version__
from mocap_calib.config import Config
from mocap_calib.errors import MismatchError
from mocap_calib.geometry.alignment import similarity
from mocap_calib.geometry.projection import pixels_from_points
from mocap_calib.geometry.rotation import angle_between, direction_angle
from mocap_calib.types import Calibration, CameraRig, Floats, PairwiseCalibration

THRESHOLDS = (5, 10, 20, 30)
_BREAKS = 0.25  # a pair of less weight than this breaks the loops


@dataclass(frozen=True)
class Evaluation:
    """A rig against a reference.

    names: cameras of the reference that the rig has; missing: those it lacks. pairs: `[pair, 2]` names of all pairs of
    the reference. rotation_error, translation_error: `[pair]` radians, pi where a camera is missing. camera_rotation:
    `[camera]` radians and centre_error: `[camera]` in the reference's unit, after a similarity alignment of the centres.
    """

    names: tuple[str, ...]
    missing: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    rotation_error: Floats
    translation_error: Floats
    camera_rotation: Floats
    centre_error: Floats
    unit: str


def evaluate_rig(rig: CameraRig, reference: CameraRig) -> Evaluation:
    """Compares all pairs of cameras of the reference, and the cameras after an alignment. Raises MismatchError."""
    names = tuple(sorted(name for name in reference.names if name in rig.names))
    missing = tuple(sorted(set(reference.names) - set(names)))
    if len(names) < 2:
        raise MismatchError(f"expected at least two cameras of the reference ({', '.join(reference.names)}), found {', '.join(rig.names)}; match their names")
    pairs = tuple(combinations(sorted(reference.names), 2))
    errors = [_pair_error(rig, reference, *pair) if set(pair) <= set(names) else (np.pi, np.pi) for pair in pairs]
    found, true = _select(rig, names), _select(reference, names)
    scale, turn, shift = similarity(found.centres, true.centres)
    if len(names) == 2:  # two centres leave the roll about their line open: the first camera's axes settle it
        turn = true.rotation[0].T @ found.rotation[0]
        shift = true.centres[0] - scale * turn @ found.centres[0]
    centre = np.linalg.norm(scale * found.centres @ turn.T + shift - true.centres, axis=1)
    rotation = angle_between(found.rotation @ turn.T, true.rotation)
    return Evaluation(names, missing, pairs, np.array([e[0] for e in errors]), np.array([e[1] for e in errors]), rotation, centre, reference.unit)


def _select(rig: CameraRig, names: tuple[str, ...]) -> CameraRig:
    index = [rig.names.index(name) for name in names]
    return CameraRig(tuple(rig.cameras[k] for k in index), rig.rotation[index], rig.translation[index], rig.unit)


def _pair_error(rig: CameraRig, reference: CameraRig, a: str, b: str) -> tuple[float, float]:
    """Angles in radians between the rotations and between the directions of translation of b_from_a."""
    (found, moved), (true, shift) = _relative(rig, a, b), _relative(reference, a, b)
    return float(angle_between(found, true)), float(direction_angle(moved, shift))


def _relative(rig: CameraRig, a: str, b: str) -> tuple[Floats, Floats]:
    i, j = rig.names.index(a), rig.names.index(b)
    rotation = rig.rotation[j] @ rig.rotation[i].T
    return rotation, rig.translation[j] - rotation @ rig.translation[i]


def accuracy(error: Floats, degrees: float) -> float:
    """Share of pairs with an error below a threshold: RRA and RTA."""
    return float((np.degrees(error) < degrees).mean())


def area_under_curve(rotation_error: Floats, translation_error: Floats, degrees: int) -> float:
    """AUC@tau: mean over the thresholds 1, 2, ..., tau of min(RRA, RTA), as in DUSt3R (Wang et al. 2024)."""
    return float(np.mean([min(accuracy(rotation_error, t), accuracy(translation_error, t)) for t in range(1, degrees + 1)]))


def evaluation_to_dict(found: Evaluation) -> dict[str, Any]:
    """The figures under the keys of `mocap-calib evaluate --json`; angles in degrees."""
    rotation, translation = np.degrees(found.rotation_error), np.degrees(found.translation_error)
    rows = zip(found.pairs, rotation.tolist(), translation.tolist(), strict=True)
    return {
        "pairs": [{"a": a, "b": b, "rotation_error_deg": r, "translation_error_deg": t} for (a, b), r, t in rows],
        "rotation_error_deg": _middle(rotation),
        "translation_error_deg": _middle(translation),
        "rra": {str(t): accuracy(found.rotation_error, t) for t in THRESHOLDS},
        "rta": {str(t): accuracy(found.translation_error, t) for t in THRESHOLDS},
        "auc": {str(t): area_under_curve(found.rotation_error, found.translation_error, t) for t in THRESHOLDS},
        "camera_rotation_error_deg": _middle(np.degrees(found.camera_rotation)),
        "centre_error": _middle(found.centre_error),
        "unit": found.unit,
        "cameras": list(found.names),
        "missing": list(found.missing),
    }


def _middle(values: Floats) -> dict[str, float]:
    return {"median": float(np.median(values)), "max": float(np.max(values))}


def run_report(found: Calibration, *, seed: int, config: Config, inputs: Mapping[str, str]) -> dict[str, Any]:
    """All numbers of a run, as run.json holds them. inputs: path -> SHA-256. What is not known is None."""
    recording, rig, labels = found.recording, found.rig, found.matches.labels
    points = np.isfinite(found.poses.error)
    return {
        "version": __version__,
        "seed": seed,
        "config": asdict(config),
        "inputs": dict(inputs),
        "seconds": {stage: round(seconds, 3) for stage, seconds in found.seconds.items()},
        "unit": rig.unit,
        "frames": {"first": int(recording.frames[0]), "last": int(recording.frames[-1]), "count": len(recording.frames)},
        "keypoints": list(recording.keypoints),
        "left_out": list(found.left_out),
        "cameras": [_camera_report(found, view, error) for view, error in enumerate(_view_errors(found))],
        "pairs": [_pair_report(found, k, pair) for k, pair in enumerate(found.pairs)],
        "adjust": {"rounds": found.rounds, "converged": found.converged},
        "individuals": [{"individual": k, "frames": int((labels == k).any((0, 2)).sum())} for k in range(found.matches.individuals)],
        "points": {"triangulated": int(points.sum()), "reprojection_error_px": _spread(found.poses.error[points])},
    }


def _view_errors(found: Calibration) -> list[Floats]:
    """Per view the distances in pixels of all labelled detections from the triangulated points."""
    rig, poses, recording = found.rig, found.poses, found.recording
    errors = []
    for view, camera in enumerate(rig.cameras):
        frame, instance = np.nonzero(found.matches.labels[view] >= 0)
        points = poses.positions[frame, found.matches.labels[view, frame, instance]]
        image = pixels_from_points(camera, points @ rig.rotation[view].T + rig.translation[view])
        gap = np.linalg.norm(image - recording.positions[view, frame, instance], axis=-1)
        errors.append(gap[np.isfinite(gap)])
    return errors


def _camera_report(found: Calibration, view: int, error: Floats) -> dict[str, Any]:
    there = found.recording.seen[view].any(-1)
    matched = there & (found.matches.labels[view] >= 0)
    return {
        "name": found.rig.names[view],
        "frames": int(there.any(-1).sum()),
        "detections": int(there.sum()),
        "matched": int(matched.sum()),
        "unmatched": int((there & ~matched).sum()),
        "reprojection_error_px": _spread(error),
    }


def _pair_report(found: Calibration, number: int, pair: PairwiseCalibration) -> dict[str, Any]:
    cameras, averaged = found.rig.cameras, found.averaged
    focal = (cameras[pair.a].focal + cameras[pair.b].focal) / 2
    return {
        "a": cameras[pair.a].name,
        "b": cameras[pair.b].name,
        "frames": pair.frames,
        "matches": len(pair.matches),
        "score": pair.score,
        "source": pair.source,
        "in_front": pair.in_front,
        "epipolar_error_deg": _number(np.degrees(pair.residual)),
        "epipolar_error_px": _number(pair.residual * focal),
        "baseline": float(np.linalg.norm(pair.translation)),
        "loop_rotation_deg": float(np.degrees(averaged.loop_error[number])),
        "loop_translation_deg": float(np.degrees(averaged.translation_error[number])),
        "weight": float(averaged.weight[number]),
        "breaks_loop": bool(averaged.weight[number] < _BREAKS),
    }


def _spread(values: Floats) -> dict[str, float | None]:
    if not len(values):
        return {"median": None, "p95": None}
    return {"median": float(np.median(values)), "p95": float(np.percentile(values, 95))}


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
