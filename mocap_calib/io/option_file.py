"""Files of options (`recording.yaml`): a mapping from the names of options to their values.

    keypoints: keypoints
    cameras: intrinsics.toml
    frame-offset:
      - cam1:-3
      - cam2:5

A value is the text that stands there, as the command line would have it: YAML makes a number of
the camera and the frame `1:30`, and a truth value of a camera called `on`. So nodes are composed,
which know their lines, and no values are constructed.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path

import yaml

from mocap_calib.errors import FormatError, suggest
from mocap_calib.io.file import decode, read_bytes

_MOST_CHARACTERS = 100_000  # PyYAML reads them in a tenth of a second; options take a few thousand
_NOTHING = ("", "~", "null", "Null", "NULL")  # as YAML writes that there is no value


@dataclass(frozen=True)
class Entry:
    """What a file says of one option.

    texts: its values, as the file has them. lines: of each, counted from 1. is_list: whether they
    stand in a list, which may have one value.
    """

    source: str
    texts: tuple[str, ...]
    lines: tuple[int, ...]
    is_list: bool

    def place(self, text: str = "") -> str:
        """Return `FILE:LINE` of a value, or of the first one."""
        index = self.texts.index(text) if text in self.texts else 0
        return f"{self.source}:{self.lines[index]}"


def read_option_file(path: Path, known: Collection[str]) -> dict[str, Entry]:
    """Return what a file says, by the names of the options.

    known: names of options that there are.

    Raises FormatError, with the line, for what is not YAML, for other names, for a name that comes
    twice, and for values that are neither a text nor a list of texts.
    """
    source = str(path)
    entries: dict[str, Entry] = {}
    for key, value in _pairs(decode(read_bytes(path), source), source):
        place = f"{source}:{_line(key)}"
        if not isinstance(key, yaml.ScalarNode) or key.value not in known:
            found = key.value if isinstance(key, yaml.ScalarNode) else _kind(key)
            raise FormatError(place, "the name of an option", found, suggest(found, known))
        if key.value in entries:
            remedy = "leave one out, or write the values as a list"
            raise FormatError(place, "each option once", f"{key.value} twice", remedy)
        entries[key.value] = _entry(key.value, value, source)
    return entries


def format_option(name: str, texts: Iterable[str]) -> str:
    """Return the lines that give an option these values, which `read_option_file` reads again."""
    quoted = [_quote(text) for text in texts]
    if len(quoted) == 1:
        return f"{name}: {quoted[0]}\n"
    return "".join([f"{name}:\n", *(f"  - {text}\n" for text in quoted)])


def _pairs(text: str, source: str) -> list[tuple[yaml.Node, yaml.Node]]:
    """Return the keys and values of the mapping that a text is. Raises FormatError."""
    if len(text) > _MOST_CHARACTERS:
        expected = f"a file of options, below {_MOST_CHARACTERS // 1000} kB"
        raise FormatError(source, expected, f"{len(text) // 1000} kB", "give the options alone")
    try:
        node = yaml.compose(text, yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{source}:{mark.line + 1}" if mark else source
        raise FormatError(place, "YAML", error.problem or error, "mend that line") from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise FormatError(source, "YAML", f"an error ({error})", "mend the file") from None
    if node is None:
        return []
    if not isinstance(node, yaml.MappingNode):
        place = f"{source}:{_line(node)}"
        raise FormatError(place, "lines `option: value`", _kind(node), "mend the file")
    return node.value


def _entry(name: str, node: yaml.Node, source: str) -> Entry:
    """Return the value of an option. Raises FormatError."""
    is_list = isinstance(node, yaml.SequenceNode)
    nodes: list[yaml.Node] = node.value if is_list else [node]
    for each in nodes:
        if not isinstance(each, yaml.ScalarNode):
            raise FormatError(
                f"{source}:{_line(each)}",
                f"a value for {name}, or a list of values",
                _kind(each),
                "write cam1:5 without a blank after the colon, as on the command line",
            )
        if each.style is None and each.value in _NOTHING:
            raise _missing(name, f"{source}:{_line(each)}")
    if not nodes:
        raise _missing(name, f"{source}:{_line(node)}")
    lines = tuple(map(_line, nodes))
    return Entry(source, tuple(each.value for each in nodes), lines, is_list)


def _missing(name: str, place: str) -> FormatError:
    """Return the complaint about an option without a value."""
    return FormatError(place, f"a value for {name}", "none", "give one, or remove the line")


def _kind(node: yaml.Node) -> str:
    """Return what a node is, in words."""
    if isinstance(node, yaml.ScalarNode):
        return node.value or "nothing"
    return "a list" if isinstance(node, yaml.SequenceNode) else "a mapping"


def _line(node: yaml.Node) -> int:
    """Return the line of a node, counted from 1."""
    return node.start_mark.line + 1


def _quote(text: str) -> str:
    """Return a text as YAML has it: as it is where that can be read again, else in quotes."""
    try:
        node = yaml.compose(f"- {text}\n", yaml.SafeLoader)
    except yaml.YAMLError:
        node = None
    if isinstance(node, yaml.SequenceNode) and len(node.value) == 1:
        plain = node.value[0]
        is_plain = isinstance(plain, yaml.ScalarNode) and plain.style is None
        # in a mapping a text with a `: ` is no scalar, and a comment is lost
        if is_plain and plain.value == text and text not in _NOTHING:
            return text
    return yaml.dump(text, default_style='"', allow_unicode=True, width=10**6).strip()
