"""mocap-calib doctor: whether the machine and the installation are sound."""

import json
from typing import TYPE_CHECKING, Any

import click

from mocap_calib_cli import options

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mocap_calib_cli.screen import Line

_REPORT = (
    "with a bug report, send: what you typed, all that it said, run.json if there is one, and what "
    "mocap-calib doctor --json says"
)


@click.command(name="doctor")
@click.option("--no-self-test", is_flag=True, help="Do not calibrate the small recording.")
@options.as_json("All that was found as JSON, for a bug report.")
@click.pass_context
def command(context: click.Context, no_self_test: bool, as_json: bool) -> None:
    """Look at the machine, the installed packages and the models, and calibrate a known recording.

    The recording is simulated and takes some seconds: its result is compared with the truth.
    Nothing is sent anywhere. The exit status is 1 where something is wrong.

    \b
    Example:
      mocap-calib doctor
      mocap-calib doctor --json >doctor.json
    """
    from mocap_calib.doctor import examine
    from mocap_calib_cli.screen import show

    found = examine(self_test=not no_self_test)
    if as_json:
        click.echo(json.dumps(found, indent=1, allow_nan=False))
    else:
        show(*_describe(found), err=False)
    context.exit(int(bool(found["findings"])))


def _describe(found: dict[str, Any]) -> "Iterator[Line]":
    """Yield what was found, the verdict, and what to send with a bug report."""
    from mocap_calib_cli.screen import Line, format_table

    rows = [(key, str(value)) for key, value in (found["program"] | found["computer"]).items()]
    rows += [
        (name, _version(each))
        for part in ("packages", "extras")
        for name, each in found[part].items()
    ]
    for each in found["libraries"]:
        said = (
            f"{each['version'] or 'version not known'}, {each['threads']} threads, {each['file']}"
        )
        rows.append((each["library"], said))
    rows += found["environment"].items()
    rows += [(key, str(value or "none")) for key, value in found["devices"].items()]
    rows += [
        (f"model {name}", each["error"] or f"loads, {each['sha256'][:12]}")
        for name, each in found["models"].items()
    ]
    test = found["self_test"]
    if test is not None and test["error"] is None:
        said = f"{test['rotation_error_deg']:.2f} deg from the truth, {test['seconds']} s"
        rows.append(("self-test", said))
    yield from map(Line, format_table(("what", "found"), rows))
    yield from (Line(f"wrong: {finding}", "bold red") for finding in found["findings"])
    if not found["findings"]:
        yield Line("nothing is wrong", "bold green")
    yield Line(_REPORT)


def _version(package: dict[str, Any]) -> str:
    """Return the version of a package, and that it is broken."""
    broken = f" ({package['error']})" if package["error"] else ""
    return f"{package['version'] or 'not installed'}{broken}"
