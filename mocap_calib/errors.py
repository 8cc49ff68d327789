"""What can go wrong through no fault of the program, and words that messages share.

MocapCalibError
├── FormatError       a file is not what its format says
├── MismatchError     two inputs do not belong together
├── DegenerateError   the observations do not determine the answer
│   └── UnderconstrainedCameraError   not of this camera, but perhaps of the others
└── ClusterError      the machines that work was sent to cannot do it

Every message is one line: what was expected, what came, what to do. Anything else that is raised
is a mistake of the program and keeps its traceback.
"""

import errno
import re
from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches

# marks of an argument in a text: its name, its value, its end (characters that no text has)
_NAME, _VALUE, _END = "\ue000", "\ue001", "\ue002"
_ARGUMENT = re.compile(f"{_NAME}([^{_VALUE}]*){_VALUE}([^{_END}]*){_END}")
_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\ud800-\udfff]")
_LONGEST = 300  # characters of what and found, which hold what files say
# arguments of the command that have another name in Python
_NAMES_IN_PYTHON = {"from": "format", "to": "format", "write": "format"}

# of the system, where nothing more can be written at a place
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)

Spell = Callable[[str, str], str]


class MocapCalibError(Exception):
    """A refusal: what a user can cause and correct.

    what: the file, camera or argument that is refused; "" where the rest says it.
    expected, found: what was expected, and what came instead.
    remedy: what to do.

    Arguments of functions stand in these texts as `argument` marks them.
    """

    def __init__(self, what: object, expected: str, found: object, remedy: str) -> None:
        super().__init__(what, expected, found, remedy)
        self.what, self.expected, self.found = str(what), expected, str(found)
        self.remedy = remedy

    def __str__(self) -> str:
        return self.render(spell_in_python)

    def render(self, spell: Spell) -> str:
        """Return the message in one line, its arguments as `spell` writes them."""
        texts = (self.what, self.expected, self.found, self.remedy)
        what, expected, found, remedy = (spell_arguments(text, spell) for text in texts)
        where = f"{one_line(what, _LONGEST)}: " if what else ""
        line = f"{where}expected {expected}, found {one_line(found, _LONGEST)}; {remedy}"
        return visible(" ".join(line.split()))


class FormatError(MocapCalibError):
    """A file is not what its format says."""


class MismatchError(MocapCalibError):
    """Two inputs do not belong together."""


class DegenerateError(MocapCalibError):
    """The observations do not determine the answer."""


class UnderconstrainedCameraError(DegenerateError):
    """A camera sees too little that agrees with others; without it they may be calibrated.

    what: `camera NAME`.
    """

    @property
    def camera(self) -> str:
        """The name of the camera."""
        return self.what.removeprefix("camera ")


class ClusterError(MocapCalibError):
    """The machines that work was sent to cannot do it."""


def argument(name: str, value: str = "") -> str:
    """Return the mark of an argument in a text, for `spell_arguments`.

    name: of the argument in Python. value: which it should have, as a user types it.
    """
    return f"{_NAME}{name}{_VALUE}{value}{_END}"


def spell_arguments(text: str, spell: Spell) -> str:
    """Return a text with its marks of arguments written by `spell(name, value)`."""
    return _ARGUMENT.sub(lambda found: spell(found[1], found[2]), text)


def spell_as_option(name: str, value: str) -> str:
    """Return an argument as an option of the command: `--camera-regex`, `--unit m`."""
    return f"--{name.replace('_', '-')} {quote_for_shell(value)}".rstrip()


def quote_for_shell(value: str) -> str:
    """Return a value as it is typed: in quotes where a shell would change it."""
    return f'"{value}"' if re.search(r"[^\w.,:=+/-]", value) else value


def spell_in_python(name: str, value: str) -> str:
    """Return an argument as a call in Python has it: `fps=`, `unit='m'`."""
    camera, _, size = value.rpartition(":")
    if size == "WIDTHxHEIGHT":
        value = f"{{{camera!r}: (WIDTH, HEIGHT)}}" if camera else "(WIDTH, HEIGHT)"
    elif value:
        value = repr(value)
    return f"{_NAMES_IN_PYTHON.get(name, name)}={value}"


def suggest(name: str, known: Iterable[str]) -> str:
    """Return what to do about a name that is not one of the known, for the end of a message."""
    near = get_close_matches(name, list(known), n=1)
    return f"did you mean {near[0]}?" if near else "choose one of these"


def count(number: int, noun: str, plural: str = "") -> str:
    """Return a number with its noun: `1 frame`, `2 frames`.

    plural: of the noun, where it is not the noun with an s.
    """
    return f"{number} {noun if number == 1 else plural or noun + 's'}"


def visible(text: str, *, kept: str = "") -> str:
    """Return a text with its control characters and lone surrogates escaped as Python does.

    kept: control characters that stay.
    """
    return _CONTROL.sub(lambda found: found[0] if found[0] in kept else ascii(found[0])[1:-1], text)


def one_line(value: object, width: int = 80) -> str:
    """Return `value` as text without line breaks, shortened to `width` characters."""
    text = " ".join(str(value).split())
    return text if len(text) <= width else f"{text[: width - 3]}..."


def describe_lost(format: str, lost: Sequence[str]) -> list[str]:
    """Return a line that says what a format does not hold; none where it holds all.

    lost: words that follow "does not hold".
    """
    return [f"{format} does not hold {'; '.join(lost)}"] if lost else []
