"""The types of arguments that are numbers within bounds: infinity and NaN are none."""

import math
from typing import Any

import click


class Number(click.FloatRange):
    """A number within bounds; infinity and NaN are none. whole: a whole number."""

    def __init__(self, *, whole: bool = False, **bounds: Any) -> None:
        super().__init__(**bounds)
        self.name = "integer" if whole else "number"
        self.read: type[int | float] = int if whole else float

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number. Raises click's BadParameter."""
        try:
            number = self.read(value)
            if not math.isfinite(super().convert(number, param, ctx)):
                raise ValueError(value)
        except (ValueError, OverflowError, click.BadParameter):
            kind = "a whole number" if self.read is int else "a number"
            self.fail(f"expected {kind}{self._describe_bounds()}, found {value}", param, ctx)
        return number

    def _describe_bounds(self) -> str:
        """Return what the bounds are, in words."""
        if self.max is not None:
            return f" from {self.min:g} to {self.max:g}"
        return f" above {self.min:g}" if self.min_open else f" of {self.min:g} or more"


COUNT = Number(whole=True, min=1)
SEED = Number(whole=True, min=0)
SHARE = Number(min=0, max=1)
NOT_NEGATIVE = Number(min=0)
POSITIVE = Number(min=0, min_open=True)
