"""mocap-calib doctor: check the machine and the installation."""

import json
from typing import Any

import click

from mocap_calib_cli.options import AS_JSON, option
from mocap_calib_cli.screen import echo
from mocap_calib_cli.typed import Typed, as_command

_REPORT = (
    "attach to a bug report: the command, all its output, run.json if there is one, and the "
    "output of mocap-calib doctor --json"
)


@as_command("doctor", option("--no-self-test"), AS_JSON)
def command(typed: Typed) -> int:
    """Check the machine, the installed packages and the models, and calibrate a known recording.

    The recording is simulated and takes some seconds: its result is compared with the truth.
    Nothing is sent anywhere. The exit status is 1 where something is wrong.

    \b
    Example:
      mocap-calib doctor
      mocap-calib doctor --json >doctor.json

    no_self_test: Do not calibrate the small recording.
    as_json: All that was found as JSON, for a bug report.
    """
    from mocap_calib.doctor import examine

    found = examine(self_test=not typed.no_self_test)
    if typed.as_json:
        echo(json.dumps(found, indent=1, allow_nan=False))
    else:
        _show(found)
    return int(bool(found["findings"]))


def _show(found: dict[str, Any]) -> None:
    """Write what was found, and the faults, as text; rich may be the package that is broken."""
    for part, values in found.items():
        if part != "findings":
            echo(part.replace("_", "-"))
            for name, value in (values or {}).items():
                echo(f"  {name:24}  {'none' if value in (None, []) else value}")
    for finding in found["findings"]:
        click.secho(f"wrong: {finding}", fg="red", bold=True)
    if not found["findings"]:
        click.secho("nothing is wrong", fg="green", bold=True)
    echo(_REPORT)
