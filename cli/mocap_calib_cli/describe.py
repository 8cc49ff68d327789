"""What commands say of a recording and of its groups of cameras, for a person, in lines of text."""

from collections.abc import Sequence

from mocap_calib.errors import count
from mocap_calib.job.load import RecordingSummary
from mocap_calib.job.results import WrittenGroup
from mocap_calib.recording.names import describe_unshared
from mocap_calib.results import CalibrationResult
from mocap_calib_cli.screen import format_table

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


def describe_refused(files: WrittenGroup) -> list[str]:
    """Say which further formats of a group were not written, and why."""
    return [f"{name} is not written: {error}" for name, error in files.refused.items()]


def describe_unknown_clocks(result: CalibrationResult) -> list[str]:
    """Say that the clocks of the cameras could not be compared, where that is so."""
    looked = result.config.sync.mode != "off"
    if looked and all(clock.kind == "not known" for clock in result.clocks.cameras):
        return [
            "the clocks of the cameras are taken as they are: too little moves, or too few frames "
            "are shared, to compare them"
        ]
    return []
