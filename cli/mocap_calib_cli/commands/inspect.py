"""mocap-calib inspect: what is in keypoint files, before any calibration."""

import json
from typing import TYPE_CHECKING, Any

from mocap_calib_cli import options
from mocap_calib_cli.screen import Line, echo, format_number, format_table, keep_lines, show
from mocap_calib_cli.typed import Typed, as_command

if TYPE_CHECKING:
    from mocap_calib.io.cameras import CameraFile

_COLOURS = {"CRITICAL": "red", "WARNING": "yellow"}
_COLUMNS = {  # heading -> what it means
    "camera": "",
    "frames": "in the file",
    "range": "number of the first frame and of the last",
    "gaps": "places between them where frame numbers are not there",
    "detections": "bodies found, in all frames together",
    "at once": "most detections in one frame",
    "followed": "whether the file has identities from frame to frame",
    "joints": "names of keypoints in the file",
    "missing": "share of the points that the file marks as not found",
    "score": "lowest and highest score of a point, as the detector gave them",
    "image": "width and height in pixels; ? = the file does not say",
    "covered": "share of the image in which points were ever found",
}
_LISTED_GAPS = 5


@as_command(
    "inspect",
    *options.KEYPOINTS,
    options.CAMERAS_IF_ANY,
    "skeleton",
    options.option("--sync"),
    options.AS_JSON,
)
def command(typed: Typed) -> int:
    """Say what is in KEYPOINTS, and what would make a run fail.

    Of each camera: frames and gaps, individuals, joints, missing points, scores; of each pair of
    cameras: the frames in which both see somebody. A finding is CRITICAL where a run could not
    work (exit status 1), else a WARNING; each says what to do.

    \b
    Example:
      mocap-calib inspect keypoints/ --cameras intrinsics.toml
      mocap-calib inspect openpose/ --layout body_25b --json

    cameras: The cameras' intrinsics, to see whether they and the keypoints go together.
    sync: Find out whether the clocks of the cameras differ, which takes some seconds.
    as_json: Write everything as JSON.
    """
    from mocap_calib_cli import inputs

    file = inputs.load_camera_file(typed.cameras, "--cameras") if typed.cameras else None
    report = _inspect(typed, file)
    if typed.sync and not _is_critical(report):
        _compare_clocks(report, typed, file)
    if typed.as_json:
        echo(json.dumps(report, indent=1, allow_nan=False))
    else:
        show(*_describe(report), err=False)
    return int(_is_critical(report))


def _inspect(typed: Typed, file: "CameraFile | None") -> dict[str, Any]:
    """Return what the files hold, and the findings."""
    from mocap_calib.inspection.contents import InspectConfig, fill_image_sizes, inspect_views
    from mocap_calib.inspection.problems import find_problems
    from mocap_calib.io.filled_table import describe_filled
    from mocap_calib.io.keypoints import read_what_can
    from mocap_calib.recording.far_points import without_far_points
    from mocap_calib.recording.joints import fit_vocabulary
    from mocap_calib_cli import inputs

    config, source = InspectConfig(), inputs.keypoint_source(typed)
    read, errors = read_what_can(typed.keypoints, typed.format, source.options)
    views = tuple(without_far_points(view, view.image_size) for view in read)
    cameras, notes = (file.cameras, file.notes) if file else ((), ())
    names = (name for view in views for name in view.keypoints)
    skeleton, aliases = fit_vocabulary(names, typed.skeleton)
    report = inspect_views(fill_image_sizes(views, cameras), skeleton, aliases, config)
    problems = find_problems(
        views,
        report,
        cameras=cameras,
        skeleton=skeleton,
        aliases=aliases,
        config=config,
        mends=source.mends,
        cropped=source.options.cropped(views),
    )
    report["findings"] = [
        *(_finding(str(error), critical=True) for error in errors),
        *(_finding(each.message, critical=each.critical) for each in problems),
        *map(_finding, (*notes, *describe_filled(views))),
    ]
    return report


def _finding(message: str, *, critical: bool = False) -> dict[str, str]:
    """Return a finding as the report has it."""
    return {"level": "CRITICAL" if critical else "WARNING", "message": message}


def _is_critical(report: dict[str, Any]) -> bool:
    """Return whether a run could not work."""
    return any(finding["level"] == "CRITICAL" for finding in report["findings"])


def _compare_clocks(report: dict[str, Any], typed: Typed, file: "CameraFile | None") -> None:
    """Add to the report how the clocks of the cameras differ, and a finding for each that does."""
    from mocap_calib.clocks.estimate import estimate_clocks
    from mocap_calib.config import Config
    from mocap_calib.faults.hypotheses import clock_faults, describe_clock, option_of
    from mocap_calib.job.load import load_recording
    from mocap_calib.lift import RememberedLift
    from mocap_calib.lift.lifter import choose_model
    from mocap_calib.results import Clocks
    from mocap_calib.types import silent
    from mocap_calib_cli import inputs

    recording = load_recording(inputs.keypoint_source(typed), file).recording
    recording, lifter = choose_model(recording, recording.model)
    cameras = estimate_clocks(recording, RememberedLift(lifter, silent), {}, Config(), seed=0)
    clocks = Clocks.of_one(recording, cameras)
    report["clocks"] = [describe_clock(clock, clocks) for clock in clocks.cameras]
    for fault in clock_faults(clocks, applied=True):
        advice = f"say {option_of(fault.mend)}" if fault.mend else "a run mends it"
        report["findings"].append(_finding(f"{fault.camera}: {fault.says}; {advice}"))
    if all(clock.kind == "not known" for clock in clocks.cameras):
        message = "too little moves, or too few frames are shared, to compare the cameras' clocks"
        report["findings"].append(_finding(message))


def _describe(report: dict[str, Any]) -> list[Line]:
    """Return the report for a person."""
    from mocap_calib.errors import count

    lines = _describe_cameras(report)
    if report["pairs"]:
        names = [camera["name"] for camera in report["cameras"]]
        shared = {(pair["a"], pair["b"]): str(pair["covisible"]) for pair in report["pairs"]}
        shared |= {(b, a): frames for (a, b), frames in shared.items()}
        rows = [[name, *(shared.get((name, other), "-") for other in names)] for name in names]
        lines += ["", "frames in which both see somebody:", *format_table(["", *names], rows)]
    findings = [
        Line("{level}: {message}".format_map(finding), f"bold {_COLOURS[finding['level']]}")
        for finding in report["findings"]
    ]
    found = count(len(findings), "finding") if findings else "nothing stands in the way"
    return [*map(Line, [*lines, ""]), *findings, Line(found)]


def _describe_cameras(report: dict[str, Any]) -> list[str]:
    """Return a table of the cameras, a line on the joints, and details of each camera."""
    from mocap_calib.errors import count

    cameras, model = report["cameras"], report["model"]
    if not cameras:
        return []
    unknown = f", not: {', '.join(model['unknown'])}" if model["unknown"] else ""
    return [
        *format_table(list(_COLUMNS), [_camera_row(camera) for camera in cameras]),
        "",
        *(f"{name:<10}  {meaning}" for name, meaning in _COLUMNS.items() if meaning),
        "",
        f"the model of {model['name']} knows {count(model['knows'], 'joint')}{unknown}",
        *(f"{camera['name']}: {line}" for camera in cameras for line in _details(camera)),
    ]


def _camera_row(camera: dict[str, Any]) -> list[str]:
    """Return the row of a camera, in the order of _COLUMNS."""
    frames, score, size = camera["frames"], camera["confidence"], camera["image"]["size"]
    missing = sum(entry["share"] for entry in camera["missing"].values())
    return [
        camera["name"],
        str(frames["count"]),
        f"{frames['first']}-{frames['last']}",
        str(len(frames["gaps"])),
        str(camera["detections"]),
        str(camera["most_at_once"]),
        "yes" if camera["followed"] else "no",
        str(len(camera["keypoints"])),
        f"{missing if camera['points'] else 1.0:.0%}",
        "-" if score["most"] is None else f"{score['least']:.2f}-{score['most']:.2f}",
        "x".join(map(str, size)) if any(size) else "?",
        f"{camera['image']['covered']:.0%}",
    ]


def _details(camera: dict[str, Any]) -> list[str]:
    """Return lines on what the table has no room for."""
    from mocap_calib.errors import count

    missing = [
        f"{name}: {entry['points']} ({entry['share']:.1%})"
        for name, entry in camera["missing"].items()
    ]
    gaps = [f"{a}-{b}" if a != b else str(a) for a, b in camera["frames"]["gaps"]]
    named = [*gaps[:_LISTED_GAPS], *(["..."] if len(gaps) > _LISTED_GAPS else [])]
    image, score = camera["image"], format_number(camera["confidence"]["median"])
    ends = [
        f"{axis} {least:.0f} to {most:.0f}"
        for axis, least, most in zip("xy", image["least"] or "", image["most"] or "", strict=False)
    ]
    motion = f"{format_number(camera['motion'])} of their size"
    lines = {
        f"missing by {', '.join(missing)}": missing,
        f"nobody in {count(camera['empty_frames'], 'frame')}": camera["empty_frames"],
        f"no frames {', '.join(named)}": gaps,
        f"never seen: {', '.join(camera['never_seen'])}": camera["never_seen"],
        f"bodies of two frames are up to {motion} apart": camera["motion"] is not None,
        f"{', '.join(ends)}, median score {score}": ends,
    }
    return [camera["source"], *keep_lines(lines), *camera["remarks"]]
