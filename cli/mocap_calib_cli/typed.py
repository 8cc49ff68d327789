"""Commands of click: a function that gets what was typed, as one record of values.

`@as_command("match", output_text("matches"), "rig", "quiet")` makes a command of a function, with
these parameters in this order: names of shared options, or parameters of click that are its own.
"""

from collections.abc import Callable, Mapping
from typing import Any

import click
from click.core import ParameterSource

from mocap_calib_cli import numbers, values
from mocap_calib_cli.options import SHARED, STDIO


class Typed:
    """What was typed, under the names of Python; None or () of what a command does not have.

    texts: name -> the texts of what the command line, or a file of options, gives.
    """

    def __init__(
        self, found: Mapping[str, Any], texts: Mapping[str, list[str]] | None = None
    ) -> None:
        vars(self).update(found)
        self.texts = dict(texts or {})

    def __getattr__(self, name: str) -> Any:
        """Return what stands for an option that the command does not have."""
        if name not in SHARED:
            raise AttributeError(name)
        return () if getattr(SHARED[name], "multiple", False) else None

    def replace(self, found: dict[str, Any], texts: Mapping[str, Any]) -> "Typed":
        """Return this with other values, and the texts of these."""
        more = {name: _list_texts(each) for name, each in texts.items()}
        return Typed(vars(self) | found, self.texts | more)


Run = Callable[[Typed], int | None]


class Command(click.Command):
    """A command whose function gets what was typed, and returns an exit status, or nothing."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Keep the texts of what is given beside their values."""
        typed, _, _ = self.make_parser(ctx).parse_args(list(args))
        rest = super().parse_args(ctx, args)
        said = {
            ParameterSource.COMMANDLINE: typed,
            ParameterSource.DEFAULT_MAP: ctx.default_map or {},
        }
        sources = {name: ctx.get_parameter_source(name) for name in ctx.params}
        ctx.meta["texts"] = {
            name: _list_texts(said[source][name])
            for name, source in sources.items()
            if source in said
        }
        return rest


def _list_texts(value: Any) -> list[str]:
    """Return the values of a parameter as the command line has them."""
    if isinstance(value, bool):
        return [str(value).lower()]
    return [str(each) for each in value] if isinstance(value, list | tuple) else [str(value)]


def as_command(name: str, *params: str | click.Parameter) -> Callable[[Run], Command]:
    """Make a command of a function; its docstring is the help.

    params: names of shared options, and parameters of its own.
    """

    def make(function: Run) -> Command:
        def call(**found: Any) -> None:
            context = click.get_current_context()
            context.exit(function(Typed(found, context.meta["texts"])) or 0)

        return Command(
            name,
            params=[SHARED[each] if isinstance(each, str) else each for each in params],
            callback=call,
            help=function.__doc__,
        )

    return make


# --- parameters that many commands have, each with a help of its own


def output_text(what: str) -> click.Option:
    """Return `-o FILE` of a command whose result is text: stdout unless a file is given."""
    return click.Option(
        ["-o", "--output"],
        default=STDIO,
        type=values.ANY_PATH,
        metavar="FILE",
        help=f"Where to write the {what}; - is stdout.",
    )


def output_file(what: str) -> click.Option:
    """Return `-o FILE` of a command whose result is a file."""
    return _output("FILE", what)


def output_folder(what: str) -> click.Option:
    """Return `-o OUT` of a command whose result is a folder."""
    return _output("OUT", what)


def _output(metavar: str, what: str) -> click.Option:
    """Return a required `-o` with a path."""
    return click.Option(
        ["-o", "--output"], type=values.FILE, required=True, metavar=metavar, help=what
    )


def as_json(what: str) -> click.Option:
    """Return `--json`."""
    return click.Option(["--json", "as_json"], is_flag=True, help=what)


def output_poses() -> click.Option:
    """Return `-o FILE` of a command whose result is the poses of a recording."""
    return output_file(
        "Poses: a .h5 file, or a .csv file (several individuals go to NAME_0.csv, NAME_1.csv, ...)."
    )


def rate_of_poses(help: str) -> click.Option:
    """Return `--fps` of a command that reads poses."""
    return click.Option(["--fps"], type=numbers.POSITIVE, help=help)
