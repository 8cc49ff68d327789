"""Options from a file, and options to a file: `--config` and `--save-config`.

The names in a file, which values are right, and which of them are paths follow from click's own
parameters of the command: an option that is added to it can stand in a file at once.
"""

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.core import ParameterSource

from mocap_calib.errors import one_line
from mocap_calib_cli import values
from mocap_calib_cli.options import STDIO

if TYPE_CHECKING:
    from mocap_calib.io.option_file import Entry

Command = TypeVar("Command", bound=Callable[..., Any])

USUAL_NAME = "recording.yaml"
_OF_FILES = ("config", "save_config", "help")  # these cannot stand in a file
_META = "entries of --config"
_GIVEN = (ParameterSource.COMMANDLINE, ParameterSource.ENVIRONMENT, ParameterSource.DEFAULT_MAP)
_HEAD = """\
# Options of `mocap-calib {command}`: run it again with --config {name}
# Paths are relative to this file. docs/recording-yaml.md has the rest.

"""
_OTHERS = """
# --- all other options: they were not given, and have these defaults
"""


class ConfigurableCommand(click.Command):
    """A command whose options may stand in a file: what is wrong with them names its line."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command. Raises FormatError for a value of the file that it refuses."""
        with naming_lines(ctx.meta.get(_META, {}), ctx):
            return super().invoke(ctx)


def option_files(command: Command) -> Command:
    """Add `--config` and `--save-config`, whose file the command gets as `save_config`."""
    save = click.option(
        "--save-config",
        type=click.Path(path_type=Path),
        metavar="FILE",
        help="Write all options that were given to a file for --config, with the others as "
        "comments.",
    )
    config = click.option(
        "--config",
        type=click.Path(path_type=Path),
        metavar="FILE.yaml",
        is_eager=True,
        expose_value=False,
        callback=_use_file,
        help=f"Read options from a file, usually {USUAL_NAME} (docs/recording-yaml.md); those of "
        "the command line win.",
    )
    return config(save(command))


def _use_file(context: click.Context, _: click.Parameter, path: Path | None) -> None:
    """Let what a file says take the place of defaults. Raises FormatError."""
    if path is None or context.resilient_parsing:
        return
    found = read_values(path, context)
    context.default_map = {**(context.default_map or {}), **found.values}
    context.meta[_META] = found.entries


# --- reading


class FileValues:
    """What a file says: values, by the names of parameters, and entries, by those of options."""

    def __init__(self, values: dict[str, Any], entries: "dict[str, Entry]") -> None:
        self.values = values
        self.entries = entries


def read_values(path: Path, context: click.Context) -> FileValues:
    """Return what a file says of the options of the command of a context. Raises FormatError.

    Paths in it are relative to its folder.
    """
    from mocap_calib.io.option_file import read_option_file

    params = params_by_key(context.command)
    entries = read_option_file(path, params)
    found = {
        str(params[key].name): _read_value(params[key], key, entry, context, path.parent)
        for key, entry in entries.items()
    }
    return FileValues(found, entries)


def params_by_key(command: click.Command) -> dict[str, click.Parameter]:
    """Return the parameters of a command that may stand in a file, by their names there.

    These are the names of the command line: `image-size`, and `keypoints` of the argument.
    """
    params = sorted(command.params, key=lambda param: param.param_type_name != "argument")
    return {
        max(param.opts, key=len).removeprefix("--"): param
        for param in params
        if param.name not in _OF_FILES
    }


@contextmanager
def naming_lines(entries: "Mapping[str, Entry]", context: click.Context) -> Iterator[None]:
    """Raise FormatError, with the line, where the block refuses a value that the file gave.

    context: knows which values were typed instead.
    """
    try:
        yield
    except click.BadParameter as error:
        hint = error.param_hint if isinstance(error.param_hint, str) else ""
        key = hint.removeprefix("--")
        entry = entries.get(key)
        if entry is None or is_typed(str(params_by_key(context.command)[key].name), context):
            raise
        raise _refusal(key, entry, error.message) from None


def is_typed(name: str, context: click.Context) -> bool:
    """Return whether the command line gives a parameter, which wins over files."""
    return context.get_parameter_source(name) is ParameterSource.COMMANDLINE


def _read_value(
    param: click.Parameter, key: str, entry: "Entry", context: click.Context, folder: Path
) -> Any:
    """Return the value of a parameter. Raises FormatError."""
    several = param.multiple or param.nargs != 1
    if entry.is_list and not several:
        raise _refusal(key, entry, f"expected one value, found a list of {len(entry.texts)}")
    texts = [_resolve(param.type, text, folder) for text in entry.texts]
    for text, given in zip(texts, entry.texts, strict=True):
        try:
            param.type.convert(text, param, context)
        except click.BadParameter as error:
            raise _refusal(key, entry, _explain(param.type, given, error), given) from None
    return param.type_cast_value(context, texts if several else texts[0])


def _refusal(key: str, entry: "Entry", message: str, text: str = "") -> Exception:
    """Return the complaint about a value, with its line. text: of the value, where it is known."""
    from mocap_calib.errors import FormatError

    found = text or next((each for each in entry.texts if message.endswith(each)), "")
    said = re.fullmatch(r"(?:expected )?(.*?)(?:, found (.*?))?(?:; (.*))?", message, re.DOTALL)
    expected, came, remedy = said.groups() if said else (message, None, None)
    return FormatError(
        f"{entry.place(found)}: {key}", expected, came or found, remedy or "correct that line"
    )


def _explain(kind: click.ParamType[Any], text: str, error: click.BadParameter) -> str:
    """Return what was expected and what came, where click's own types say it in other words."""
    if isinstance(kind, click.Choice):
        return f"expected one of {', '.join(map(str, kind.choices))}, found {text}"
    if isinstance(kind, type(click.BOOL)):
        return f"expected true or false, found {text}"
    return one_line(error.message, width=300)


# --- paths


def _resolve(kind: click.ParamType[Any], text: str, folder: Path) -> str:
    """Return a value that stands in a file in `folder`, as the command line would say it here."""
    return _change_path(kind, text, lambda path: str(folder / path), beginning=folder)


def _relate(kind: click.ParamType[Any], text: str, folder: Path) -> str:
    """Return a value of the command line, as a file in `folder` says it."""

    def relate(path: str) -> str:
        try:
            return Path(os.path.relpath(path, folder)).as_posix()
        except ValueError:  # on another drive of Windows
            return str(Path(path).absolute())

    return _change_path(kind, text, relate, beginning=Path())


def _change_path(
    kind: click.ParamType[Any], text: str, change: Callable[[str], str], *, beginning: Path
) -> str:
    """Return a value with its path changed, where it is one; also of a `name=path` of keypoints.

    beginning: the folder where a path begins that is not absolute.
    """
    if isinstance(kind, values.NameOrFile):
        return change(text) if kind.is_file(beginning / text) else text
    if text == STDIO or not isinstance(kind, click.Path):
        return text
    name, equals, path = text.partition("=")
    if kind is values.KEYPOINTS and equals and not (beginning / text).exists():
        return f"{name}={change(path)}"
    return change(text)


# --- writing


def save_options(context: click.Context, path: Path) -> None:
    """Write the options that were given to a file, in one step; the others are comments in it.

    Raises MismatchError where there is a file already that says something else.
    """
    from mocap_calib.errors import MismatchError
    from mocap_calib.io.atomic import write_bytes

    text = format_options(context, path)
    if path.is_file() and path.read_bytes() != text.encode():
        raise MismatchError(
            path, "a new file", "one that says something else", "remove it or choose another name"
        )
    write_bytes(path, text.encode())


def format_options(context: click.Context, path: Path) -> str:
    """Return the text of a file of the options that were given; the others are comments."""
    from mocap_calib.io.option_file import format_option

    given, others = [], []
    for key, param in params_by_key(context.command).items():
        texts = _list_texts(context.params[str(param.name)])
        if texts and context.get_parameter_source(str(param.name)) in _GIVEN:
            related = [_relate(param.type, text, path.parent) for text in texts]
            given.append(format_option(key, related))
        else:
            others.append(_describe(param, key, texts, context))
    head = _HEAD.format(command=context.info_name, name=path.name)
    return "".join([head, *given, _OTHERS, *others])


def _list_texts(value: Any) -> list[str]:
    """Return the values of a parameter as the command line has them."""
    if isinstance(value, bool):
        return [str(value).lower()]
    if isinstance(value, tuple):
        return [str(each) for each in value]
    return [] if value is None or value == "" else [str(value)]


def _describe(
    param: click.Parameter, key: str, default: Iterable[str], context: click.Context
) -> str:
    """Return what an option is and its default, as comments."""
    about = fill(str(getattr(param, "help", "")), 92, break_long_words=False)
    value = " ".join(default) or f"({param.make_metavar(context)})"
    return "".join(f"# {line}\n" for line in about.splitlines()) + f"# {key}: {value}\n\n"
