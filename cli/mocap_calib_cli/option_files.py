"""Files of options (`recording.yaml`): `--config` reads one, `--save-config` writes one.

    keypoints: keypoints
    cameras: intrinsics.toml
    frame-offset:
      - cam1:-3
      - cam2:5

The names in a file, which values are right, and which of them are paths follow from click's own
parameters of the command: an option that is added to it can stand in a file at once. A value is the
text that stands there, as the command line would have it: YAML makes a number of the camera and the
frame `1:30`, and a truth value of a camera called `on`. So nodes are composed, which know their
lines, and no values are constructed.
"""

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import click

from mocap_calib.errors import FormatError, MismatchError, suggest
from mocap_calib_cli import values
from mocap_calib_cli.options import STDIO

if TYPE_CHECKING:
    from yaml import Node

USUAL_NAME = "recording.yaml"
_MOST_CHARACTERS = 100_000  # PyYAML reads them in a tenth of a second; options take a few thousand
_NOTHING = ("", "~", "null", "Null", "NULL")  # as YAML writes that there is no value
_PLAIN = re.compile(r"[\w./]([\w./:+=,-]*[\w./+=,-])?")  # texts that need no quotes
_HEAD = """\
# Options of `mocap-calib {command}`: run it again with --config {name}
# Paths are relative to this file. docs/recording-yaml.md has the rest.

"""
_OTHERS = """
# --- all other options: they were not given, and have these defaults
"""


def _use_file(context: click.Context, _: click.Parameter, path: Path | None) -> None:
    """Let what a file says take the place of defaults. Raises FormatError."""
    if path is not None and not context.resilient_parsing:
        context.default_map = {**(context.default_map or {}), **read_file(path, context)[1]}


CONFIG = click.Option(
    ["--config"],
    type=values.FILE,
    metavar="FILE.yaml",
    is_eager=True,
    expose_value=False,
    callback=_use_file,
    help=f"Read options from a file, usually {USUAL_NAME} (docs/recording-yaml.md); those of "
    "the command line win.",
)
SAVE_CONFIG = click.Option(
    ["--save-config"],
    type=values.FILE,
    metavar="FILE",
    help="Write all options that were given to a file for --config, with the others as comments.",
)


# --- reading


def read_file(path: Path, context: click.Context) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what a file says of the parameters of a command: values and texts, by their names.

    Paths in it are relative to its folder.

    Raises FormatError, with the line, for what is not YAML, for names of no option, for a name that
    comes twice, and for values that the option does not take.
    """
    found, texts = {}, {}
    for key, param, nodes in _entries(path, params_by_key(context.command)):
        given = tuple(_resolve(param.type, node.value, path.parent) for node in nodes)
        name = str(param.name)
        texts[name] = given if is_list(param) else given[0]
        try:
            found[name] = param.process_value(context, texts[name])
        except (click.BadParameter, MismatchError) as error:
            wrong = next((each for each in nodes if _refuses(param, each, context)), nodes[0])
            raise _refusal(path, wrong, *_explain(param, wrong, error), key=key) from None
    return found, texts


def params_by_key(command: click.Command) -> dict[str, click.Parameter]:
    """Return the parameters of a command that may stand in a file, by their names there.

    These are the names of the command line: `image-size`, and `keypoints` of the argument.
    """
    params = sorted(command.params, key=lambda param: param.param_type_name != "argument")
    return {
        max(param.opts, key=len).removeprefix("--"): param
        for param in params
        if param not in (CONFIG, SAVE_CONFIG)
    }


def _entries(
    path: Path, params: Mapping[str, click.Parameter]
) -> "Iterator[tuple[str, click.Parameter, list[Node]]]":
    """Yield name, parameter and values of each option in a file. Raises FormatError."""
    import yaml

    seen: set[str] = set()
    for key, value in _pairs(path):
        if not isinstance(key, yaml.ScalarNode) or key.value not in params:
            name = _kind(key)
            remedy = suggest(name, params)
            raise _refusal(path, key, "the name of an option", name, remedy)
        name, param = key.value, params[key.value]
        if name in seen:
            remedy = "leave one out, or write the values as a list"
            raise _refusal(path, key, "each option once", f"{name} twice", remedy)
        seen.add(name)
        listed = isinstance(value, yaml.SequenceNode)
        nodes = value.value if listed else [value]
        if not nodes:
            raise _no_value(path, name, value)
        for node in nodes:
            if not isinstance(node, yaml.ScalarNode):
                expected = f"a value for {name}, or a list of values"
                remedy = "write cam1:5 without a blank after the colon, as on the command line"
                raise _refusal(path, node, expected, _kind(node), remedy)
            if node.style is None and node.value in _NOTHING:
                raise _no_value(path, name, node)
        if listed and not is_list(param):
            raise _refusal(path, nodes[0], "one value", f"a list of {len(nodes)}", key=name)
        yield name, param, nodes


def _pairs(path: Path) -> "list[tuple[Node, Node]]":
    """Return the keys and values of the mapping in a file. Raises FormatError."""
    import yaml

    from mocap_calib.io.file import decode, read_bytes

    text = decode(read_bytes(path), str(path))
    if len(text) > _MOST_CHARACTERS:
        expected = f"a file of options, below {_MOST_CHARACTERS // 1000} kB"
        raise FormatError(path, expected, f"{len(text) // 1000} kB", "give the options alone")
    try:
        node = yaml.compose(text, yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{path}:{mark.line + 1}" if mark else path
        raise FormatError(place, "YAML", error.problem or error, "correct that line") from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise FormatError(path, "YAML", f"an error ({error})", "correct the file") from None
    if node is None:
        return []
    if not isinstance(node, yaml.MappingNode):
        raise _refusal(path, node, "lines `option: value`", _kind(node), "correct the file")
    return node.value


def is_list(param: click.Parameter) -> bool:
    """Return whether a parameter may have several values."""
    return param.multiple or param.nargs != 1


def _refuses(param: click.Parameter, node: "Node", context: click.Context) -> bool:
    """Return whether a parameter does not take a value."""
    try:
        param.type.convert(node.value, param, context)
    except (click.BadParameter, MismatchError):
        return True
    return False


def _refusal(
    path: Path,
    node: "Node",
    expected: str,
    found: str,
    remedy: str = "correct that line",
    *,
    key: str = "",
) -> FormatError:
    """Return the complaint about a place in a file, with its line. key: the name of the option."""
    place = f"{path}:{node.start_mark.line + 1}"
    return FormatError(f"{place}: {key}" if key else place, expected, found, remedy)


def _no_value(path: Path, name: str, node: "Node") -> FormatError:
    """Return the complaint about an option without a value."""
    return _refusal(path, node, f"a value for {name}", "none", "give one, or remove the line")


def _explain(param: click.Parameter, node: "Node", error: Exception) -> tuple[str, str, str]:
    """Return what was expected, what came and what to do, of a value that a parameter refuses."""
    remedy = "correct that line"
    if isinstance(error, MismatchError):
        return error.expected, error.found, error.remedy
    if isinstance(param.type, click.Choice):
        return f"one of {', '.join(map(str, param.type.choices))}", node.value, remedy
    if isinstance(param.type, type(click.BOOL)):
        return "true or false", node.value, remedy
    expected, _, found = str(error).removeprefix("expected ").partition(", found ")
    return expected, found or node.value, remedy


def _kind(node: "Node") -> str:
    """Return what a node is, in words."""
    import yaml

    if isinstance(node, yaml.ScalarNode):
        return node.value or "nothing"
    return "a list" if isinstance(node, yaml.SequenceNode) else "a mapping"


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
    from mocap_calib.io.atomic import write_bytes

    given, others = [], []
    for key, param in params_by_key(context.command).items():
        texts = context.meta["texts"].get(param.name)
        if texts:
            given.append(_format(key, [_relate(param.type, text, path.parent) for text in texts]))
        else:
            others.append(_describe(param, key, context))
    head = _HEAD.format(command=context.info_name, name=path.name)
    content = "".join([head, *given, _OTHERS, *others]).encode()
    if path.is_file() and path.read_bytes() != content:
        raise MismatchError(
            path, "a new file", "one that says something else", "remove it or choose another name"
        )
    write_bytes(path, content)


def _format(key: str, texts: Iterable[str]) -> str:
    """Return the lines that give an option these values."""
    quoted = list(map(_quote, texts))
    if len(quoted) == 1:
        return f"{key}: {quoted[0]}\n"
    return "".join([f"{key}:\n", *(f"  - {text}\n" for text in quoted)])


def _quote(text: str) -> str:
    """Return a text as YAML has it: as it is where that can be read again, else in quotes."""
    import yaml

    if _PLAIN.fullmatch(text) and text not in _NOTHING:
        return text
    return yaml.dump(text, default_style='"', allow_unicode=True, width=10**6).strip()


def _describe(param: click.Parameter, key: str, context: click.Context) -> str:
    """Return what an option is and its default, as comments."""
    about = fill(str(getattr(param, "help", "")), 92, break_long_words=False)
    default = param.get_default(context)
    known = isinstance(default, str | int) and default != ""
    value = str(default) if known else f"({param.make_metavar(context)})"
    value = value.lower() if isinstance(default, bool) else value
    return "".join(f"# {line}\n" for line in about.splitlines()) + f"# {key}: {value}\n\n"
