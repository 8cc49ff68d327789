"""Counts in words, for messages."""


def count(number: int, noun: str, plural: str = "") -> str:
    """Return a number with its noun: `1 frame`, `2 frames`.

    plural: of the noun, where it is not the noun with an s.
    """
    return f"{number} {noun if number == 1 else plural or noun + 's'}"
