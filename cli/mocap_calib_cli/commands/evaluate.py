"""mocap-calib evaluate: a rig against a reference."""

import json
from typing import Any

import click

from mocap_calib_cli import options


@click.command(name="evaluate")
@click.argument("rig", metavar="CAMERAS")
@click.option(
    "--reference",
    required=True,
    metavar="REFERENCE",
    help="File with the reference calibration; - reads stdin.",
)
@options.as_json("Figures as JSON instead of a table.")
def command(rig: str, reference: str, as_json: bool) -> None:
    """Compares CAMERAS with a reference: rotation and translation errors of all pairs, and of the cameras after alignment.

    Cameras of the reference that CAMERAS lacks count as 180 degrees wrong.

    \b
    Example:
      mocap-calib evaluate out/cameras.yaml --reference reference.toml
      mocap-calib evaluate out/cameras.yaml --reference reference.toml --json
    """
    from mocap_calib.multi_view.evaluation import evaluate_rig, evaluation_to_dict
    from mocap_calib_cli import inputs

    figures = evaluation_to_dict(
        evaluate_rig(inputs.rig_of(rig, "CAMERAS"), inputs.rig_of(reference, "--reference"))
    )
    click.echo(
        json.dumps(figures, indent=1, allow_nan=False) if as_json else "\n".join(_table(figures))
    )


def _table(figures: dict[str, Any]) -> list[str]:
    from mocap_calib_cli.progress import figure, table

    rows = [
        [
            f"{p['a']} - {p['b']}",
            figure(p["rotation_error_deg"]),
            figure(p["translation_error_deg"]),
        ]
        for p in figures["pairs"]
    ]
    rotation, translation = figures["rotation_error_deg"], figures["translation_error_deg"]
    rows += [
        [name, figure(rotation[name]), figure(translation[name])] for name in ("median", "max")
    ]
    shares = [
        [f"below {t} deg", *(figure(figures[k][t]) for k in ("rra", "rta", "auc"))]
        for t in figures["rra"]
    ]
    turn, centre, unit = (
        figures["camera_rotation_error_deg"],
        figures["centre_error"],
        figures["unit"],
    )
    return [
        *table(["pair", "E_R deg", "E_t deg"], rows),
        "",
        *table(["share of pairs", "RRA", "RTA", "AUC"], shares),
        "",
        f"after alignment: rotation {turn['median']:.2f} deg (max {turn['max']:.2f}), centre {centre['median']:.4g} {unit} (max {centre['max']:.4g})",
        *([f"missing: {', '.join(figures['missing'])}"] if figures["missing"] else []),
    ]
