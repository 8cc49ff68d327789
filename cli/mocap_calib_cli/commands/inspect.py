"""mocap-calib inspect: what is in keypoint files, before any calibration."""

import json
from typing import Any

import click

from mocap_calib_cli import options
from mocap_calib_cli.typed import Typed, as_command

_COLOURS = {"CRITICAL": "red", "WARNING": "yellow"}
_COLUMNS = {  # heading -> what it means
    "camera": "",
    "frames": "in the file",
    "range": "number of the first frame and of the last",
    "gaps": "places between them where frame numbers are not there",
    "detections": "bodies found, in all frames together",
    "at once": "most detections in one frame",
    "followed": "whether the file says who is who from frame to frame",
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
    report = _inspect(typed)
    if typed.sync and not _is_critical(report):
        _compare_clocks(report, typed)
    if typed.as_json:
        click.echo(json.dumps(report, indent=1, allow_nan=False))
    else:
        click.echo("\n".join(_describe(report)))
    return int(_is_critical(report))


def _inspect(typed: Typed) -> dict[str, Any]:
    """Return what the files hold, and the findings."""
    from mocap_calib.inspection.contents import InspectConfig, fill_image_sizes, inspect_views
    from mocap_calib.inspection.problems import Finding, find_problems
    from mocap_calib.io.filled_table import describe_filled
    from mocap_calib.io.keypoints import read_what_can
    from mocap_calib.recording.joints import fit_vocabulary
    from mocap_calib_cli import inputs

    config = InspectConfig()
    views, errors = read_what_can(typed.keypoints, typed.format, inputs.read_options(typed))
    file = inputs.load_camera_file(typed.cameras, "--cameras") if typed.cameras else None
    cameras, notes = (file.cameras, file.notes) if file else ((), ())
    names = (name for view in views for name in view.keypoints)
    skeleton, aliases = fit_vocabulary(names, typed.skeleton)
    report = inspect_views(fill_image_sizes(views, cameras), skeleton, aliases, config)
    problems = find_problems(
        views, report, cameras=cameras, skeleton=skeleton, aliases=aliases, config=config
    )
    found = [
        *(Finding(True, str(error)) for error in errors),
        *problems,
        *(Finding(False, note) for note in (*notes, *describe_filled(views))),
    ]
    report["findings"] = [
        {"level": "CRITICAL" if each.critical else "WARNING", "message": each.message}
        for each in found
    ]
    return report


def _is_critical(report: dict[str, Any]) -> bool:
    """Return whether a run could not work."""
    return any(finding["level"] == "CRITICAL" for finding in report["findings"])


def _compare_clocks(report: dict[str, Any], typed: Typed) -> None:
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

    file = inputs.load_camera_file(typed.cameras, "--cameras") if typed.cameras else None
    recording = load_recording(inputs.keypoint_source(typed), file).recording
    recording, lifter = choose_model(recording, recording.model)
    lift_sample = RememberedLift(lifter, silent)
    cameras = estimate_clocks(recording, lift_sample, {}, Config(), seed=0)
    clocks = Clocks.of_one(recording, cameras)
    report["clocks"] = [describe_clock(clock, clocks) for clock in clocks.cameras]
    for fault in clock_faults(clocks, applied=True):
        option = option_of(fault.mend) if fault.mend else ""
        advice = f"; say {option}" if option else "; a run mends it"
        message = f"{fault.camera}: {fault.says}{advice}"
        report["findings"].append({"level": "WARNING", "message": message})
    if all(clock.kind == "not known" for clock in clocks.cameras):
        message = "too little moves, or too few frames are shared, to compare the cameras' clocks"
        report["findings"].append({"level": "WARNING", "message": message})


def _describe(report: dict[str, Any]) -> list[str]:
    """Return the report for a person."""
    from mocap_calib.errors import count

    lines = _describe_cameras(report)
    if report["pairs"]:
        lines += ["", "frames in which both see somebody:", *_pair_table(report)]
    lines.append("")
    for finding in report["findings"]:
        level = finding["level"]
        lines.append(click.style(f"{level}: ", fg=_COLOURS[level], bold=True) + finding["message"])
    findings = count(len(report["findings"]), "finding")
    return [*lines, findings if report["findings"] else "nothing stands in the way"]


def _describe_cameras(report: dict[str, Any]) -> list[str]:
    """Return a table of the cameras, a line on the joints, and details of each camera."""
    from mocap_calib.errors import count
    from mocap_calib_cli.screen import format_table

    cameras = report["cameras"]
    if not cameras:
        return []
    model = report["model"]
    unknown = f", not: {', '.join(model['unknown'])}" if model["unknown"] else ""
    return [
        *format_table(list(_COLUMNS), [_camera_row(camera) for camera in cameras]),
        "",
        *_explain_columns(),
        "",
        f"the model of {model['name']} knows {count(model['knows'], 'joint')}{unknown}",
        *(f"{camera['name']}: {line}" for camera in cameras for line in _details(camera)),
    ]


def _explain_columns() -> list[str]:
    """Return a line on each column of the table."""
    return [f"{name:<10}  {meaning}" for name, meaning in _COLUMNS.items() if meaning]


def _camera_row(camera: dict[str, Any]) -> list[str]:
    """Return the row of a camera, in the order of _COLUMNS."""
    frames = camera["frames"]
    score = camera["confidence"]
    size = camera["image"]["size"]
    missing = [entry["share"] for entry in camera["missing"].values()]
    return [
        camera["name"],
        str(frames["count"]),
        f"{frames['first']}-{frames['last']}",
        str(len(frames["gaps"])),
        str(camera["detections"]),
        str(camera["most_at_once"]),
        "yes" if camera["followed"] else "no",
        str(len(camera["keypoints"])),
        f"{sum(missing) if camera['points'] else 1.0:.0%}",
        "-" if score["most"] is None else f"{score['least']:.2f}-{score['most']:.2f}",
        "x".join(map(str, size)) if any(size) else "?",
        f"{camera['image']['covered']:.0%}",
    ]


def _details(camera: dict[str, Any]) -> list[str]:
    """Return lines on what the table has no room for."""
    from mocap_calib.errors import count

    lines = [camera["source"]]
    if camera["missing"]:
        customs = [
            f"{name}: {entry['points']} ({entry['share']:.1%})"
            for name, entry in camera["missing"].items()
        ]
        lines.append(f"missing by {', '.join(customs)}")
    if camera["empty_frames"]:
        lines.append(f"nobody in {count(camera['empty_frames'], 'frame')}")
    if camera["frames"]["gaps"]:
        lines.append(f"no frames {_describe_gaps(camera['frames']['gaps'])}")
    if camera["never_seen"]:
        lines.append(f"never seen: {', '.join(camera['never_seen'])}")
    if camera["motion"] is not None:
        apart = f"{camera['motion']:.2f} of their size"
        lines.append(f"bodies of two frames are up to {apart} apart")
    if camera["image"]["least"]:
        lines.append(_describe_span(camera))
    return lines + camera["remarks"]


def _describe_gaps(gaps: list[list[int]]) -> str:
    """Return the first few gaps."""
    listed = [
        str(first) if first == last else f"{first}-{last}" for first, last in gaps[:_LISTED_GAPS]
    ]
    return ", ".join([*listed, "..."] if len(gaps) > _LISTED_GAPS else listed)


def _describe_span(camera: dict[str, Any]) -> str:
    """Return where in the image the points lie, and how sure the detector is of them."""
    from mocap_calib_cli.screen import format_number

    x0, y0, x1, y1 = (
        format_number(value, 0) for value in (*camera["image"]["least"], *camera["image"]["most"])
    )
    score = format_number(camera["confidence"]["median"])
    return f"x {x0} to {x1}, y {y0} to {y1}, median score {score}"


def _pair_table(report: dict[str, Any]) -> list[str]:
    """Return the table of the frames that pairs of cameras see together."""
    from mocap_calib_cli.screen import format_table

    names = [camera["name"] for camera in report["cameras"]]
    covisible = {
        frozenset((pair["a"], pair["b"])): str(pair["covisible"]) for pair in report["pairs"]
    }
    rows = [
        [name, *(covisible.get(frozenset((name, other)), "-") for other in names)] for name in names
    ]
    return format_table(["", *names], rows)
