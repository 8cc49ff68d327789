"""Counts and values in words, and individuals in colours, for messages and pictures."""

from collections.abc import Sequence


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


# by Okabe and Ito (jfly.uni-koeln.de/color), told apart by colour-blind people too; without black
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#f0e442")
UNASSIGNED = "#9a9a9a"  # of detections without an individual


def colour_of(individual: int) -> str:
    """Return the colour of an individual as #rrggbb, -1 = unassigned; seven colours in turn."""
    return UNASSIGNED if individual < 0 else COLOURS[individual % len(COLOURS)]


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue from 0 to 255 of #rrggbb."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue
