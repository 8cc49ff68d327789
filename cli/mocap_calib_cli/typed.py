"""Commands of click: a function that gets what was typed, as one record of values.

`@as_command("match", options.OUTPUT_TEXT, "rig", "quiet")` makes a command of a function, with
these parameters in this order: names of shared options, or parameters that are its own. The
docstring of the function is the help, also of single options: its lines `name: help`.
"""

import errno
import inspect
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from copy import copy
from typing import Any

import click
from click.core import ParameterSource

from mocap_calib.errors import (
    NO_ROOM,
    MismatchError,
    MocapCalibError,
    quote_for_shell,
    spell_as_option,
)
from mocap_calib_cli.docstrings import split_help
from mocap_calib_cli.options import HELP, SHARED
from mocap_calib_cli.values import Output

# the texts of parameters, by the names of these: one, or those of a parameter with several values
Texts = dict[str, str | tuple[str, ...]]


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

    def replace(self, texts: Texts) -> "Typed":
        """Return this with the values of other texts. Raises click's BadParameter."""
        context = click.get_current_context()
        found = {name: SHARED[name].process_value(context, text) for name, text in texts.items()}
        lists = {name: _list_texts(text) for name, text in texts.items()}
        return Typed(vars(self) | found, self.texts | lists)


Run = Callable[[Typed], int | None]


# errors of the system that a user can correct
_OF_FILES = (
    *(errno.ENOENT, errno.EACCES, errno.EPERM, errno.EROFS, errno.EISDIR, errno.ENOTDIR),
    errno.EEXIST,
)


@contextmanager
def refused_as_usage() -> Iterator[None]:
    """Make a refusal of the library one of the command line."""
    try:
        yield
    except MismatchError as error:
        raise click.UsageError(error.render(spell_as_option)) from None


class Command(click.Command):
    """A command whose function gets what was typed, and returns an exit status, or nothing.

    helps: of its parameters, by their names.
    """

    helps: Mapping[str, str]

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Keep the texts of what is given beside their values."""
        typed, _, _ = self.make_parser(ctx).parse_args(list(args))
        rest = super().parse_args(ctx, args)
        said = {
            ParameterSource.COMMANDLINE: typed,
            ParameterSource.DEFAULT_MAP: ctx.default_map or {},
        }
        ctx.meta["texts"] = {
            name: _list_texts(said[source][name])
            for name in ctx.params
            if (source := ctx.get_parameter_source(name)) in said
        }
        return rest


def _list_texts(value: Any) -> list[str]:
    """Return the values of a parameter as the command line has them."""
    if isinstance(value, bool):
        return [str(value).lower()]
    return [str(each) for each in value] if isinstance(value, list | tuple) else [str(value)]


def as_command(name: str, *params: str | click.Parameter) -> Callable[[Run], Command]:
    """Make a command of a function.

    params: names of shared options, and parameters of its own.
    """

    def make(function: Run) -> Command:
        def call(**found: Any) -> None:
            context = click.get_current_context()
            typed = Typed(found, context.meta["texts"])
            for param in own:
                if isinstance(param.type, Output):
                    param.type.check(getattr(typed, str(param.name)))
            context.exit(function(typed) or 0)

        about, own_helps = split_help(inspect.getdoc(function))
        helps = HELP | own_helps
        own = [copy(SHARED[each] if isinstance(each, str) else each) for each in params]
        for param in own:
            if isinstance(param, click.Option):
                param.help = helps.get(str(param.name))
        command = Command(name, params=own, callback=call, help=about)
        command.helps = helps
        return command

    return make


# --- errors that a user can correct


def explain(error: Exception, command: click.Command | None = None) -> str | None:
    """Return the line for a user's mistake; None for one of the program, which gets a traceback.

    command: whose parameters the arguments in the line are, by their names.
    """
    options = {} if command is None else {each.name: each.opts[-1] for each in command.params}

    def spell(name: str, value: str) -> str:
        if name not in options:
            return spell_as_option(name, value)
        return f"{options[name]} {quote_for_shell(value)}".rstrip()

    if isinstance(error, MocapCalibError):
        return error.render(spell)
    if not isinstance(error, OSError):
        return None
    found = str(error.strerror).lower()
    if error.errno in NO_ROOM:
        return (
            f"{error.filename or 'stdout'}: expected room to write, found {found}; free space on "
            "its disk, raise the limit (quota, ulimit -f), or choose another place"
        )
    if error.errno in _OF_FILES:
        return (
            f"{error.filename or 'a file'}: expected a path this program can use, found {found}; "
            "check the path, its permissions and the disk, or choose another"
        )
    return None
