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
from collections.abc import Callable, Sequence
from pathlib import Path
from textwrap import fill
from typing import Any

import click

from mocap_calib.errors import FormatError, MismatchError, suggest
from mocap_calib_cli import values
from mocap_calib_cli.options import option
from mocap_calib_cli.outputs import STDIO
from mocap_calib_cli.typed import Texts

USUAL_NAME = "recording.yaml"
_MOST_CHARACTERS = 100_000  # PyYAML reads them in a tenth of a second; options take a few thousand
# texts that need no quotes: all but those by which YAML writes that there is no value
_PLAIN = re.compile(r"(?!null$|Null$|NULL$)[\w./]([\w./:+=,-]*[\w./+=,-])?")
_AS_TYPED = "write it as on the command line (cam1:5, without a blank), or remove the line"
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
        context.default_map = {**(context.default_map or {}), **read_file(path, context)}


CONFIG = option(
    "--config",
    values.FILE,
    metavar="FILE.yaml",
    is_eager=True,
    expose_value=False,
    callback=_use_file,
)
SAVE_CONFIG = option("--save-config", values.FILE, metavar="FILE")


# --- reading


def read_file(path: Path, context: click.Context) -> Texts:
    """Return the texts that a file has for parameters of a command, by the names of these.

    Paths in it are relative to its folder.

    Raises FormatError, with the line, for what is not YAML, for names of no option, for a name that
    comes twice, and for values that the option does not take.
    """
    params = params_by_key(context.command)
    found: Texts = {}
    for key, value in _pairs(path):
        param = params.get(str(key.value))
        if param is None:
            remedy = suggest(_kind(key), params)
            raise _refusal(path, key, "the name of an option", _kind(key), remedy)
        name = str(param.name)
        if name in found:
            remedy = "leave one out, or write the values as a list"
            raise _refusal(path, key, "each option once", f"{key.value} twice", remedy)
        listed = is_list(param) and value.id == "sequence" and value.value
        nodes = value.value if listed else [value]
        texts = tuple(_read_value(path, key.value, param, node, context) for node in nodes)
        found[name] = texts if is_list(param) else texts[0]
        try:
            param.process_value(context, found[name])
        except (click.BadParameter, MismatchError) as error:
            raise _refusal(path, value, *_explain(error), key=key.value) from None
    return found


def _read_value(
    path: Path, key: str, param: click.Parameter, node: Any, context: click.Context
) -> str:
    """Return the text of a value, its path relative to the working folder. Raises FormatError."""
    if node.id != "scalar" or node.tag.endswith(":null"):
        raise _refusal(path, node, f"a value for {key}", _kind(node), _AS_TYPED)
    try:
        param.type.convert(node.value, param, context)
    except (click.BadParameter, MismatchError) as error:
        raise _refusal(path, node, *_explain(error), key=key) from None
    return _change_path(param.type, node.value, lambda text: str(path.parent / text), path.parent)


def params_by_key(command: click.Command) -> dict[str, click.Parameter]:
    """Return the parameters of a command that may stand in a file, by their names there.

    These are the names of the command line: `image-size`, and `keypoints` of the argument.
    """
    params = sorted(command.params, key=lambda param: param.param_type_name != "argument")
    return {
        max(param.opts, key=len).removeprefix("--"): param
        for param in params
        if param.name not in ("config", "save_config")
    }


def _pairs(path: Path) -> list[tuple[Any, Any]]:
    """Return the keys and values of the mapping in a file. Raises FormatError."""
    import yaml

    from mocap_calib.io.file import decode, read_bytes

    text = decode(read_bytes(path), str(path))
    if len(text) > _MOST_CHARACTERS:
        expected = f"a file of options, below {_MOST_CHARACTERS // 1000} kB"
        raise FormatError(path, expected, f"{len(text) // 1000} kB", "give the options alone")
    try:
        node = yaml.compose(text, yaml.SafeLoader)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
        found = getattr(error, "problem", None) or f"an error ({error})"
        place = f"{path}:{mark.line + 1}" if mark else path
        raise FormatError(place, "YAML", found, "correct the file") from None
    if node is None:
        return []
    if not isinstance(node, yaml.MappingNode):
        raise _refusal(path, node, "lines `option: value`", _kind(node), "correct the file")
    pairs: list[tuple[Any, Any]] = node.value
    return pairs


def is_list(param: click.Parameter) -> bool:
    """Return whether a parameter may have several values."""
    return param.multiple or param.nargs != 1


def _refusal(
    path: Path, node: Any, expected: str, found: str, remedy: str, *, key: str = ""
) -> FormatError:
    """Return the complaint about a place in a file, with its line. key: the name of the option."""
    place = f"{path}:{node.start_mark.line + 1}"
    return FormatError(f"{place}: {key}" if key else place, expected, found, remedy)


def _explain(error: click.BadParameter | MismatchError) -> tuple[str, str, str]:
    """Return what was expected, what came and what to do, of a value that is refused."""
    if isinstance(error, MismatchError):
        return error.expected, error.found, error.remedy
    expected, _, found = error.message.removeprefix("expected ").partition(", found ")
    return expected, found, "correct that line"


def _kind(node: Any) -> str:
    """Return what a node is, in words."""
    if node.id == "scalar":
        return "none" if node.tag.endswith(":null") else node.value
    return f"a list of {len(node.value)}" if node.id == "sequence" else "a mapping"


# --- paths


def _change_path(
    kind: click.ParamType[Any], text: str, change: Callable[[str], str], beginning: Path
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

    def relate(text: str) -> str:
        try:
            return Path(os.path.relpath(text, path.parent)).as_posix()
        except ValueError:  # on another drive of Windows
            return str(Path(text).absolute())

    given, others = [], []
    for key, param in params_by_key(context.command).items():
        texts = context.meta["texts"].get(param.name)
        if texts:
            given.append(
                _format(key, [_change_path(param.type, text, relate, Path()) for text in texts])
            )
        else:
            others.append(_describe(param, key, context))
    head = _HEAD.format(command=context.info_name, name=path.name)
    content = "".join([head, *given, _OTHERS, *others]).encode()
    if path.is_file() and path.read_bytes() != content:
        raise MismatchError(
            path, "a new file", "one that says something else", "remove it or choose another name"
        )
    write_bytes(path, content)


def _format(key: str, texts: Sequence[str]) -> str:
    """Return the lines that give an option these values."""
    if len(texts) == 1:
        return f"{key}: {_quote(texts[0])}\n"
    return "".join([f"{key}:\n", *(f"  - {_quote(text)}\n" for text in texts)])


def _quote(text: str) -> str:
    """Return a text as YAML has it: as it is where that can be read again, else in quotes."""
    import yaml

    if _PLAIN.fullmatch(text):
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
