"""The types of arguments that are numbers within bounds: infinity and NaN are none."""

import math
from typing import Any

import click


class Number(click.FloatRange):
    """A number within bounds; infinity and NaN are none."""

    name = "number"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return the number. Raises click's BadParameter."""
        try:
            number = super().convert(value, param, ctx)
        except click.BadParameter:
            number = math.nan
        if not math.isfinite(number):
            self.fail(f"expected a number{_describe_bounds(self)}, found {value}", param, ctx)
        return number


class WholeNumber(click.IntRange):
    """A whole number within bounds."""

    name = "integer"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Return the number. Raises click's BadParameter."""
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter:
            bounds = _describe_bounds(self)
            self.fail(f"expected a whole number{bounds}, found {value}", param, ctx)


def _describe_bounds(kind: click.IntRange | click.FloatRange) -> str:
    """Return what the bounds of a number are, in words."""
    if kind.max is not None:
        return f" from {kind.min:g} to {kind.max:g}"
    return f" above {kind.min:g}" if kind.min_open else f" of {kind.min:g} or more"


COUNT = WholeNumber(min=1)
SEED = WholeNumber(min=0)
SHARE = Number(min=0, max=1)
NOT_NEGATIVE = Number(min=0)
POSITIVE = Number(min=0, min_open=True)
