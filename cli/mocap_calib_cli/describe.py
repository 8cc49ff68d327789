"""What commands say of a recording and of its groups of cameras, for a person, in lines of text."""

from collections.abc import Sequence

from mocap_calib.errors import count
from mocap_calib.job.load import RecordingSummary
from mocap_calib.recording.names import describe_unshared
from mocap_calib.results import CalibrationResult
from mocap_calib_cli.screen import format_table, keep_lines

# --- what was read


def describe_recording(summary: RecordingSummary) -> list[str]:
    """Say which file belongs to which camera, what is left out, and which joints are known."""
    rows = [
        [found.camera, found.source, str(found.frames), str(found.detections)]
        for found in summary.cameras
    ]
    rows += [[name, "(no keypoint file)", "-", "-"] for name in summary.without_keypoints]
    joints = f"{count(summary.frames, 'frame')}; {count(len(summary.keypoints), 'joint')}"
    unknown = f", not: {', '.join(summary.unknown)}" if summary.unknown else ""
    known = f"the model of {summary.skeleton} knows {summary.known}{unknown}"
    lone = count(summary.lone_detections, "detection")
    others, single = summary.unknown_cameras, summary.single_camera_joints
    few = "the model knows too few joints to help: calibrated by geometry alone"
    cases: dict[str, object] = {
        f"left out, nothing detected: {', '.join(summary.left_out)}": summary.left_out,
        f"left out, not among the cameras: {', '.join(others)}": others,
        f"left out, in frames of a single camera: {lone}": summary.lone_detections,
        f"{joints}, {known}": True,
        few: summary.too_few_known_joints,
        describe_unshared(single): single,
    }
    return [
        *summary.camera_notes,
        *format_table(["camera", "keypoints", "frames", "detections"], rows),
        *keep_lines({summary.naming: summary.naming}),
        *summary.corrected,
        *summary.remarks,
        *summary.filled_in,
        *(
            f"{camera}: {count(points, 'keypoint')} more than three image sizes outside of its "
            "images, taken as missing"
            for camera, points in summary.far_points.items()
        ),
        *keep_lines(cases),
        *describe_ignored_files(summary.ignored_files),
    ]


def describe_ignored_files(files: Sequence[str]) -> list[str]:
    """Say which files are not read because an .h5 file or a filtered one lies beside them."""
    listed = ", ".join(files)
    return keep_lines(
        {f"left out, the .h5 or the filtered file beside it is read: {listed}": files}
    )


# --- what was found


def describe_groups(result: CalibrationResult) -> list[str]:
    """Say which groups of cameras were calibrated separately, and what of clocks is not known."""
    groups, clocks = result.groups, result.clocks.cameras
    names = " | ".join(", ".join(group.rig.names) for group in groups)
    looked = result.config.sync.mode != "off"
    cases = {
        f"\n{len(groups)} groups of cameras that share too little to be placed against each other, "
        f"each calibrated by itself: {names}": len(groups) > 1,
        "the clocks of the cameras are taken as they are: too little moves, or too few frames are "
        "shared, to compare them": looked and all(clock.kind == "not known" for clock in clocks),
    }
    return keep_lines(cases) + describe_unused_cameras(result.left_out)


def describe_unused_cameras(names: Sequence[str]) -> list[str]:
    """Say which cameras are in no group."""
    return keep_lines(
        {f"left out, no other camera confirms what they see: {', '.join(names)}": names}
    )
