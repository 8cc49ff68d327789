"""What a verdict means for whoever called a command: its exit status, and a warning.

All files are written whatever the verdict is. The exit status follows from the verdict on the
largest group of cameras: its files lie in the folder that was asked for, and scripts go on with
them.
"""

from collections.abc import Sequence

import click

from mocap_calib.io.provenance import advice_on
from mocap_calib_cli.options import SharedOptions
from mocap_calib_cli.progress import Reporter

_USELESS = "not determined"
_DOUBTFUL = ("weak", _USELESS)  # what nobody may overlook


def check_demands(options: SharedOptions) -> None:
    """Raise click's UsageError where the options ask for one thing and its opposite."""
    if options.strict and options.accept:
        raise click.UsageError(
            f"--strict: expected it without --accept, found --accept {options.accept}; "
            "give one of them"
        )


def exit_status(verdict: str, options: SharedOptions) -> int:
    """Return 0 where results of a verdict will do, and 1 where they will not.

    verdict: one of `types.VERDICTS`.
    """
    if options.strict:
        return int(verdict in _DOUBTFUL)
    return int(verdict == _USELESS and not options.accept)


def warn_of_verdict(
    reporter: Reporter,
    verdict: str,
    place: object,
    options: SharedOptions,
    *,
    reasons: Sequence[str] = (),
    counts: bool = True,
) -> None:
    """Write a warning where a verdict is doubtful, also where --quiet was said.

    place: where the files are. reasons: for the verdict; they are written where --quiet keeps them
        from being said elsewhere. counts: the exit status follows from this verdict.
    """
    if verdict not in _DOUBTFUL:
        return
    line = f"mocap-calib: {place}: rig {verdict}{advice_on(verdict)}"
    if counts and exit_status(verdict, options):
        remedy = "leave out --strict" if options.strict else "say --accept not-determined"
        line += f"; all files are written, and the exit status is 1: {remedy} if they will do"
    reporter.warn(line)
    if options.quiet:
        reporter.warn(*(f"  {reason}" for reason in reasons))
