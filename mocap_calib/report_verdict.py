"""What run.json and files of cameras hold of the verdict on a rig."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mocap_calib.config import VERDICT_LIMITS_DEG
from mocap_calib.io.provenance import CAMERA_SIGMAS, judgement, round_sigma
from mocap_calib.pairs.solve import all_pairs
from mocap_calib.recording.timeline import own_name
from mocap_calib.results import Check, GroupResult
from mocap_calib.types import ARBITRARY
from mocap_calib.verdict.evaluation import median_and_max


def describe_verdict(group: GroupResult) -> dict[str, Any]:
    """Return whether the recording determines the rig, and what it leaves open."""
    uncertainty, verdict = group.uncertainty, group.assessment
    reversal = group.adjusted.depth_reversed_rig is not None
    return {
        "rig": verdict.word,
        "expected_error_deg": finite_or_none(verdict.error_deg),
        "reasons": list(verdict.reasons),
        "causes": [
            {"name": cause.name, "camera": cause.camera or None, "error_deg": cause.error_deg}
            for cause in verdict.causes
        ],
        "rotation_sigma_deg": median_and_max(np.degrees(uncertainty.covariance.rotation_sigma)),
        "centre_sigma_percent": median_and_max(100 * uncertainty.covariance.centre_sigma),
        "intrinsics_turn_deg": median_and_max(np.degrees(uncertainty.intrinsics_turn)),
        "least_sure_pair": _least_sure_pair(group),
        "checks": [_describe_check(check) for check in verdict.checks],
        "reversal": "not observable" if reversal else "none found",
        "translation": "not observable" if uncertainty.weak_perspective.any() else "observed",
    }


def verdict_of_cameras(report: Mapping[str, Any]) -> dict[str, Any]:
    """Return what files of cameras hold of the verdict: the fields of `provenance.judgement`.

    report: what `run_report` or `rig_report` returns.
    """
    verdict = report["verdict"]
    sigma = verdict["rotation_sigma_deg"]
    remarks = [
        f"camera rotations (1 SD): {sigma['median']:.2f} deg, worst {sigma['max']:.2f}",
        *verdict["reasons"],
        *_describe_faults(report),
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
    of_pairs = {f"pair_{key}": _of_pairs(report, key) for key in CAMERA_SIGMAS}
    return judgement(verdict["rig"], remarks, error, **sigmas, **of_pairs)


def _describe_faults(report: Mapping[str, Any]) -> list[str]:
    """Return a line for each fault that was found, and whether it was corrected."""
    return [
        f"{camera['name']}: {fault['says']}" + ("; mended for this run" if fault["mended"] else "")
        for camera in report["cameras"]
        for fault in camera["fault_evidence"].values()
    ]


def _of_pairs(report: Mapping[str, Any], key: str) -> dict[str, dict[str, float]]:
    """Return a figure of the pairs by the names of their cameras.

    Where a camera was moved, it has several, and the largest counts.
    """
    pairs = report["pairs"]
    views = [pair[side] for pair in pairs for side in ("a", "b")]
    found: dict[str, dict[str, float]] = {}
    for pair in pairs:
        a, b = (own_name(pair[side], views) for side in ("a", "b"))
        if a != b:
            row = found.setdefault(a, {})
            row[b] = max(row.get(b, 0.0), round_sigma(pair[key]))
    return found


def describe_sigma(group: GroupResult, views: list[int]) -> dict[str, float | None]:
    """Return how far a camera may be off: its rotation, and its place after the best similarity.

    views: indices of the camera's; where it was moved, it has several, and the largest counts.
    """
    covariance = group.uncertainty.covariance
    centre = float(covariance.centre_sigma[views].max())
    return {
        "rotation_sigma_deg": float(np.degrees(covariance.rotation_sigma[views].max())),
        "centre_sigma_percent": 100 * centre,
        "centre_sigma": _length(group, centre),
        "intrinsics_turn_deg": float(np.degrees(group.uncertainty.intrinsics_turn[views].max())),
    }


def describe_pair_sigmas(group: GroupResult) -> list[dict[str, Any]]:
    """Return how sure two cameras are to each other: the rotation and the way between them.

    Of the pairs that were calibrated; of all pairs where none was, as cameras were only adjusted.
    """
    pairs = [(pair.a, pair.b) for pair in group.pairs] or _all_pairs(group)
    return _pair_sigmas(group, pairs)


def _least_sure_pair(group: GroupResult) -> dict[str, Any]:
    """Return that of the pair, of all of them, whose rotation is least sure; no length."""
    turn = group.uncertainty.covariance.pair_rotation_sigma
    worst = max(_all_pairs(group), key=lambda pair: float(turn[pair]))
    (found,) = _pair_sigmas(group, [worst])
    return {key: value for key, value in found.items() if key != "centre_sigma"}


def _all_pairs(group: GroupResult) -> list[tuple[int, int]]:
    """Return all pairs of views (indices) of two cameras."""
    own = [own_name(name, group.rig.names) for name in group.rig.names]
    return [(a, b) for a, b in all_pairs(len(own)) if own[a] != own[b]]


def _pair_sigmas(group: GroupResult, pairs: Sequence[tuple[int, int]]) -> list[dict[str, Any]]:
    """Return what `describe_pair_sigmas` does of pairs of views (indices)."""
    covariance, names = group.uncertainty.covariance, group.rig.names
    turn, way = np.degrees(covariance.pair_rotation_sigma), covariance.pair_centre_sigma
    return [
        {
            "a": names[a],
            "b": names[b],
            "rotation_sigma_deg": float(turn[a, b]),
            "centre_sigma_percent": 100 * float(way[a, b]),
            "centre_sigma": _length(group, float(way[a, b])),
        }
        for a, b in pairs
    ]


def _length(group: GroupResult, sizes: float) -> float | None:
    """Return a length in sizes of the rig in the unit of the rig, None where that is arbitrary."""
    known = group.rig.unit != ARBITRARY
    return sizes * group.uncertainty.covariance.size if known else None


def _describe_check(check: Check) -> dict[str, Any]:
    """Return what a check found, and whether that is what sound recordings show."""
    return {
        "name": check.name,
        "value": finite_or_none(check.error_deg),
        "limit": VERDICT_LIMITS_DEG[0],
        "error_deg": finite_or_none(check.error_deg) or 0.0,
        "camera": check.camera or None,
        "passed": check.passed,
    }


def finite_or_none(value: float) -> float | None:
    """Return the value, or None where it is not known."""
    return float(value) if np.isfinite(value) else None
