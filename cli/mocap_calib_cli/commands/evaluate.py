"""mocap-calib evaluate: a rig against a reference."""

import json
from typing import Any

from mocap_calib_cli import values
from mocap_calib_cli.options import AS_JSON, argument, option
from mocap_calib_cli.screen import echo
from mocap_calib_cli.typed import Typed, as_command


@as_command(
    "evaluate",
    argument("rig", values.INPUT, "CAMERAS"),
    option("--reference", values.INPUT, required=True, metavar="REFERENCE"),
    AS_JSON,
)
def command(typed: Typed) -> None:
    """Compare CAMERAS with a reference calibration.

    E_R and E_t are the errors of each pair of cameras in degrees: of its relative rotation, and of
    the direction from one camera to the other. RRA and RTA are the shares of pairs whose E_R or E_t
    is below a number of degrees. AUC is the mean of the smaller of the two at 1, 2, ... degrees up
    to that number. The last line has the errors of the cameras after the two rigs were aligned.
    Cameras of the reference that CAMERAS lacks count as 180 degrees wrong.

    \b
    Example, in the folder examples/three_people:
      mocap-calib evaluate out/cameras.yaml --reference reference.toml
      mocap-calib evaluate out/cameras.yaml --reference reference.toml --json

    reference: Calibration to compare with, in any camera format of docs/formats.md, with the same
        names of cameras; - reads stdin.
    as_json: Figures as JSON instead of a table.
    """
    from mocap_calib.verdict.evaluation import evaluate, evaluation_to_dict
    from mocap_calib_cli import inputs

    found, found_file = inputs.read_rig(typed.rig, "CAMERAS")
    expected, expected_file = inputs.read_rig(typed.reference, "--reference")
    for note in (*found_file.notes, *expected_file.notes):
        echo(note, err=True)
    figures = evaluation_to_dict(evaluate(found, expected))
    if typed.as_json:
        echo(json.dumps(figures, indent=1, allow_nan=False))
    else:
        echo("\n".join(_describe(figures)))


def _describe(figures: dict[str, Any]) -> list[str]:
    """Return the errors of all pairs, the shares of pairs below limits, and those of cameras."""
    from mocap_calib_cli.screen import format_number, format_table, keep_lines

    turns, ways = figures["rotation_error_deg"], figures["translation_error_deg"]
    errors = [
        (f"{pair['a']} - {pair['b']}", pair["rotation_error_deg"], pair["translation_error_deg"])
        for pair in figures["pairs"]
    ]
    errors += [(name, turns[name], ways[name]) for name in ("median", "max")]
    pairs = [[name, format_number(turn), format_number(way)] for name, turn, way in errors]
    measures = [figures[name] for name in ("rra", "rta", "auc")]
    shares = [
        [f"below {degrees} deg", *(format_number(measure[degrees]) for measure in measures)]
        for degrees in figures["rra"]
    ]
    turn, centre = figures["camera_rotation_error_deg"], figures["centre_error"]
    return [
        *format_table(["pair", "E_R deg", "E_t deg"], pairs),
        "",
        *format_table(["share of pairs", "RRA", "RTA", "AUC"], shares),
        "",
        f"after alignment: rotation {turn['median']:.2f} deg (max {turn['max']:.2f}), "
        f"centre {centre['median']:.4g} {figures['unit']} (max {centre['max']:.4g})",
        *keep_lines({f"missing: {', '.join(figures['missing'])}": figures["missing"]}),
    ]
