"""Say in a few lines how far the cameras of a group can be trusted; files of cameras hold them."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from mocap_calib.io.provenance import CAMERA_SIGMAS, judgement, round_sigma
from mocap_calib.recording.epochs import own_name
from mocap_calib.report import rig_report
from mocap_calib.types import CalibrationResult


def judge_rigs(result: CalibrationResult) -> CalibrationResult:
    """Return the result with rigs that say how far they can be trusted."""
    groups = []
    for group in result.groups:
        judged = judge_cameras(rig_report(group, result))
        rig = replace(group.rig, judgement=judged)
        groups.append(replace(group, adjusted=replace(group.adjusted, rig=rig)))
    return replace(result, groups=tuple(groups))


def judge_cameras(report: Mapping[str, Any]) -> dict[str, Any]:
    """Return what files say of how far the cameras of a group can be trusted.

    The fields are those of `provenance.judgement`.

    report: what `run_report` or `rig_report` returns.
    """
    verdict = report["verdict"]
    sigma = verdict["rotation_sigma_deg"]
    remarks = [
        f"rotations are uncertain by {sigma['median']:.2f} deg (worst camera "
        f"{sigma['max']:.2f}), a standard deviation",
        *verdict["reasons"],
    ]
    remarks += _describe_faults(report)
    remarks += _name_cameras(report, "inconsistent", "errors several times those of the others")
    remarks += _name_cameras(report, "weak", "a low pair score: do not trust it without a check")
    remarks += _name_cameras(report, "weak_perspective", "its distance is not observable")
    if verdict["reversal"] == "not observable":
        remarks.append("a rig reversed in depth fits as well: nothing tells which is right")
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


def _describe_faults(report: Mapping[str, Any]) -> list[str]:
    """Return a line for each fault that was found, and whether it was mended."""
    return [
        f"{camera['name']}: {fault['says']}" + ("; mended for this run" if fault["mended"] else "")
        for camera in report["cameras"]
        for fault in camera["fault_evidence"].values()
    ]


def _name_cameras(report: Mapping[str, Any], fault: str, meaning: str) -> list[str]:
    """Return a line that names the cameras with a fault and says what it means, if there are any.

    fault: a word of the list `faults` of a camera, or the name of a field that is true.
    """
    cameras = report["cameras"]
    names = [each["name"] for each in cameras if fault in each["faults"] or each.get(fault)]
    return [f"{fault.replace('_', ' ')}: {', '.join(names)} ({meaning})"] if names else []
