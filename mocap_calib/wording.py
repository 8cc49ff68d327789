"""Counts and values in words, for messages."""

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
