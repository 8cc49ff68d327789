"""Put all numbers of a run into the form that run.json holds; docs/run-json.md describes it."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from mocap_calib import __version__, mapped
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.config import SOUND_DEG, IntrinsicsConfig
from mocap_calib.errors import spell_as_option
from mocap_calib.faults.hypotheses import describe_clock, describe_faults
from mocap_calib.geometry.rotation import angle_between
from mocap_calib.io.provenance import CAMERA_SIGMAS, judgement, round_sigma
from mocap_calib.io.world_fields import world_fields
from mocap_calib.pairs.solve import all_pairs
from mocap_calib.recording.epochs import describe_epochs, own_name, views_by_camera
from mocap_calib.results import (
    POINT_SOURCES,
    CalibrationResult,
    Cause,
    Fault,
    GroupResult,
    PairwiseCalibration,
    Verdict,
)
from mocap_calib.rig.averaging import best_scores
from mocap_calib.types import ARBITRARY, EstimatedCamera, Floats
from mocap_calib.verdict.checks import residuals_of
from mocap_calib.verdict.evaluation import median_and_max

SCHEMA = 3  # goes up when a key of run.json goes or changes its meaning


def run_report(
    group: GroupResult, result: CalibrationResult, *, inputs: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Return all numbers of a run for one group of cameras, under the keys of run.json.

    inputs: path -> SHA-256. What is not known is None.
    """
    error, frames = residuals_of(group).distance, group.recording.frames
    return {
        "schema": SCHEMA,
        "verdict": _describe_verdict(group),
        "version": __version__,
        "seed": result.seed,
        "config": asdict(result.config),
        "inputs": dict(inputs or {}),
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
        "pairs": _describe_pairs(group, error),
        "adjust": {"rounds": group.adjusted.rounds, "turn_deg": group.adjusted.turn_deg},
        "individuals": _describe_individuals(group),
        "poses": _describe_poses(group),
        "points": {
            "triangulated": int(np.isfinite(group.poses.error).sum()),
            "reprojection_error_px": _median_and_p95(group.poses.error),
            "mean_error_px": _median_of_means(error),
        },
    }


def _describe_cameras(
    group: GroupResult, error: Floats, result: CalibrationResult
) -> list[dict[str, Any]]:
    """Return what is known of each camera; of its views, where it was moved, one holds at a time.

    error: `[view, frame, individual, keypoint]` reprojection errors in pixels.
    """
    all_detected, config = group.recording.detected, result.config
    uncertainty, offsets = group.uncertainty, group.time_offsets
    covariance = uncertainty.covariance
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
            "weak_perspective": bool(uncertainty.weak_perspective[views].any()),
            **_sigmas(
                group,
                covariance.rotation_sigma[views].max(),
                covariance.centre_sigma[views].max(),
            ),
            "intrinsics_turn_deg": float(np.degrees(uncertainty.intrinsics_turn[views].max())),
            "clock": {
                "subframe_offset": finite_or_none(-offsets.tau[views[0]] + 0.0),
                "sigma": finite_or_none(offsets.sigma[views[0]]),
                "used": bool(offsets.used[views[0]]),
            },
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
        "focal_sigma_px": camera.focal_sigma,
        "k1": float(camera.distortion[0]) if len(camera.distortion) else 0.0,
        "k1_sigma": None,
        "focal_change": finite_or_none(uncertainty.focal_change[view]),
        "focal_change_sigma": finite_or_none(uncertainty.focal_sigma[view]),
    }
    if isinstance(camera, EstimatedCamera):
        least = config.least_gain * config.focal_uncertainty * camera.focal
        found["source"] = "not determined" if camera.focal_sigma >= least else "estimated"
        found["k1_sigma"] = camera.k1_sigma or None
    return found


def _name_faults(group: GroupResult, views: list[int], faults: Sequence[Fault]) -> list[str]:
    """Return the words for what is wrong with a camera, each once.

    views: indices of the camera's. faults: of this camera.
    """
    uncertainty = group.uncertainty
    measured = {"inconsistent": uncertainty.outlier_cameras, "focal": uncertainty.wrong_focal}
    words = [fault.word for fault in faults]
    found = [word for word, of_view in measured.items() if of_view[views].any()]
    return list(dict.fromkeys([*words, *found]))


def _describe_pairs(group: GroupResult, error: Floats) -> list[dict[str, Any]]:
    """Return how sure two cameras are to each other, and what is known of the pair.

    Of the pairs that were calibrated; of all pairs where none was, as cameras were only adjusted.

    error: `[view, frame, individual, keypoint]` reprojection errors in pixels.
    """
    if not group.pairs:
        return [_pair_sigmas(group, a, b) for a, b in _all_pairs(group)]
    return list(map_in_threads(lambda k: _describe_pair(group, k, error), range(len(group.pairs))))


def _describe_pair(group: GroupResult, index: int, error: Floats) -> dict[str, Any]:
    """Return what is known of one pair of cameras.

    First how sure the two are to each other, then what the rig makes of the points that both views
    see, then what the pair by itself found, then how well it agrees with the rig that the pairs
    were averaged to.

    error: `[view, frame, individual, keypoint]` reprojection errors in pixels.
    """
    pair, averaged = group.pairs[index], group.averaged
    error = error[[pair.a, pair.b]]
    focal = (group.rig.cameras[pair.a].focal + group.rig.cameras[pair.b].focal) / 2
    weight = float(averaged.weight[index])
    return {
        **_pair_sigmas(group, pair.a, pair.b),
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
        "breaks_loop": bool(averaged.contradicts[index]),
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
        counts = {name: int(found[own].sum()) for name, own in views.items()}
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
    blocks = (values[block] for block in mapped.frame_slices(len(values)))
    values = np.concatenate([np.zeros(0), *(block[np.isfinite(block)] for block in blocks)])
    if not len(values):
        return {"median": None, "p95": None}
    # in place, as these are a copy already
    median = float(np.median(values, overwrite_input=True))
    return {"median": median, "p95": float(np.percentile(values, 95, overwrite_input=True))}


def _describe_verdict(group: GroupResult) -> dict[str, Any]:
    """Return whether the recording determines the rig, and what it leaves open."""
    uncertainty, verdict = group.uncertainty, group.assessment
    reversal = group.adjusted.depth_reversed_rig is not None
    return {
        "rig": verdict.word,
        "reasons": [reason.render(spell_as_option) for reason in verdict.reasons],
        **describe_assessment(verdict),
        "rotation_sigma_deg": median_and_max(np.degrees(uncertainty.covariance.rotation_sigma)),
        "centre_sigma_percent": median_and_max(100 * uncertainty.covariance.centre_sigma),
        "intrinsics_turn_deg": median_and_max(np.degrees(uncertainty.intrinsics_turn)),
        "least_sure_pair": _least_sure_pair(group),
        "reversal": "not observable" if reversal else "none found",
        "translation": "not observable" if uncertainty.weak_perspective.any() else "observed",
    }


def describe_assessment(verdict: Verdict) -> dict[str, Any]:
    """Return the expected error of the least certain camera in degrees, its causes and checks."""
    return {
        "expected_error_deg": finite_or_none(verdict.error_deg),
        "causes": [
            {"name": cause.name, "camera": cause.camera or None, "error_deg": cause.error_deg}
            for cause in verdict.causes
        ],
        "checks": [_describe_check(check) for check in verdict.checks],
    }


def verdict_of_cameras(report: Mapping[str, Any]) -> dict[str, Any]:
    """Return what files of cameras hold of the verdict: the fields of `provenance.judgement`.

    report: what `run_report` returns.
    """
    verdict = report["verdict"]
    sigma = verdict["rotation_sigma_deg"]
    faults = [
        f"{camera['name']}: {fault['says']}"
        + ("; corrected in this run" if fault["mended"] else "")
        for camera in report["cameras"]
        for fault in camera["fault_evidence"].values()
    ]
    remarks = [
        f"camera rotations (1 SD): {sigma['median']:.2f} deg, worst {sigma['max']:.2f}",
        *verdict["reasons"],
        *faults,
    ]
    if report["left_out"]:
        remarks.append(f"cameras left out: {', '.join(report['left_out'])}")
    error = report["points"]["mean_error_px"]
    if error is not None:
        remarks.append(f"reprojection error {error:.2f} px, which alone proves nothing")
    sigmas = {
        key: {camera["name"]: round_sigma(camera[key]) for camera in report["cameras"]}
        for key in CAMERA_SIGMAS
    }
    return judgement(verdict["rig"], remarks, error, **sigmas)


def _least_sure_pair(group: GroupResult) -> dict[str, Any]:
    """Return that of the pair, of all of them, whose rotation is least sure; no length."""
    turn = group.uncertainty.covariance.pair_rotation_sigma
    found = _pair_sigmas(group, *max(_all_pairs(group), key=lambda pair: float(turn[pair])))
    return {key: value for key, value in found.items() if key != "centre_sigma"}


def _all_pairs(group: GroupResult) -> list[tuple[int, int]]:
    """Return all pairs of views (indices) of two cameras."""
    own = [own_name(name, group.rig.names) for name in group.rig.names]
    return [(a, b) for a, b in all_pairs(len(own)) if own[a] != own[b]]


def _pair_sigmas(group: GroupResult, a: int, b: int) -> dict[str, Any]:
    """Return how sure two views (indices) are to each other: rotation and baseline."""
    covariance, names = group.uncertainty.covariance, group.rig.names
    turn, baseline = covariance.pair_rotation_sigma[a, b], covariance.pair_centre_sigma[a, b]
    return {"a": names[a], "b": names[b], **_sigmas(group, turn, baseline)}


def _sigmas(group: GroupResult, turn: float, length: float) -> dict[str, float | None]:
    """Return standard deviations of a rotation in radians, and of a length in sizes of the rig."""
    known = group.rig.unit != ARBITRARY
    return {
        "rotation_sigma_deg": float(np.degrees(turn)),
        "centre_sigma_percent": 100 * float(length),
        "centre_sigma": float(length) * group.uncertainty.covariance.size if known else None,
    }


def _describe_check(check: Cause) -> dict[str, Any]:
    """Return what a check found, and whether that is what sound recordings show."""
    return {
        "name": check.name,
        "value": check.error_deg if check.measured else None,
        "limit": SOUND_DEG,
        "error_deg": check.error_deg,
        "camera": check.camera or None,
        "passed": check.passed,
    }


def finite_or_none(value: float) -> float | None:
    """Return the value, or None where it is not known."""
    return float(value) if np.isfinite(value) else None
