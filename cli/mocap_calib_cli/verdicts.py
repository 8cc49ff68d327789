"""What a verdict means for whoever called a command: its exit status, and what is said of it.

All files are written whatever the verdict is. The exit status follows from the verdict on the
largest group of cameras: its files lie in the folder that was asked for, and scripts go on with
them.
"""

from collections.abc import Sequence

import click

from mocap_calib.io.provenance import advice_on
from mocap_calib_cli.options import SharedOptions
from mocap_calib_cli.progress import Reporter
from mocap_calib_cli.screen import Line

_USELESS = "not determined"
_DOUBTFUL = ("weak", _USELESS)  # what nobody may overlook
STYLES = {
    "well determined": "bold green",
    "usable": "green",
    "weak": "bold yellow",
    _USELESS: "bold red",
}
_NEXT = "bold"


def check_demands(options: SharedOptions) -> None:
    """Raise click's UsageError where the options ask for one thing and its opposite."""
    if options.strict and options.accept:
        raise click.UsageError(
            f"--strict: expected it without --accept, found --accept {options.accept}; "
            "give one of them"
        )


def exit_status(verdict: str, options: SharedOptions) -> int:
    """Return 0 where results of a verdict will do, and 1 where they will not.

    verdict: one of `results.VERDICTS`.
    """
    if options.strict:
        return int(verdict in _DOUBTFUL)
    return int(verdict == _USELESS and not options.accept)


def conclude(
    reporter: Reporter,
    verdict: str,
    place: object,
    options: SharedOptions,
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
        if counts and exit_status(verdict, options):
            remedy = "leave out --strict" if options.strict else "say --accept not-determined"
            line += f"; all files are written, and the exit status is 1: {remedy} if they will do"
        if options.quiet:
            reporter.warn(line, *(f"  {reason}" for reason in reasons))
    reporter.show(Line(line, STYLES[verdict]), *explain(reasons, next_step))


def explain(reasons: Sequence[str], next_step: str = "") -> list[Line]:
    """Return the reasons for a verdict, a line each, the most urgent first; else the next step."""
    if not reasons:
        return [Line(f"next: {next_step}", _NEXT)] if next_step else []
    return [Line(f"  {reason}", "" if place else _NEXT) for place, reason in enumerate(reasons)]
