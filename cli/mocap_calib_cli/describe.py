"""What commands say of a recording and of its calibration, as lines of text for a person."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mocap_calib.io.provenance import advice_on
from mocap_calib.io.results.group import REVERSED_RIG
from mocap_calib.job.outcome import WrittenGroup
from mocap_calib.recording.meanings import describe_unshared
from mocap_calib.recording.summary import RecordingSummary
from mocap_calib.types import CalibrationResult, GroupResult
from mocap_calib.wording import count
from mocap_calib_cli.describe_faults import describe_faults, describe_measured_faults
from mocap_calib_cli.describe_world import describe_world
from mocap_calib_cli.progress import format_number, format_table

_MOST_INDIVIDUALS = 20  # that have a row in a table
_MOST_CAMERAS = 10  # that have a column

# --- what was read


def describe_recording(summary: RecordingSummary) -> list[str]:
    """Say which file belongs to which camera, what is left out, and which joints are known."""
    return [
        *summary.camera_notes,
        *_describe_cameras(summary),
        *summary.filled_in,
        *_describe_left_out(summary),
        *_describe_joints(summary),
        *describe_ignored_files(summary.ignored_files),
    ]


def describe_ignored_files(files: Sequence[str]) -> list[str]:
    """Say which files are not read because an .h5 file lies beside them."""
    return [f"left out, the .h5 beside it is read: {', '.join(files)}"] if files else []


def _describe_cameras(summary: RecordingSummary) -> list[str]:
    """Return a table of the cameras."""
    rows = [
        [found.camera, found.source, str(found.frames), str(found.detections)]
        for found in summary.cameras
    ]
    rows += [[name, "(no keypoint file)", "-", "-"] for name in summary.without_keypoints]
    return format_table(["camera", "keypoints", "frames", "detections"], rows)


def _describe_left_out(summary: RecordingSummary) -> list[str]:
    """Say which cameras and how many detections take no part."""
    lines = []
    if summary.left_out:
        lines.append(f"left out, nothing detected: {', '.join(summary.left_out)}")
    if summary.unknown_cameras:
        lines.append(f"left out, not among the cameras: {', '.join(summary.unknown_cameras)}")
    if summary.lone_detections:
        lone = count(summary.lone_detections, "detection")
        lines.append(f"left out, in frames of a single camera: {lone}")
    return lines


def _describe_joints(summary: RecordingSummary) -> list[str]:
    """Say how many joints there are, and how many of them the model knows."""
    joints = f"{count(summary.frames, 'frame')}; {count(len(summary.keypoints), 'joint')}"
    known = f"the model of {summary.skeleton} knows {summary.known}"
    unknown = f", not: {', '.join(summary.unknown)}" if summary.unknown else ""
    lines = [f"{joints}, {known}{unknown}"]
    if summary.too_few_known_joints:
        lines.append("the model knows too few joints to help: calibrated by geometry alone")
    if summary.single_camera_joints:
        lines.append(describe_unshared(summary.single_camera_joints))
    return lines


# --- what was found


def describe_groups(result: CalibrationResult) -> list[str]:
    """Say which groups of cameras were calibrated separately, if there are several."""
    groups = result.groups
    if len(groups) == 1:
        return []
    names = " | ".join(", ".join(group.rig.names) for group in groups)
    return [
        "",
        f"{len(groups)} groups of cameras that share too little to be placed against each other, "
        f"each calibrated by itself: {names}",
    ]


def describe_unused_cameras(names: Sequence[str]) -> list[str]:
    """Say which cameras are in no group."""
    if not names:
        return []
    return [f"left out, no other camera confirms what they see: {', '.join(names)}"]


def describe_group(group: GroupResult, report: dict[str, Any], folder: Path) -> list[str]:
    """Say what a person wants to know of the result of one group of cameras.

    report: as `run.json` has it. folder: where the files of the group are.
    """
    points = report["points"]["triangulated"]
    return [
        "",
        *_describe_errors(report),
        *_describe_intrinsics(report),
        "",
        *_describe_individuals(report),
        "",
        *_describe_pairs(report),
        *_describe_weak_cameras(report),
        *_describe_rounds(group),
        *describe_faults(report, folder),
        *_describe_rig(report),
        *_describe_reasons(group),
        *_describe_weak_perspective(report),
        *_describe_reversal(group, folder),
        f"{count(len(report['individuals']), 'individual')}, {count(points, 'point')}; "
        f"results in {folder}",
        *describe_world(report["world"]),
    ]


def describe_refused(files: WrittenGroup) -> list[str]:
    """Say which further formats of a group were not written, and why."""
    return [f"{name} is not written: {error}" for name, error in files.refused.items()]


def describe_adjusted(group: GroupResult, report: dict[str, Any]) -> list[str]:
    """Say what a person wants to know of a rig that was adjusted by itself.

    report: what `rig_report` returns.
    """
    return [
        *_describe_errors(report),
        *_describe_rounds(group),
        *describe_measured_faults(report),
        *_describe_rig(report),
        *_describe_reasons(group),
        *_describe_weak_perspective(report),
    ]


def _describe_errors(report: dict[str, Any]) -> list[str]:
    """Return a table of the cameras: detections, reprojection errors, pair scores if known."""
    cameras = report["cameras"]
    errors = [camera["reprojection_error_px"] for camera in cameras]
    columns = {
        "camera": [camera["name"] for camera in cameras],
        "detections": [str(camera["detections"]) for camera in cameras],
        "matched": [str(camera["matched"]) for camera in cameras],
        "median px": [format_number(error["median"]) for error in errors],
        "95 % px": [format_number(error["p95"]) for error in errors],
        "pair score": [format_number(camera["pair_score"]) for camera in cameras],
        "sigma deg": [format_number(camera["rotation_sigma_deg"]) for camera in cameras],
    }
    if all(camera["pair_score"] is None for camera in cameras):
        del columns["pair score"]
    return format_table(list(columns), zip(*columns.values(), strict=True))


def _describe_intrinsics(report: dict[str, Any]) -> list[str]:
    """Return a table of the intrinsics that were to be estimated, and which are not determined."""
    rows = []
    for camera in report["cameras"]:
        found = camera["intrinsics"]
        if found["source"] == "given":
            continue
        figures = [found["focal_px"], found["focal_sigma_px"]]
        lens = [found["k1"], found["k1_sigma"]]
        texts = [format_number(value, 0) for value in figures]
        texts += ["-" if value is None else format_number(value, 3) for value in lens]
        rows.append([camera["name"], found["source"], *texts])
    if not rows:
        return []
    header = ["camera", "intrinsics", "focal px", "+-", "k1", "+-"]
    lines = format_table(header, rows)
    if any(camera["intrinsics"]["source"] == "not determined" for camera in report["cameras"]):
        lines.append(
            "focal lengths that are not determined are as given or assumed: give --cameras, or "
            "record with three cameras or more from different heights and sides"
        )
    return lines


def _describe_individuals(report: dict[str, Any]) -> list[str]:
    """Return a table of the frames in which each individual was found, by camera."""
    individuals = report["individuals"][:_MOST_INDIVIDUALS]
    names = [camera["name"] for camera in report["cameras"]]
    if len(names) <= _MOST_CAMERAS:
        counts = [[str(each["cameras"].get(name, "-")) for name in names] for each in individuals]
    else:
        names = ["cameras"]
        counts = [[str(len(each["cameras"]))] for each in individuals]
    rows = [
        [str(each["individual"]), str(each["frames"]), *cells]
        for each, cells in zip(individuals, counts, strict=True)
    ]
    further = len(report["individuals"]) - len(rows)
    return [
        "frames in which each individual was found, in all and by camera:",
        *format_table(["individual", "in all", *names], rows),
        *([f"and {further} more: see run.json"] if further else []),
    ]


def _describe_pairs(report: dict[str, Any]) -> list[str]:
    """Say which pairs do not go together with the others."""
    lines = []
    for pair in report["pairs"]:
        names = f"pair {pair['a']}-{pair['b']}"
        if pair["alternative_taken"]:
            lines.append(
                f"{names}: an alternative to its own best answer was taken, the one that the "
                "cameras between confirm"
            )
        if pair["breaks_loop"]:
            angle = pair["loop_rotation_deg"]
            lines.append(
                f"{names} contradicts the others by {angle:.1f} deg and was given little weight"
            )
    return lines


def _describe_weak_cameras(report: dict[str, Any]) -> list[str]:
    """Say which cameras have no pair of a good score."""
    weak = [camera["name"] for camera in report["cameras"] if camera["weak"]]
    if not weak:
        return []
    least = report["config"]["averaging"]["weak_score"]
    return [
        f"weak: {', '.join(weak)} (pair score below {least}, good recordings have 0.7 and more): "
        "do not trust it without a check"
    ]


def _describe_rounds(group: GroupResult) -> list[str]:
    """Say that the adjustment had not come to rest."""
    if group.adjusted.converged:
        return []
    rounds = count(group.adjusted.rounds, "round")
    return [f"matches still changed after {rounds} of adjustment; look at matches.csv with care"]


def _describe_rig(report: dict[str, Any]) -> list[str]:
    """Say the verdict on the rig, and how far its cameras may be off."""
    verdict = report["verdict"]
    turn, shift = verdict["rotation_sigma_deg"], verdict["centre_sigma_percent"]
    return [
        f"rig: {verdict['rig']}; rotations are uncertain by {turn['median']:.2f} deg (worst camera "
        f"{turn['max']:.2f}), places by {shift['median']:.1f} % of the rig ({shift['max']:.1f}), "
        "a standard deviation each",
    ]


def _describe_reasons(group: GroupResult) -> list[str]:
    """Say what a verdict that is not the best means, unless a warning does, and why it is so."""
    advice = [f"usable{advice_on(group.verdict)}"] if group.verdict == "usable" else []
    return [*advice, *(f"  {reason}" for reason in group.reasons)]


def _describe_weak_perspective(report: dict[str, Any]) -> list[str]:
    """Say of which cameras the images show no perspective."""
    names = [camera["name"] for camera in report["cameras"] if camera["weak_perspective"]]
    if not names:
        return []
    return [
        f"weak perspective, translation not observable: {', '.join(names)}: so far away or of such "
        "long focal length that images show no perspective; distances follow from the focal "
        "lengths alone"
    ]


def _describe_reversal(group: GroupResult, folder: Path) -> list[str]:
    """Say that a rig reversed in depth fits as well."""
    if group.adjusted.depth_reversed_rig is None:
        return []
    return [
        "a rig reversed in depth fits as well, nothing that was seen tells which is right: "
        f"it is in {folder / REVERSED_RIG}"
    ]
