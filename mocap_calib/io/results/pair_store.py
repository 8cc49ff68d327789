"""The pairs that a long run has found so far, one file each: a run that was killed need not find them again.

A pair is recognised by a hash of all that it follows from: the detections, their lifted bodies and its random generator, and
what the caller says of how it is calibrated.
"""

import hashlib
import json
import pickle
from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from mocap_calib.io.atomic import write_bytes
from mocap_calib.types import Mapper, PairwiseCalibration

T = TypeVar("T")
R = TypeVar("R")


def remembering(mapper: Mapper, folder: Path, method: str) -> Mapper:
    """Maps as `mapper` does a function whose results are pairs (or None), and keeps them in `folder`; those found there are not made again.

    method: all that the results follow from besides the items: configuration, weights, version.
    """

    def spread(function: Callable[[T], R], items: Iterable[T], /) -> Iterator[R]:
        known: list[R] = []

        def unknown() -> Iterator[tuple[Path, T]]:
            for item in items:
                path = folder / f"{hashlib.sha256(pickle.dumps((method, item))).hexdigest()}.json"
                try:
                    known.append(cast(R, _decoded(path.read_bytes())))
                except (OSError, ValueError, TypeError):  # not there, or damaged: to be made
                    yield path, item

        for path, result in mapper(partial(_beside, function), unknown()):
            write_bytes(path, _encoded(cast(PairwiseCalibration | None, result)))
            yield result
        yield from known

    return spread


def _beside(function: Callable[[T], R], named: tuple[Path, T]) -> tuple[Path, R]:
    path, item = named
    return path, function(item)


def _encoded(pair: PairwiseCalibration | None) -> bytes:
    """JSON, which keeps every digit in Python; NaN and infinity are kept too."""
    return json.dumps(None if pair is None else _fields(pair)).encode()


def _fields(pair: PairwiseCalibration) -> dict[str, Any]:
    own = {
        field.name: getattr(pair, field.name)
        for field in fields(pair)
        if field.name != "alternatives"
    }
    return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in own.items()} | {
        "alternatives": [_fields(rival) for rival in pair.alternatives]
    }


def _decoded(content: bytes) -> PairwiseCalibration | None:
    stored = json.loads(content)
    return None if stored is None else _pair(stored)


def _pair(stored: dict[str, Any]) -> PairwiseCalibration:
    rotation, translation = (
        np.array(stored.pop("rotation"), np.float64),
        np.array(stored.pop("translation"), np.float64),
    )
    matches = np.array(stored.pop("matches"), np.int64).reshape(-1, 3)
    alternatives = tuple(map(_pair, stored.pop("alternatives")))
    return PairwiseCalibration(
        **stored,
        rotation=rotation,
        translation=translation,
        matches=matches,
        alternatives=alternatives,
    )
