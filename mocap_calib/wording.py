"""Counts and values in words, for messages."""


def count(number: int, noun: str, plural: str = "") -> str:
    """Return a number with its noun: `1 frame`, `2 frames`.

    plural: of the noun, where it is not the noun with an s.
    """
    return f"{number} {noun if number == 1 else plural or noun + 's'}"


def one_line(value: object, width: int = 80) -> str:
    """Return `value` as text without line breaks, shortened to `width` characters."""
    text = " ".join(str(value).split())
    return text if len(text) <= width else f"{text[: width - 3]}..."
