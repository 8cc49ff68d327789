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
from mocap_calib.geometry.rotation import angle_between, direction_angle
from mocap_calib.multi_view.triangulation import observations, project
from mocap_calib.multi_view.uncertainty import verdict
from mocap_calib.multi_view.view_graph import alternative_taken
from mocap_calib.recording.sampling import evenly_spaced
from mocap_calib.types import CalibrationResult, CameraRig, Floats, GroupResult, PairwiseCalibration

THRESHOLDS = (5, 10, 20, 30)
_SAMPLE = 2000  # frames whose reprojection errors are reported


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
        raise MismatchError(
            f"expected at least two cameras of the reference ({', '.join(reference.names)}), found {', '.join(rig.names)}; match their names"
        )
    pairs = tuple(combinations(sorted(reference.names), 2))
    errors = [
        _pair_error(rig, reference, *pair) if set(pair) <= set(names) else (np.pi, np.pi)
        for pair in pairs
    ]
    found, true = (
        each.select(np.array([each.names.index(name) for name in names]))
        for each in (rig, reference)
    )
    scale, turn, shift = similarity(_with_axes(found), _with_axes(true))
    centre = np.linalg.norm(scale * found.centres @ turn.T + shift - true.centres, axis=1)
    rotation = angle_between(found.rotation @ turn.T, true.rotation)
    return Evaluation(
        names,
        missing,
        pairs,
        np.array([e[0] for e in errors]),
        np.array([e[1] for e in errors]),
        rotation,
        centre,
        reference.unit,
    )


def _with_axes(rig: CameraRig) -> Floats:
    """`[7 camera, 3]` the centres, and points along the cameras' axes so near to them that they decide only what the centres leave open.

    Centres on a line, those of two cameras for instance, leave the turn about it open.
    """
    spread = np.sqrt(((rig.centres - rig.centres.mean(0)) ** 2).sum(1).mean())
    axes = (
        1e-3 * spread * rig.rotation.reshape(-1, 3)
    )  # rows of cam_from_world are the camera's axes in the world
    near = np.repeat(rig.centres, 3, axis=0)
    return np.concatenate([rig.centres, near + axes, near - axes])


def _pair_error(rig: CameraRig, reference: CameraRig, a: str, b: str) -> tuple[float, float]:
    """Angles in radians between the rotations and between the directions of translation of b_from_a."""
    (found, moved), (true, shift) = (
        each.relative(each.names.index(a), each.names.index(b)) for each in (rig, reference)
    )
    return float(angle_between(found, true)), float(direction_angle(moved, shift))


def accuracy(error: Floats, degrees: float) -> float:
    """Share of pairs with an error below a threshold: RRA and RTA."""
    return float((np.degrees(error) < degrees).mean())


def area_under_curve(rotation_error: Floats, translation_error: Floats, degrees: int) -> float:
    """AUC@tau: mean over the thresholds 1, 2, ..., tau of min(RRA, RTA), as in DUSt3R (Wang et al. 2024)."""
    return float(
        np.mean(
            [
                min(accuracy(rotation_error, t), accuracy(translation_error, t))
                for t in range(1, degrees + 1)
            ]
        )
    )


def evaluation_to_dict(found: Evaluation) -> dict[str, Any]:
    """The figures under the keys of `mocap-calib evaluate --json`; angles in degrees."""
    rotation, translation = np.degrees(found.rotation_error), np.degrees(found.translation_error)
    rows = zip(found.pairs, rotation.tolist(), translation.tolist(), strict=True)
    return {
        "pairs": [
            {"a": a, "b": b, "rotation_error_deg": r, "translation_error_deg": t}
            for (a, b), r, t in rows
        ],
        "rotation_error_deg": _middle(rotation),
        "translation_error_deg": _middle(translation),
        "rra": {str(t): accuracy(found.rotation_error, t) for t in THRESHOLDS},
        "rta": {str(t): accuracy(found.translation_error, t) for t in THRESHOLDS},
        "auc": {
            str(t): area_under_curve(found.rotation_error, found.translation_error, t)
            for t in THRESHOLDS
        },
        "camera_rotation_error_deg": _middle(np.degrees(found.camera_rotation)),
        "centre_error": _middle(found.centre_error),
        "unit": found.unit,
        "cameras": list(found.names),
        "missing": list(found.missing),
    }


def _middle(values: Floats) -> dict[str, float]:
    return {"median": float(np.median(values)), "max": float(np.max(values))}


def run_report(
    found: GroupResult,
    result: CalibrationResult,
    *,
    seed: int,
    config: Config,
    inputs: Mapping[str, str],
) -> dict[str, Any]:
    """All numbers of a run, as run.json holds them. inputs: path -> SHA-256. What is not known is None."""
    recording, rig, labels = found.recording, found.rig, found.matches.labels
    points = np.isfinite(found.poses.error)
    errors = _errors(found)
    support = _support(found)
    return {
        "version": __version__,
        "seed": seed,
        "config": asdict(config),
        "inputs": dict(inputs),
        "seconds": {stage: round(seconds, 3) for stage, seconds in found.seconds.items()},
        "unit": rig.unit,
        "frames": {
            "first": int(recording.frames[0]),
            "last": int(recording.frames[-1]),
            "count": len(recording.frames),
        },
        "keypoints": list(recording.keypoints),
        "left_out": list(result.left_out),
        "unused_pairs": [asdict(pair) for pair in result.unused_pairs],
        "cameras": [
            _camera_report(found, view, errors[view]) | _verdict(support[view], config)
            for view in range(len(rig.cameras))
        ],
        "pairs": [
            _pair_report(found, k, pair, errors[[pair.a, pair.b]], config)
            for k, pair in enumerate(found.pairs)
        ],
        "verdict": {
            "rig": verdict(found.uncertainty.split_half_angle, found.uncertainty.outlier_cameras),
            "halves_differ_deg": _middle(np.degrees(found.uncertainty.split_half_angle)),
            "reversal": "none found"
            if found.adjusted.depth_reversed_rig is None
            else "not observable",
            "translation": "not observable"
            if found.uncertainty.weak_perspective.any()
            else "observed",
        },
        "adjust": {"rounds": found.adjusted.rounds, "converged": found.adjusted.converged},
        "individuals": [
            {"individual": k, "frames": int((labels == k).any((0, 2)).sum())}
            for k in range(found.matches.individuals)
        ],
        "points": {
            "triangulated": int(points.sum()),
            "reprojection_error_px": _spread(found.poses.error[points]),
        },
    }


def _errors(found: GroupResult) -> Floats:
    """`[view, frame, individual, keypoint]` distance in pixels of the labelled detections from the triangulated points.

    Of an even sample of the frames: a report of a long recording need not cost its length in memory.
    """
    rig, recording = found.rig, found.recording
    frames = evenly_spaced(np.arange(len(recording.frames)), _SAMPLE)
    pixels = observations(recording, found.matches, frames).pixels
    points = found.poses.positions[frames]
    images = [
        project(camera, rig.rotation[v], rig.translation[v], points.reshape(-1, 3).T)
        for v, camera in enumerate(rig.cameras)
    ]
    return np.linalg.norm(np.stack(images) - pixels, axis=1).reshape(len(images), *points.shape[:3])


def _support(found: GroupResult) -> list[float]:
    """The score of each camera's best pair: what it stands on."""
    return [
        max(p.score for p in found.pairs if view in (p.a, p.b))
        for view in range(len(found.rig.cameras))
    ]


def _verdict(support: float, config: Config) -> dict[str, Any]:
    return {"support": support, "weak": support < config.averaging.weak_score}


def _camera_report(found: GroupResult, view: int, error: Floats) -> dict[str, Any]:
    there = found.recording.seen[view].any(-1)
    matched = there & (found.matches.labels[view] >= 0)
    return {
        "name": found.rig.names[view],
        "frames": int(there.any(-1).sum()),
        "detections": int(there.sum()),
        "matched": int(matched.sum()),
        "unmatched": int((there & ~matched).sum()),
        "inconsistent": bool(found.uncertainty.outlier_cameras[view]),
        "near_affine": bool(found.uncertainty.weak_perspective[view]),
        "reprojection_error_px": _spread(error),
    }


def _pair_report(
    found: GroupResult, number: int, pair: PairwiseCalibration, error: Floats, config: Config
) -> dict[str, Any]:
    """What the pair by itself said, how far it is from the rig, and, last, what the rig makes of the points that both views see."""
    cameras, averaged, labels = found.rig.cameras, found.averaged, found.matches.labels
    focal = (cameras[pair.a].focal + cameras[pair.b].focal) / 2
    together = (labels[pair.a][:, :, None] == labels[pair.b][:, None]) & (
        labels[pair.a][:, :, None] >= 0
    )
    both = np.isfinite(error).all(0)
    return {
        "a": cameras[pair.a].name,
        "b": cameras[pair.b].name,
        "frames": pair.frames,
        "matches": int(together.sum()),
        "reprojection_error_px": _spread(error[:, both].ravel()),
        "sampled_matches": len(pair.matches),
        "score": pair.score,
        "source": pair.source,
        "in_front": pair.in_front,
        "epipolar_error_deg": _number(np.degrees(pair.residual)),
        "epipolar_error_px": _number(pair.residual * focal),
        "baseline_body_sizes": float(np.linalg.norm(pair.translation)),
        "loop_rotation_deg": float(np.degrees(averaged.loop_error[number])),
        "loop_translation_deg": float(np.degrees(averaged.translation_error[number])),
        "weight": float(averaged.weight[number]),
        "breaks_loop": bool(averaged.weight[number] < config.averaging.breaks),
        "alternative_taken": alternative_taken(pair),
        "alternatives": [
            {
                "score": r.score,
                "turned_deg": float(np.degrees(angle_between(r.rotation, pair.rotation))),
            }
            for r in pair.alternatives
        ],
    }


def _spread(values: Floats) -> dict[str, float | None]:
    values = values[np.isfinite(values)]
    if not len(values):
        return {"median": None, "p95": None}
    return {"median": float(np.median(values)), "p95": float(np.percentile(values, 95))}


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
