"""mocap-calib inspect: what is in keypoint files, before any calibration."""

import json
from pathlib import Path
from typing import Any

import click

from mocap_calib_cli import options


@click.command(name="inspect")
@options.keypoints
@options.reading
@click.option(
    "--cameras",
    metavar="INTRINSICS",
    help="The cameras' intrinsics, to see whether they and the keypoints go together.",
)
@options.skeleton
@options.as_json("Write everything as JSON.")
def command(
    reading: dict[str, Any],
    keypoints: tuple[str, ...],
    cameras: str | None,
    skeleton: Path | None,
    as_json: bool,
) -> None:
    """Says what is in KEYPOINTS: cameras, frames and gaps, individuals, joints, missing points, scores, what pairs see together.

    What stands in the way is CRITICAL (a run could not work; exit status 1) or a WARNING, each with its remedy.

    \b
    Example:
      mocap-calib inspect keypoints/ --cameras intrinsics.toml
      mocap-calib inspect openpose/ --layout body_25b --json
    """
    from mocap_calib.config import InspectConfig
    from mocap_calib.inspection import Finding, fill_image_sizes, find_problems, inspect_views
    from mocap_calib.io.keypoints.formats import read_what_can
    from mocap_calib_cli import inputs

    views, errors = read_what_can(keypoints, reading.get("format"), inputs.read_options(reading))
    file = inputs.camera_file(cameras, "--cameras") if cameras else None
    known, notes = (file.cameras, file.notes) if file else ((), ())
    vocabulary, aliases = inputs.fitting(views, skeleton)
    report = inspect_views(fill_image_sizes(views, known), vocabulary, aliases, InspectConfig())
    stands = find_problems(
        views,
        report,
        cameras=known,
        skeleton=vocabulary,
        aliases=aliases,
        config=InspectConfig(),
    )
    found = [
        *(Finding(True, str(error)) for error in errors),
        *stands,
        *(Finding(False, note) for note in notes),
    ]
    report["findings"] = [
        {"level": "CRITICAL" if each.critical else "WARNING", "message": each.message}
        for each in found
    ]
    if as_json:
        click.echo(json.dumps(report, indent=1, allow_nan=False))
    else:
        click.echo("\n".join(_text(report)))
    if any(each.critical for each in found):
        raise click.exceptions.Exit(1)


def _text(report: dict[str, Any]) -> list[str]:
    """The report for a person."""
    from mocap_calib_cli.progress import figure, table

    cameras = report["cameras"]
    lines = []
    if cameras:
        header = [
            "camera",
            "frames",
            "range",
            "gaps",
            "detections",
            "at once",
            "followed",
            "joints",
            "missing",
            "score",
            "image",
            "covered",
        ]
        lines += table(header, [_row(camera) for camera in cameras])
        model = report["model"]
        lines += [
            "",
            f"joints: the model of {model['name']} knows {model['knows']}"
            + (f", not: {', '.join(model['unknown'])}" if model["unknown"] else ""),
        ]
    for camera in cameras:
        lines += [f"{camera['name']}: {line}" for line in _details(camera, figure)]
    if report["pairs"]:
        lines += [
            "",
            "frames in which both see somebody:",
            *table(["", *(camera["name"] for camera in cameras)], _grid(report)),
        ]
    lines += [
        "",
        *(
            click.style(f"{f['level']}: ", fg=_COLOURS[f["level"]], bold=True) + f["message"]
            for f in report["findings"]
        ),
    ]
    count = len(report["findings"])
    return [
        *lines,
        f"{count} finding{'s' if count > 1 else ''}" if count else "nothing stands in the way",
    ]


_COLOURS = {"CRITICAL": "red", "WARNING": "yellow"}


def _row(camera: dict[str, Any]) -> list[str]:
    frames, image, score = camera["frames"], camera["image"], camera["confidence"]
    share = sum(entry["share"] for entry in camera["missing"].values()) if camera["points"] else 1.0
    size = "x".join(map(str, image["size"])) if any(image["size"]) else "?"
    scores = f"{score['least']:.2f}-{score['most']:.2f}" if score["most"] is not None else "-"
    return [
        *(
            camera["name"],
            str(frames["count"]),
            f"{frames['first']}-{frames['last']}",
            str(len(frames["gaps"])),
            str(camera["detections"]),
        ),
        *(
            str(camera["most_at_once"]),
            "yes" if camera["followed"] else "no",
            str(len(camera["keypoints"])),
            f"{share:.0%}",
            scores,
        ),
        *(size, f"{image['covered']:.0%}"),
    ]


def _details(camera: dict[str, Any], figure: Any) -> list[str]:
    """Lines on what the table has no room for."""
    gaps, image = camera["frames"]["gaps"], camera["image"]
    lines = [camera["source"]]
    if camera["missing"]:
        lines.append(
            "missing by "
            + ", ".join(
                f"{name}: {entry['points']} ({entry['share']:.1%})"
                for name, entry in camera["missing"].items()
            )
        )
    if camera["empty_frames"]:
        lines.append(f"nobody in {camera['empty_frames']} frames")
    if gaps:
        listed = ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in gaps[:5]) + (
            ", ..." if len(gaps) > 5 else ""
        )
        lines.append(f"no frames {listed}")
    if camera["never_seen"]:
        lines.append(f"never seen: {', '.join(camera['never_seen'])}")
    if image["least"]:
        (x0, y0), (x1, y1) = image["least"], image["most"]
        lines.append(
            f"x {figure(x0, 0)} to {figure(x1, 0)}, y {figure(y0, 0)} to {figure(y1, 0)}, median score {figure(camera['confidence']['median'])}"
        )
    return lines + camera["remarks"]


def _grid(report: dict[str, Any]) -> list[list[str]]:
    """Rows of the grid of pairs."""
    names = [camera["name"] for camera in report["cameras"]]
    together = {
        frozenset((pair["a"], pair["b"])): str(pair["covisible"]) for pair in report["pairs"]
    }
    return [
        [name, *(together.get(frozenset((name, other)), "-") for other in names)] for name in names
    ]
