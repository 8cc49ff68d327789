"""Put all numbers of a run into the form that run.json holds; docs/run-json.md describes it."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from mocap_calib import __version__, mapped
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import IntrinsicsConfig
from mocap_calib.faults.words import describe_clock, describe_faults
from mocap_calib.geometry.rotation import angle_between
from mocap_calib.io.world_fields import world_fields
from mocap_calib.recording.timeline import describe_epochs, views_by_camera
from mocap_calib.report_verdict import (
    describe_pair_sigmas,
    describe_sigma,
    describe_verdict,
    finite_or_none,
)
from mocap_calib.results import (
    POINT_SOURCES,
    CalibrationResult,
    Fault,
    GroupResult,
    PairwiseCalibration,
)
from mocap_calib.rig.averaging import WEIGHT_AT_SCALE, best_scores
from mocap_calib.rig.loops import alternative_taken
from mocap_calib.types import EstimatedCamera, Floats
from mocap_calib.verdict.checks import residuals_of

SCHEMA = 3  # goes up when a key of run.json goes or changes its meaning


def run_report(
    group: GroupResult, result: CalibrationResult, *, inputs: Mapping[str, str]
) -> dict[str, Any]:
    """Return all numbers of a run for one group of cameras, under the keys of run.json.

    inputs: path -> SHA-256. What is not known is None.
    """
    error, sigmas = residuals_of(group).distance, describe_pair_sigmas(group)
    frames = group.recording.frames
    return {
        "schema": SCHEMA,
        "verdict": describe_verdict(group),
        "version": __version__,
        "seed": result.seed,
        "config": asdict(result.config),
        "inputs": dict(inputs),
        "seconds": {stage: round(seconds, 3) for stage, seconds in group.seconds.items()},
        "unit": group.rig.unit,
        "world": world_fields(group.rig.world, group.rig.unit),
        "frames": {"first": int(frames[0]), "last": int(frames[-1]), "count": len(frames)},
        "keypoints": list(group.recording.keypoints),
        "clocks": [describe_clock(clock, result.clocks) for clock in result.clocks.cameras],
        "left_out": list(result.left_out),
        "unused_pairs": [asdict(pair) for pair in result.unused_pairs],
        "epochs": describe_epochs(group.rig.names, frames),
        "cameras": _describe_cameras(group, error, result),
        "pairs": list(
            map_in_threads(
                lambda k: sigmas[k] | _describe_pair(group, k, error),
                range(len(group.pairs)),
            )
        ),
        "adjust": {"rounds": group.adjusted.rounds, "converged": group.adjusted.converged},
        "individuals": _describe_individuals(group),
        "poses": _describe_poses(group),
        "points": _describe_points(group, error),
    }


def rig_report(group: GroupResult, result: CalibrationResult) -> dict[str, Any]:
    """Return the part of `run_report` that says how far the cameras of a group can be trusted."""
    error = residuals_of(group).distance
    return {
        "unit": group.rig.unit,
        "verdict": describe_verdict(group),
        "left_out": list(result.left_out),
        "cameras": _describe_cameras(group, error, result),
        "pairs": describe_pair_sigmas(group),
        "points": _describe_points(group, error),
    }


def _describe_cameras(
    group: GroupResult, error: Floats, result: CalibrationResult
) -> list[dict[str, Any]]:
    """Return what is known of each camera; of its views, where it was moved, one holds at a time.

    error: `[view, frame, individual, keypoint]` reprojection errors in pixels.
    """
    all_detected, config = group.recording.detected, result.config
    scores = best_scores(group.pairs, len(group.rig))

    def describe(camera: tuple[str, list[int]]) -> dict[str, Any]:
        name, views = camera
        detected = all_detected[views]
        matched = int((detected & (group.matches.labels[views] >= 0)).sum())
        score = float(scores[views].min())
        faults = [fault for fault in result.faults if fault.camera == name]
        return {
            "name": name,
            "frames": int(detected.any(-1).sum()),
            "detections": int(detected.sum()),
            "matched": matched,
            "unmatched": int(detected.sum()) - matched,
            "faults": _name_faults(group, views, faults),
            "fault_evidence": describe_faults(faults),
            "weak_perspective": bool(group.uncertainty.weak_perspective[views].any()),
            **describe_sigma(group, views),
            "clock": _describe_clock(group, views[0]),
            "intrinsics": _describe_intrinsics(group, views[0], config.intrinsics),
            "reprojection_error_px": _median_and_p95(error[views]),
            "pair_score": finite_or_none(score),
            "weak": score < config.averaging.weak_score,
        }

    return list(map_in_threads(describe, views_by_camera(group.rig.names).items()))


def _describe_intrinsics(group: GroupResult, view: int, config: IntrinsicsConfig) -> dict[str, Any]:
    """Return where the intrinsics of a camera come from, and how sure they are."""
    camera, uncertainty = group.rig.cameras[view], group.uncertainty
    found = {
        "source": "given",
        "focal_px": camera.focal,
        "focal_sigma_px": None,
        "k1": float(camera.distortion[0]) if len(camera.distortion) else 0.0,
        "k1_sigma": None,
        "focal_change": finite_or_none(uncertainty.focal_change[view]),
        "focal_change_sigma": finite_or_none(uncertainty.focal_sigma[view]),
    }
    if isinstance(camera, EstimatedCamera):
        least = config.least_gain * config.focal_uncertainty * camera.focal
        found["source"] = "not determined" if camera.focal_sigma >= least else "estimated"
        found["focal_sigma_px"] = camera.focal_sigma
        found["k1_sigma"] = camera.k1_sigma or None
    return found


def _describe_clock(group: GroupResult, view: int) -> dict[str, Any]:
    """Return by what part of a frame the clock of a camera is off, and whether that was used."""
    offsets = group.time_offsets
    return {
        "subframe_offset": finite_or_none(-offsets.tau[view] + 0.0),
        "sigma": finite_or_none(offsets.sigma[view]),
        "used": bool(offsets.used[view]),
    }


def _name_faults(group: GroupResult, views: list[int], faults: Sequence[Fault]) -> list[str]:
    """Return the words for what is wrong with a camera, each once.

    views: indices of the camera's. faults: of this camera.
    """
    uncertainty = group.uncertainty
    measured = {"inconsistent": uncertainty.outlier_cameras, "focal": uncertainty.wrong_focal}
    words = [fault.word for fault in faults]
    found = [word for word, of_view in measured.items() if of_view[views].any()]
    return list(dict.fromkeys([*words, *found]))


def _describe_pair(group: GroupResult, index: int, error: Floats) -> dict[str, Any]:
    """Return what is known of one pair of cameras.

    First what the rig makes of the points that both views see, then what the pair by itself
    found, then how well it agrees with the rig that the pairs were averaged to.

    error: `[view, frame, individual, keypoint]` reprojection errors in pixels.
    """
    pair, averaged = group.pairs[index], group.averaged
    error = error[[pair.a, pair.b]]
    focal = (group.rig.cameras[pair.a].focal + group.rig.cameras[pair.b].focal) / 2
    weight = float(averaged.weight[index])
    return {
        "frames": pair.frames,
        "matches": _count_matches(group, pair),
        "reprojection_error_px": _median_and_p95(error[:, np.isfinite(error).all(0)].ravel()),
        "sampled_matches": len(pair.matches),
        "score": pair.score,
        "source": pair.source,
        "in_front": pair.in_front,
        "epipolar_error_deg": finite_or_none(np.degrees(pair.residual)),
        "epipolar_error_px": finite_or_none(pair.residual * focal),
        "baseline_body_sizes": float(np.linalg.norm(pair.translation)),
        "loop_rotation_deg": float(np.degrees(averaged.loop_error[index])),
        "loop_translation_deg": float(np.degrees(averaged.translation_error[index])),
        "weight": weight,
        "breaks_loop": weight < WEIGHT_AT_SCALE,
        "alternative_taken": alternative_taken(pair),
        "alternatives": [
            {
                "score": other.score,
                "turned_deg": float(np.degrees(angle_between(other.rotation, pair.rotation))),
            }
            for other in pair.alternatives
        ],
    }


def _count_matches(group: GroupResult, pair: PairwiseCalibration) -> int:
    """Return how many detections of both views are the same individual in a frame."""
    labels = group.matches.labels
    in_a = labels[pair.a][:, :, None]
    in_b = labels[pair.b][:, None]
    return int(((in_a == in_b) & (in_a >= 0)).sum())


def _describe_individuals(group: GroupResult) -> list[dict[str, Any]]:
    """Return in how many frames each individual was matched, in all cameras and in each."""
    described = []
    views = views_by_camera(group.rig.names)
    for individual in range(group.matches.individuals):
        found = (group.matches.labels == individual).any(2)  # [view, frame]
        frames = found.sum(1).tolist()
        counts = {name: sum(frames[view] for view in own) for name, own in views.items()}
        in_cameras = {name: count for name, count in counts.items() if count}
        described.append(
            {"individual": individual, "frames": int(found.any(0).sum()), "cameras": in_cameras}
        )
    return described


def _describe_poses(group: GroupResult) -> dict[str, Any]:
    """Return how the best estimates of the poses were made, and what of."""
    smoothing = group.smoothing
    codes = np.bincount(group.poses.source.ravel(), minlength=len(POINT_SOURCES))
    return {
        "acceleration_sigma": finite_or_none(smoothing.acceleration),
        "bone_sigma": finite_or_none(smoothing.bones),
        "loss": finite_or_none(smoothing.loss),
        "held_out_error": finite_or_none(smoothing.held_out),
        "held_out_error_raw": finite_or_none(smoothing.held_out_raw),
        **{
            source.replace(" ", "_"): count
            for source, count in zip(POINT_SOURCES[1:], codes[1:].tolist(), strict=True)
        },
        "outliers": smoothing.outliers,
        "exchanged": smoothing.exchanged,
    }


def _describe_points(group: GroupResult, error: Floats) -> dict[str, Any]:
    """Return how many points were triangulated, and how well they fit.

    error: `[view, frame, individual, keypoint]` reprojection errors in pixels.
    """
    return {
        "triangulated": int(np.isfinite(group.poses.error).sum()),
        "reprojection_error_px": _median_and_p95(group.poses.error),
        "mean_error_px": _median_of_means(error),
    }


def _median_of_means(error: Floats) -> float | None:
    """Return the median over the points of the mean error over the views, None without points.

    error: `[view, ...]`, NaN = not seen. It is what aniposelib calls the error of a calibration
    (CameraGroup.average_error, median).
    """
    views = np.isfinite(error).sum(0)
    seen = views > 0
    means = np.nansum(error, axis=0)[seen] / views[seen]
    return float(np.median(means)) if len(means) else None


def _median_and_p95(values: Floats) -> dict[str, float | None]:
    """Return the median and the 95th percentile of the values that are finite."""
    values = mapped.finite_values(values)
    if not len(values):
        return {"median": None, "p95": None}
    # in place, as these are a copy already
    median = float(np.median(values, overwrite_input=True))
    return {"median": median, "p95": float(np.percentile(values, 95, overwrite_input=True))}
