"""How commands end: a table of the cameras, what else a person must know, the verdict, the status.

What is wrong with a camera stands in its row; why it matters, and what to do, is in the reasons of
the verdict (`conclude`) and nowhere else.

All files are written whatever the verdict is. The exit status follows from the verdict on the
largest group of cameras: its files lie in the folder that was asked for, and scripts go on with
them.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from mocap_calib.errors import count
from mocap_calib.io.provenance import advice_on
from mocap_calib.io.results.group import REVERSED_RIG
from mocap_calib.types import ARBITRARY
from mocap_calib_cli.screen import Line, Reporter, Table, format_length, format_number, keep_lines
from mocap_calib_cli.typed import Typed

_MOST_PAIRS = 6  # that are named in a line
_USELESS = "not determined"
_DOUBTFUL = ("weak", _USELESS)  # what nobody may overlook
STYLES = {
    "well determined": "bold green",
    "usable": "green",
    "weak": "bold yellow",
    _USELESS: "bold red",
}
_NOT_SCALED = (
    "no scale is set: give a known length (--height, --length, --camera-distance), or use "
    "`mocap-calib scale` afterwards"
)
_UNIT_OF_FILE = (
    "no scale is set, as the file of the world has no unit: give it one by `mocap-calib convert "
    "FILE NEW --input-unit m`, or give a known length (--height, --length, --camera-distance)"
)
_FOCAL = (
    "focal lengths with a ? are not determined: give --cameras, or record with three cameras or "
    "more from different heights and sides"
)
_FAR = "weak perspective: images show no perspective, distances follow from focal lengths alone"
_UNMET = ("axes_unmet", "scale_unmet")


# --- the verdict


def check_demands(typed: Typed) -> None:
    """Raise click's UsageError where what was typed asks for one thing and its opposite."""
    if typed.strict and typed.accept:
        raise click.UsageError(
            f"--strict: expected it without --accept, found --accept {typed.accept}; "
            "give one of them"
        )


def exit_status(verdict: str, typed: Typed) -> int:
    """Return 0 where results of a verdict will do, and 1 where they will not.

    verdict: one of `results.VERDICTS`.
    """
    if typed.strict:
        return int(verdict in _DOUBTFUL)
    return int(verdict == _USELESS and not typed.accept)


def conclude(
    reporter: Reporter,
    verdict: Mapping[str, Any],
    place: object,
    typed: Typed,
    *,
    counts: bool = True,
    next_step: str = "",
) -> None:
    """Write the verdict with its reasons, and the one thing to do next; all that a person must see.

    A doubtful verdict is a warning, which --quiet leaves with its reasons.

    verdict: as `run_report` has it. place: where the files are.
    counts: the exit status follows from this verdict. next_step: where there are no reasons.
    """
    word, reasons = verdict["rig"], verdict["reasons"]
    line = f"{place}: rig {word}{advice_on(word)}"
    if word in _DOUBTFUL:
        line = f"mocap-calib: {line}"
        if counts and exit_status(word, typed):
            remedy = "leave out --strict" if typed.strict else "say --accept not-determined"
            line += f"; all files are written, and the exit status is 1: {remedy} if they will do"
        if typed.quiet:
            reporter.warn(line, *(f"  {reason}" for reason in reasons))
    reporter.show(Line(line, STYLES[word]), *explain(reasons, next_step))


def explain(reasons: Sequence[str], next_step: str = "") -> list[Line]:
    """Return the reasons for a verdict, a line each, the most urgent first; else the next step."""
    lines = [f"  {reason}" for reason in reasons] or [f"next: {next_step}"] * bool(next_step)
    return [Line(line, "" if place else "bold") for place, line in enumerate(lines)]


# --- the cameras of a group


def camera_table(report: dict[str, Any]) -> Table:
    """Return a row for each camera: what it saw, how well that fits, and what is wrong.

    report: what `run_report` returns.
    """
    rows = [_camera_row(camera, report["unit"]) for camera in report["cameras"]]
    unused = {f"sigma {ARBITRARY}"}
    if all(camera["intrinsics"]["source"] == "given" for camera in report["cameras"]):
        unused.add("focal px")
    header = [name for name in rows[0] if name not in unused]
    return Table(header, [[row[name] for name in header] for row in rows], "faults")


def _camera_row(camera: dict[str, Any], unit: str) -> dict[str, str]:
    """Return the cells of a camera by the headers of their columns."""
    clock = camera["clock"]
    return {
        "camera": camera["name"],
        "detections": str(camera["detections"]),
        "matched": str(camera["matched"]),
        "error px": format_number(camera["reprojection_error_px"]["median"]),
        "sigma deg": format_number(camera["rotation_sigma_deg"]),
        "sigma %": format_number(camera["centre_sigma_percent"]),
        f"sigma {unit}": format_length(camera["centre_sigma"]),
        "clock": f"{clock['subframe_offset']:+.2f}" if clock["used"] else "-",
        "focal px": _focal(camera["intrinsics"]),
        "faults": ", ".join(_faults(camera)) or "-",
    }


def _focal(found: dict[str, Any]) -> str:
    """Return a focal length with its standard deviation, a dash where it is as given."""
    if found["source"] == "given":
        return "-"
    known = "" if found["source"] == "estimated" else " ?"
    return f"{found['focal_px']:.0f} +- {format_number(found['focal_sigma_px'], 0)}{known}"


def _faults(camera: dict[str, Any]) -> list[str]:
    """Return the words for what is wrong with a camera; those of its file say if it was mended."""
    evidence = camera["fault_evidence"]
    mended = [word for word in evidence if evidence[word]["mended"]]
    said = [f"{word} (mended)" if word in mended else word for word in camera["faults"]]
    own = {"low pair score": "weak", "weak perspective": "weak_perspective"}
    return said + [word for word, key in own.items() if camera[key]]


def describe_group(report: dict[str, Any], folder: Path) -> list[str]:
    """Return what is to be known of a group of cameras beside the table, a line each.

    report: as `run.json` has it. folder: where the files of the group are.
    """
    first = report["cameras"][0]["name"]
    contradict = [
        f"{pair['a']}-{pair['b']} by {pair['loop_rotation_deg']:.1f} deg"
        for pair in report["pairs"]
        if pair["breaks_loop"]
    ]
    further = len(contradict) - _MOST_PAIRS
    pairs = ", ".join(contradict[:_MOST_PAIRS]) + (f" and {further} more" if further > 0 else "")
    epochs = [
        f"frames {epoch['first']} to {epoch['last']} in {folder / epoch['folder']}"
        for epoch in report["epochs"]
    ]
    clocks = {
        f"clock: frames late beside {first}; rig and poses are made with that, poses at the clock "
        f"of {first}": any(camera["clock"]["used"] for camera in report["cameras"])
    }
    cases = {
        f"pairs that contradict the others and were given little weight: {pairs}": contradict,
        f"{len(epochs)} rigs, as cameras were moved: {', '.join(epochs)}": len(epochs) > 1,
    }
    return [
        *_describe_mended(report),
        *keep_lines(clocks),
        *describe_rig(report),
        *keep_lines(cases),
        *describe_world(report["world"]),
        _describe_results(report, folder),
    ]


def describe_rig(report: dict[str, Any]) -> list[str]:
    """Return how sure cameras are, and what nothing that was seen determines.

    report: what `run_report` returns.
    """
    cameras, verdict = report["cameras"], report["verdict"]
    turn, shift = verdict["rotation_sigma_deg"], verdict["centre_sigma_percent"]
    lines = [
        f"camera uncertainty (1 SD): {turn['median']:.2f} deg, worst {turn['max']:.2f}; "
        f"{shift['median']:.1f} % of the rig size, worst {shift['max']:.1f}"
    ]
    if len(cameras) > 2:
        worst = verdict["least_sure_pair"]
        lines.append(
            f"least sure pair: {worst['a']} and {worst['b']}, rotation "
            f"+-{worst['rotation_sigma_deg']:.2f} deg, baseline "
            f"+-{worst['centre_sigma_percent']:.1f} % of the rig size"
        )
    unknown = [camera["intrinsics"]["source"] == "not determined" for camera in cameras]
    cases = {_FOCAL: any(unknown), _FAR: any(camera["weak_perspective"] for camera in cameras)}
    return lines + keep_lines(cases)


def _describe_mended(report: dict[str, Any]) -> list[str]:
    """Say what is wrong with the files of cameras, and what was done about it."""
    lines = []
    for camera in report["cameras"]:
        for fault in camera["fault_evidence"].values():
            own = f", or say {fault['option']}" if fault["option"] else ""
            done = f"; corrected in this run: {fault['advice']}{own}" if fault["mended"] else ""
            lines.append(f"{camera['name']}: {fault['says']}{done}")
    return lines


def _describe_results(report: dict[str, Any], folder: Path) -> str:
    """Say how much was found, and where it is."""
    counts = [individual["frames"] for individual in report["individuals"]] or [0]
    line = (
        f"{count(len(report['individuals']), 'individual')} in "
        f"{' to '.join(map(str, sorted({min(counts), max(counts)})))} of "
        f"{count(report['frames']['count'], 'frame')}, "
        f"{count(report['points']['triangulated'], 'point')}; results in {folder}"
    )
    if report["verdict"]["reversal"] == "not observable":
        line += f", the rig reversed in depth in {folder / REVERSED_RIG}"
    return line


# --- the world


def describe_world(world: Mapping[str, Any]) -> list[str]:
    """Say in a line what the coordinates are, then what each known length and landmark says.

    world: as `io.world_fields` has it.
    """
    said = [*world["remarks"], _describe_unit(world)]
    if world["kind"] == "floor":
        said.insert(0, "z is up, the origin is on the floor")
    lines = [f"world: {'; '.join(said)}"]
    lines += [f"  not as asked for: {world[key]}" for key in _UNMET if world[key]]
    for cue in world["cues"]:
        lines.append(f"  {cue['cue']}: {cue['metres']:g} m")
        if cue["residual"] is not None:  # of a single cue there is nothing to compare
            residual = f"{cue['residual']:+.1f} sigma"
            lines[-1] += f", {cue['measured']:.4g} m by all cues ({residual})"
    for landmark in world["landmarks"]:
        away = landmark["distance_m"]
        unused = "not used, two cameras that agree on it are needed"
        place = unused if away is None else f"{1e3 * away:.0f} mm from its place"
        lines.append(f"  landmark {landmark['name']}: {place}")
    return lines


def _describe_unit(world: Mapping[str, Any]) -> str:
    """Return what lengths are in, and how sure that is."""
    if world["unit"] == ARBITRARY:
        return _UNIT_OF_FILE if world["kind"] == "file" else _NOT_SCALED
    sigma = world["scale_sigma_percent"]
    sure = "" if sigma is None else f", uncertain by {sigma:.1f} %, a standard deviation"
    return f"lengths are in {world['unit']}{sure}"
