"""mocap-calib evaluate: a rig against a reference."""

import json
from typing import Any

import click

from mocap_calib_cli import values
from mocap_calib_cli.options import AS_JSON, argument, option
from mocap_calib_cli.typed import Typed, as_command


@as_command(
    "evaluate",
    argument("rig", values.RIG, "CAMERAS"),
    option("--reference", values.REFERENCE, required=True, metavar="REFERENCE"),
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

    reference: File with the reference calibration; - reads stdin.
    as_json: Figures as JSON instead of a table.
    """
    from mocap_calib.verdict.evaluation import evaluate, evaluation_to_dict
    from mocap_calib_cli import inputs

    found, found_file = inputs.read_rig(typed.rig, "CAMERAS")
    expected, expected_file = inputs.read_rig(typed.reference, "--reference")
    for note in (*found_file.notes, *expected_file.notes):
        click.echo(note, err=True)
    figures = evaluation_to_dict(evaluate(found, expected))
    if typed.as_json:
        click.echo(json.dumps(figures, indent=1, allow_nan=False))
    else:
        click.echo("\n".join(_describe(figures)))


def _describe(figures: dict[str, Any]) -> list[str]:
    """Return the figures as tables and lines."""
    lines = [*_pair_table(figures), "", *_share_table(figures), "", _describe_cameras(figures)]
    if figures["missing"]:
        lines.append(f"missing: {', '.join(figures['missing'])}")
    return lines


def _pair_table(figures: dict[str, Any]) -> list[str]:
    """Return a table of the errors of all pairs, with their median and maximum."""
    from mocap_calib_cli.screen import format_number, format_table

    rotation = figures["rotation_error_deg"]
    translation = figures["translation_error_deg"]
    errors = [
        (f"{pair['a']} - {pair['b']}", pair["rotation_error_deg"], pair["translation_error_deg"])
        for pair in figures["pairs"]
    ]
    errors += [(name, rotation[name], translation[name]) for name in ("median", "max")]
    rows = [[name, format_number(turn), format_number(shift)] for name, turn, shift in errors]
    return format_table(["pair", "E_R deg", "E_t deg"], rows)


def _share_table(figures: dict[str, Any]) -> list[str]:
    """Return a table of the shares of pairs below each threshold."""
    from mocap_calib_cli.screen import format_number, format_table

    measures = [figures[name] for name in ("rra", "rta", "auc")]
    rows = [
        [f"below {degrees} deg", *(format_number(measure[degrees]) for measure in measures)]
        for degrees in figures["rra"]
    ]
    return format_table(["share of pairs", "RRA", "RTA", "AUC"], rows)


def _describe_cameras(figures: dict[str, Any]) -> str:
    """Return a line on the errors of the cameras after alignment."""
    turn = figures["camera_rotation_error_deg"]
    centre = figures["centre_error"]
    return (
        f"after alignment: rotation {turn['median']:.2f} deg (max {turn['max']:.2f}), "
        f"centre {centre['median']:.4g} {figures['unit']} (max {centre['max']:.4g})"
    )
