"""What all records share: arrays of documented shapes, comparison by value, a text in short."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mocap_calib.wording import one_line


def check_shape(owner: str, array: NDArray[np.generic], *shape: int | None) -> None:
    """Hold an array to its documented shape `[*shape]`; None stands for any length.

    Raises ValueError, which names the owner and both shapes.
    """
    fits = array.ndim == len(shape) and all(
        expected in (None, found) for expected, found in zip(shape, array.shape, strict=True)
    )
    if not fits:
        expected = tuple("any" if length is None else length for length in shape)
        raise ValueError(f"{owner}: expected shape {expected}, got {array.shape}")


def as_array(owner: str, values: ArrayLike, kind: type[Any], *shape: int | None) -> NDArray[Any]:
    """Return values, which may be lists, as an array of the documented shape `[*shape]`.

    kind: float, int or bool; arrays of 32-bit floats stay as they are. None in the shape stands
    for any length.

    Raises ValueError, which names the owner, for another shape and for what is no such number.
    """
    try:
        given = np.asarray(values)
        is_kept = kind is float and given.dtype == np.float32
        with np.errstate(invalid="ignore"):  # NaN as a whole number
            array = given if is_kept else np.asarray(given, dtype=kind)
    except (TypeError, ValueError):
        raise ValueError(f"{owner}: expected numbers, got {_quote(values)}") from None
    if kind is int and given.dtype.kind == "f" and not np.array_equal(given, array):
        raise ValueError(f"{owner}: expected whole numbers, got {_quote(values)}")
    check_shape(owner, array, *shape)
    return array


def check_names(owner: str, names: Sequence[str]) -> None:
    """Raise ValueError where names are one text, or one of them is there twice."""
    if isinstance(names, str):
        raise ValueError(f"{owner}: expected a list of names, got the text {_quote(names)}")
    twice = sorted({name for name in names if list(names).count(name) > 1})
    if twice:
        raise ValueError(f"{owner}: expected each name once, got {_quote(twice)} several times")


class Record:
    """What the frozen records share: they compare by value, print in short, and take lists.

    Two records are equal where their arrays have equal shapes and elements; NaN equals NaN.
    Cameras and rigs copy the arrays that they are made of; recordings and all that is as large as
    they are do not: what is written into the array of a caller changes the record.
    """

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(
            _equal(getattr(self, each.name), getattr(other, each.name))
            for each in fields(self)  # type: ignore[arg-type]  # all records are dataclasses
            if each.compare
        )

    # records hold arrays, which have no hash
    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        parts = [
            f"{each.name}={_summarise(getattr(self, each.name))}"
            for each in fields(self)  # type: ignore[arg-type]
        ]
        return f"{type(self).__name__}({', '.join(parts)})"

    def _hold(self, owner: str, name: str, kind: type[Any], *shape: int | None) -> None:
        """Hold the field of that name to its shape; a list becomes an array. Raises ValueError."""
        array = as_array(f"{owner}: {name}", getattr(self, name), kind, *shape)
        object.__setattr__(self, name, array)

    def _copy(self, owner: str, name: str, kind: type[Any], *shape: int | None) -> None:
        """Hold the field to its shape in an array of its own. Raises ValueError."""
        self._hold(owner, name, kind, *shape)
        object.__setattr__(self, name, np.array(getattr(self, name)))


def _equal(first: object, second: object) -> bool:
    """Return whether two values of a field are equal, arrays by their elements."""
    if isinstance(first, np.ndarray) and isinstance(second, np.ndarray):
        return np.array_equal(first, second, equal_nan=True)
    if isinstance(first, tuple) and isinstance(second, tuple):
        return len(first) == len(second) and all(map(_equal, first, second))
    if isinstance(first, float) and isinstance(second, float) and np.isnan(first):
        return bool(np.isnan(second))
    return bool(first == second)


def _summarise(value: object) -> str:
    """Return the value of a field in a few words: the shape of an array, the length of a tuple.

    Vectors and points are told in full.
    """
    if isinstance(value, np.ndarray):
        return str(value.tolist()) if value.shape == (3,) else f"{value.dtype}{list(value.shape)}"
    if isinstance(value, Record):
        return f"{type(value).__name__}(...)"
    if isinstance(value, tuple) and (len(value) > 4 or isinstance(next(iter(value), 0), Record)):
        return f"{len(value)} x {type(value[0]).__name__}"
    return repr(value)


def _quote(value: object) -> str:
    """Return a value as Python has it, in one short line."""
    return one_line(repr(value), 60)
