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
from mocap_calib_cli.screen import Line, Reporter, Table, format_number
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
_NEXT = "bold"
_NOT_SCALED = (
    "lengths are arbitrary: one that is known sets the scale (--height, --length, "
    "--camera-distance; afterwards `mocap-calib scale`)"
)
_UNIT_OF_FILE = (
    "lengths are arbitrary, as the file of the world does not say its unit: `mocap-calib convert "
    "FILE NEW --input-unit m` writes it down; a known length (--height, --length, "
    "--camera-distance) says another"
)
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
    verdict: str,
    place: object,
    typed: Typed,
    *,
    reasons: Sequence[str] = (),
    counts: bool = True,
    next_step: str = "",
) -> None:
    """Write the verdict with its reasons, and the one thing to do next; all that a person must see.

    A doubtful verdict is a warning, which --quiet leaves with its reasons.

    place: where the files are. reasons: for the verdict, of which the first is the most urgent.
    counts: the exit status follows from this verdict. next_step: where there are no reasons.
    """
    line = f"{place}: rig {verdict}{advice_on(verdict)}"
    if verdict in _DOUBTFUL:
        line = f"mocap-calib: {line}"
        if counts and exit_status(verdict, typed):
            remedy = "leave out --strict" if typed.strict else "say --accept not-determined"
            line += f"; all files are written, and the exit status is 1: {remedy} if they will do"
        if typed.quiet:
            reporter.warn(line, *(f"  {reason}" for reason in reasons))
    reporter.show(Line(line, STYLES[verdict]), *explain(reasons, next_step))


def explain(reasons: Sequence[str], next_step: str = "") -> list[Line]:
    """Return the reasons for a verdict, a line each, the most urgent first; else the next step."""
    if not reasons:
        return [Line(f"next: {next_step}", _NEXT)] if next_step else []
    return [Line(f"  {reason}", "" if place else _NEXT) for place, reason in enumerate(reasons)]


# --- the cameras of a group


def camera_table(report: dict[str, Any]) -> Table:
    """Return a row for each camera: what it saw, how well that fits, and what is wrong.

    report: what `run_report` returns.
    """
    cameras = report["cameras"]
    errors = [camera["reprojection_error_px"]["median"] for camera in cameras]
    columns = {
        "camera": [camera["name"] for camera in cameras],
        "detections": [str(camera["detections"]) for camera in cameras],
        "matched": [str(camera["matched"]) for camera in cameras],
        "error px": [format_number(error) for error in errors],
        "sigma deg": [format_number(camera["rotation_sigma_deg"]) for camera in cameras],
        "sigma %": [format_number(camera["centre_sigma_percent"]) for camera in cameras],
    }
    if report["unit"] != ARBITRARY:
        lengths = [f"{camera['centre_sigma']:.2g}" for camera in cameras]
        columns[f"sigma {report['unit']}"] = lengths
    columns["clock"] = [_frames_late(camera["clock"]) for camera in cameras]
    if any(camera["intrinsics"]["source"] != "given" for camera in cameras):
        columns["focal px"] = [_focal(camera["intrinsics"]) for camera in cameras]
    columns["faults"] = [", ".join(_faults(camera)) or "-" for camera in cameras]
    return Table(tuple(columns), tuple(zip(*columns.values(), strict=True)), "faults")


def _frames_late(clock: dict[str, Any]) -> str:
    """Return by what part of a frame a clock is late, a dash where that was not used."""
    return f"{clock['subframe_offset']:+.2f}" if clock["used"] else "-"


def _focal(found: dict[str, Any]) -> str:
    """Return a focal length with its standard deviation, a dash where it is as given."""
    if found["source"] == "given":
        return "-"
    sigma = format_number(found["focal_sigma_px"], 0)
    known = "" if found["source"] == "estimated" else " ?"
    return f"{found['focal_px']:.0f} +- {sigma}{known}"


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
    return [
        *_describe_mended(report),
        *_describe_clocks(report),
        *describe_rig(report),
        *_describe_pairs(report),
        *_describe_epochs(report, folder),
        *describe_world(report["world"]),
        _describe_results(report, folder),
    ]


def describe_rig(report: dict[str, Any]) -> list[str]:
    """Return how sure cameras are, and what nothing that was seen determines.

    report: what `run_report` returns.
    """
    turn, shift = (report["verdict"][key] for key in ("rotation_sigma_deg", "centre_sigma_percent"))
    lines = [
        f"rotations are uncertain by {turn['median']:.2f} deg (worst camera {turn['max']:.2f}), "
        f"places by {shift['median']:.1f} % of the rig ({shift['max']:.1f}), a standard deviation "
        "each"
    ]
    if len(report["cameras"]) > 2:
        worst = report["verdict"]["least_sure_pair"]
        lines.append(
            f"least sure pair: {worst['a']} and {worst['b']}; the rotation between them is "
            f"uncertain by {worst['rotation_sigma_deg']:.2f} deg, the way between them by "
            f"{worst['centre_sigma_percent']:.1f} % of the rig"
        )
    if any(camera["intrinsics"]["source"] == "not determined" for camera in report["cameras"]):
        lines.append(
            "focal lengths with a ? are not determined, and as given or assumed: give --cameras, "
            "or record with three cameras or more from different heights and sides"
        )
    if any(camera["weak_perspective"] for camera in report["cameras"]):
        lines.append(
            "weak perspective, translation not observable: so far away or of such long focal "
            "length that images show no perspective; distances follow from the focal lengths alone"
        )
    return lines


def _describe_mended(report: dict[str, Any]) -> list[str]:
    """Say what is wrong with the files of cameras, and what was done about it."""
    lines = []
    for camera in report["cameras"]:
        for fault in camera["fault_evidence"].values():
            line = f"{camera['name']}: {fault['says']}"
            if fault["mended"]:
                line += f"; mended for this run: {fault['advice']}"
                line += f", or say {fault['option']}" if fault["option"] else ""
            lines.append(line)
    return lines


def _describe_clocks(report: dict[str, Any]) -> list[str]:
    """Say what the parts of a frame are by which clocks are off, where that was used."""
    if not any(camera["clock"]["used"] for camera in report["cameras"]):
        return []
    first = report["cameras"][0]["name"]
    return [
        f"clock: frames late beside {first}; rig and poses are made with that, poses at the clock "
        f"of {first}"
    ]


def _describe_pairs(report: dict[str, Any]) -> list[str]:
    """Say which pairs do not go together with the others."""
    contradict = [
        f"{pair['a']}-{pair['b']} by {pair['loop_rotation_deg']:.1f} deg"
        for pair in report["pairs"]
        if pair["breaks_loop"]
    ]
    if not contradict:
        return []
    return [
        f"pairs that contradict the others and were given little weight: {_name_some(contradict)}"
    ]


def _name_some(names: list[str]) -> str:
    """Return names with commas between them, the number of what is too much for a line."""
    further = len(names) - _MOST_PAIRS
    return ", ".join(names[:_MOST_PAIRS]) + (f" and {further} more" if further > 0 else "")


def _describe_epochs(report: dict[str, Any], folder: Path) -> list[str]:
    """Say where the rig of each part of the recording is, where a camera was moved."""
    epochs = report["epochs"]
    if len(epochs) == 1:
        return []
    places = [
        f"frames {epoch['first']} to {epoch['last']} in {folder / epoch['folder']}"
        for epoch in epochs
    ]
    return [f"{len(epochs)} rigs, as cameras were moved: {', '.join(places)}"]


def _describe_results(report: dict[str, Any], folder: Path) -> str:
    """Say how much was found, and where it is."""
    counts = [individual["frames"] for individual in report["individuals"]] or [0]
    frames = str(min(counts)) if min(counts) == max(counts) else f"{min(counts)} to {max(counts)}"
    line = (
        f"{count(len(report['individuals']), 'individual')} in {frames} of "
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
    unmet = [f"not as asked for: {world[key]}" for key in _UNMET if world[key]]
    details = [
        *unmet,
        *map(_describe_cue, world["cues"]),
        *map(_describe_landmark, world["landmarks"]),
    ]
    return [f"world: {'; '.join(said)}", *(f"  {line}" for line in details)]


def _describe_unit(world: Mapping[str, Any]) -> str:
    """Return what lengths are in, and how sure that is."""
    if world["unit"] == ARBITRARY:
        return _UNIT_OF_FILE if world["kind"] == "file" else _NOT_SCALED
    sigma = world["scale_sigma_percent"]
    sure = "" if sigma is None else f", uncertain by {sigma:.1f} %, a standard deviation"
    return f"lengths are in {world['unit']}{sure}"


def _describe_cue(cue: Mapping[str, Any]) -> str:
    """Return what a known length is by all of them; of a single one there is nothing to compare."""
    if cue["residual"] is None:
        return f"{cue['cue']}: {cue['metres']:g} m"
    return (
        f"{cue['cue']}: {cue['metres']:g} m, {cue['measured']:.4g} m by all cues "
        f"({cue['residual']:+.1f} sigma)"
    )


def _describe_landmark(landmark: Mapping[str, Any]) -> str:
    """Return how far a landmark is from its place."""
    away = landmark["distance_m"]
    if away is None:
        return f"landmark {landmark['name']}: not used, two cameras that agree on it are needed"
    return f"landmark {landmark['name']}: {1e3 * away:.0f} mm from its place"
