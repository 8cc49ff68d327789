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

from collections.abc import Iterable, Sequence
from difflib import get_close_matches


class MocapCalibError(Exception):
    """Base of all errors that a user can cause and mend."""


class FormatError(MocapCalibError):
    """A file is not what its format says."""


class MismatchError(MocapCalibError):
    """Two inputs do not belong together."""


class DegenerateError(MocapCalibError):
    """The observations do not determine the answer."""


class UnderconstrainedCameraError(DegenerateError):
    """A camera sees too little that agrees with others; without it they may be calibrated.

    camera: its name.
    """

    def __init__(self, message: str, camera: str) -> None:
        super().__init__(message)
        self.camera = camera


class ClusterError(MocapCalibError):
    """The machines that work was sent to cannot do it."""


def suggest(name: str, known: Iterable[str]) -> str:
    """Return what to do about a name that is not one of the known, for the end of a message."""
    near = get_close_matches(name, list(known), n=1)
    return f"did you mean {near[0]}?" if near else "choose one of these"


def count(number: int, noun: str, plural: str = "") -> str:
    """Return a number with its noun: `1 frame`, `2 frames`.

    plural: of the noun, where it is not the noun with an s.
    """
    return f"{number} {noun if number == 1 else plural or noun + 's'}"


def one_line(value: object, width: int = 80) -> str:
    """Return `value` as text without line breaks, shortened to `width` characters."""
    text = " ".join(str(value).split())
    return text if len(text) <= width else f"{text[: width - 3]}..."


def describe_lost(format: str, lost: Sequence[str]) -> list[str]:
    """Return a line that says what a format does not hold; none where it holds all.

    lost: words that follow "does not hold".
    """
    return [f"{format} does not hold {'; '.join(lost)}"] if lost else []
