"""The account of a file: which of its numbers no reader asked for.

Readers of mappings ask `Fields`, readers of records say theirs by their types (`typed`), those of
tables and of HDF5 by the names of columns and data sets. What is left is reported, once.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import chain
from typing import Any

import msgspec
import numpy as np

from mocap_calib.errors import one_line

_LISTED = 8  # names in a remark
_LONGEST = 60  # letters of a name
_MOST_NAMES = 200  # of fields; more are names of images or of cameras, whose fields are of one kind


@dataclass
class Account:
    """What a file holds, and what of it was asked for.

    there: where its numbers are: names, from the outermost mapping to the field, in order.
    asked: names of fields that were asked for, wherever they are.
    kind: what the names are.
    """

    there: dict[tuple[str, ...], None] = field(default_factory=dict)
    asked: set[str] = field(default_factory=set)
    kind: str = "keys"

    def add(self, tree: Any) -> Any:
        """Enter the numbers of parsed text; return it with `Fields` for its mappings."""
        self.add_numbers(tree)
        return self._noted(tree)

    def _noted(self, tree: Any) -> Any:
        if isinstance(tree, dict):
            return Fields({key: self._noted(each) for key, each in tree.items()}, self.asked)
        is_deep = isinstance(tree, list) and tree and isinstance(tree[0], dict | list)
        return [self._noted(each) for each in tree] if is_deep else tree

    def add_names(self, names: Iterable[str], kind: str = "keys") -> None:
        """Enter numbers by their names alone."""
        self.there |= dict.fromkeys((name,) for name in names)
        self.kind = kind

    def add_numbers(self, tree: Any) -> None:
        """Enter the numbers of parsed text."""
        self.there |= dict.fromkeys(_find_numbers(_mappings_in(tree)))

    def describe(self, passed_over: Iterable[str] = ()) -> tuple[str, ...]:
        """Return a remark on the names that no one asked for; none where there are none.

        passed_over: names that do not count, nor what is below them, nor behind a dot.
        """
        known = {*passed_over}
        left = (path for path in self.there if known.isdisjoint([*path, path[-1].split(".")[-1]]))
        unused = (path[-1] for path in left if path[-1] not in self.asked)
        names = list(dict.fromkeys(one_line(name, _LONGEST) for name in unused))
        more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
        return (f"{self.kind} not used: {', '.join(names[:_LISTED])}{more}",) if names else ()


class Fields(dict[Any, Any]):
    """A mapping that notes which of its fields are asked for; `in` asks for none."""

    def __init__(self, fields: Mapping[Any, Any], asked: set[str]) -> None:
        super().__init__(fields)
        self.asked = asked

    def __getitem__(self, key: Any) -> Any:
        self.asked.add(str(key))
        return super().__getitem__(key)

    def get(self, key: Any, default: Any = None) -> Any:
        """Return a field, or the default."""
        self.asked.add(str(key))
        return super().get(key, default)

    def __or__(self, other: Any) -> Any:
        return Fields(super().__or__(other), self.asked)


def record_fields(kind: Any) -> frozenset[str]:
    """Return the names of the fields of all records in a type."""
    return _record_fields(kind)


@cache
def _record_fields(kind: Any) -> frozenset[str]:
    _, schemas = msgspec.json.schema_components([kind])
    return frozenset(name for each in schemas.values() for name in each.get("properties", ()))


def _find_numbers(
    mappings: Sequence[dict[Any, Any]], above: tuple[str, ...] = ()
) -> Iterator[tuple[str, ...]]:
    """Yield the place of each field that holds numbers in any of the mappings of one kind."""
    names = dict.fromkeys(chain.from_iterable(mappings))
    if len(names) > _MOST_NAMES:
        merged = [
            item for each in mappings for value in each.values() for item in _mappings_in(value)
        ]
        yield from _find_numbers(merged, above)
        return
    for name in names:
        values = [each[name] for each in mappings if name in each]
        place, below = (*above, str(name)), [item for each in values for item in _mappings_in(each)]
        if below:
            yield from _find_numbers(below, place)
        elif any(map(_is_number, values)):
            yield place


def _mappings_in(value: Any) -> list[dict[Any, Any]]:
    """Return a mapping, or those in nested lists; none where these begin with something else."""
    if isinstance(value, dict):
        return [] if _is_matrix(value) else [value]
    if isinstance(value, list) and isinstance(_first(value), dict):
        return [item for each in value for item in _mappings_in(each)]
    return []


def _is_matrix(value: Any) -> bool:
    return isinstance(value, dict) and not isinstance(value.get("data", {}), dict)


def _first(value: Any) -> Any:
    """Return the first entry of nested lists, of an array, or of a matrix as OpenCV writes it."""
    value = value["data"] if _is_matrix(value) else value
    value = value.ravel()[:1].tolist() if isinstance(value, np.ndarray) else value
    while isinstance(value, list | tuple) and value:
        value = value[0]
    return value


def _is_number(value: Any) -> bool:
    """Return whether a value is a number, or numbers."""
    return isinstance(_first(value), int | float | np.number)
