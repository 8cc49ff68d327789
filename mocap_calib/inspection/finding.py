"""The record of something that stands in the way of a run."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """Something that stands in the way.

    critical: a run could not work; else its result may be worse than it could be.
    message: one line, with the remedy.
    """

    critical: bool
    message: str


def critical(message: str) -> Finding:
    """Return a finding without whose remedy a run could not work."""
    return Finding(critical=True, message=message)


def warning(message: str) -> Finding:
    """Return a finding that a run survives."""
    return Finding(critical=False, message=message)
