"""Keep the pairs that a long run has found so far: a run that was killed need not find them again.

Each pair has a file. It is recognised by a hash of all that the pair follows from: the detections,
their lifted bodies and its random generator, and what the caller says of how it is calibrated.
"""

import hashlib
import json
import pickle
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast

from mocap_calib.errors import FormatError
from mocap_calib.io.atomic import write_bytes
from mocap_calib.io.results.pairs_json import pair_fields, pair_from_fields
from mocap_calib.results import PairwiseCalibration
from mocap_calib.types import Mapper

T = TypeVar("T")
R = TypeVar("R")


def remember_pairs(mapper: Mapper, folder: Path, method: str) -> Mapper:
    """Return a mapper that keeps the results of `mapper` in `folder`, and does not repeat them.

    It maps functions whose results are pairs or None.

    method: all that the results follow from besides the items: configuration, weights, code.
    """

    def map_unknown(function: Callable[[T], R], items: Iterable[T], /) -> Iterator[R]:
        known: list[R] = []

        def unknown() -> Iterator[tuple[Path, T]]:
            for item in items:
                path = folder / f"{_hash(method, item)}.json"
                try:
                    known.append(cast(R, _decode(path.read_bytes())))
                except (OSError, FormatError, LookupError, ValueError, TypeError, AttributeError):
                    yield path, item  # not there, or damaged

        for path, result in mapper(partial(_call_beside, function), unknown()):
            write_bytes(path, _encode(cast(PairwiseCalibration | None, result)))
            yield result
        yield from known

    return map_unknown


def _hash(method: str, item: Any) -> str:
    return hashlib.sha256(pickle.dumps((method, item))).hexdigest()


def _call_beside(function: Callable[[T], R], named: tuple[Path, T]) -> tuple[Path, R]:
    """Call the function of an item; return the item's path beside the result."""
    path, item = named
    return path, function(item)


def _encode(pair: PairwiseCalibration | None) -> bytes:
    return json.dumps(None if pair is None else pair_fields(pair)).encode()


def _decode(content: bytes) -> PairwiseCalibration | None:
    """Return what was encoded. Raises what `json.loads` and `pair_from_fields` raise on damage."""
    stored = json.loads(content)
    return None if stored is None else pair_from_fields(stored, "pair")
