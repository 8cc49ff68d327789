"""pairs.json: calibrated pairs of cameras; and the pairs of a long run, kept one by one.

A run that was killed need not find its pairs again: each has a file, recognised by a hash of
all that the pair follows from (detections, their lifted bodies, random generator, and what
the caller says of how it is calibrated).
"""

import hashlib
import json
import math
import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocap_calib.errors import FormatError, one_line
from mocap_calib.io.atomic import write_bytes
from mocap_calib.io.file import unsigned_zeros
from mocap_calib.io.formats.own_cameras import camera_fields, camera_from_fields
from mocap_calib.results import PairwiseCalibration
from mocap_calib.types import Camera, Ints, Mapper, check_shape

T = TypeVar("T")
R = TypeVar("R")

_REMEDY = "give the file that `pairwise` wrote"
_HEAD = {
    "format": "mocap-calib pairs",
    "version": 1,
    "transform": "b_from_a, baseline in body sizes",
}
_DAMAGE = (msgspec.MsgspecError, LookupError, ValueError, TypeError, AttributeError, OverflowError)


class _File(msgspec.Struct):
    """What is read of a file; the cameras of a pair are named."""

    format: Literal["mocap-calib pairs"]
    version: Literal[1]
    cameras: list[dict[str, Any]]
    pairs: list[dict[str, Any]]


def pairs_to_json(pairs: Sequence[PairwiseCalibration], cameras: Sequence[Camera]) -> str:
    """Return the calibrated pairs with their cameras, which is all that averaging needs.

    Cameras are named, and NaN is null. A camera and a pair take a line each.
    """
    names = [camera.name for camera in cameras]
    spelt = [
        _with_names(pair, names)
        | {"alternatives": [_with_names(other, names) for other in pair.alternatives]}
        for pair in pairs
    ]
    members = [f"{json.dumps(key)}: {json.dumps(value)}" for key, value in _HEAD.items()]
    members.append(_json_list("cameras", [camera_fields(camera) for camera in cameras]))
    members.append(_json_list("pairs", spelt))
    return "{\n" + ",\n".join(members) + "\n}\n"


def pairs_from_json(
    text: str, source: str
) -> tuple[tuple[PairwiseCalibration, ...], tuple[Camera, ...]]:
    """Return the pairs and the cameras that `pairs_to_json` wrote.

    source: what complaints call the text.

    Raises FormatError.
    """
    try:
        file = msgspec.json.decode(text, type=_File)
        cameras = tuple(camera_from_fields(each, source) for each in file.cameras)
        index = {camera.name: view for view, camera in enumerate(cameras)}
        pairs = tuple(_read_pair(_with_indices(pair, index)) for pair in file.pairs)
    except FormatError:
        raise
    except (*_DAMAGE, RecursionError) as error:
        found = f"an error ({one_line(error)})"
        raise FormatError(source, "the pairs that `pairwise` writes", found, _REMEDY) from None
    return pairs, cameras


def _with_names(pair: PairwiseCalibration, names: Sequence[str]) -> dict[str, Any]:
    """Return the fields of a pair but its alternatives, null for what is no finite number."""
    fields = _spell(pair) | {"a": names[pair.a], "b": names[pair.b]}
    del fields["alternatives"]
    numbers = {key: value for key, value in fields.items() if isinstance(value, float)}
    return fields | {key: None for key, value in numbers.items() if not math.isfinite(value)}


def _with_indices(stored: Mapping[str, Any], index: Mapping[str, int]) -> dict[str, Any]:
    """Return the fields of a pair with the indices of its cameras, NaN for null."""
    fields = {key: np.nan if value is None else value for key, value in stored.items()}
    alternatives = [_with_indices(each, index) for each in stored.get("alternatives", [])]
    return fields | {
        "a": index[stored["a"]],
        "b": index[stored["b"]],
        "alternatives": alternatives,
    }


def _json_list(name: str, entries: Sequence[Any]) -> str:
    """Return a member of a JSON object that is a list, with an entry a line."""
    lines = ",\n  ".join(json.dumps(each, ensure_ascii=False) for each in unsigned_zeros(entries))
    return f"{json.dumps(name)}: [\n  {lines}\n]"


def _spell(pair: PairwiseCalibration | None) -> Any:
    """Return a pair as JSON has it: every digit is kept in Python, and so are NaN and infinity."""
    return msgspec.to_builtins(pair, enc_hook=lambda value: value.tolist())


def _read_pair(stored: Any) -> PairwiseCalibration:
    """Return the pair that `_spell` spelt. Raises one of `_DAMAGE` for what is no pair."""
    pair = msgspec.convert(stored, PairwiseCalibration, dec_hook=_as_array)
    check_shape("rotation", pair.rotation, 3, 3)
    check_shape("translation", pair.translation, 3)
    if any({other.a, other.b} != {pair.a, pair.b} for other in pair.alternatives):
        raise ValueError("alternatives of other cameras")
    return pair


def _as_array(kind: Any, values: Any) -> NDArray[Any]:
    """Return nested lists as an array of a pair: whole numbers are its `[match, 3]`."""
    if kind == Ints:
        return np.array(values, dtype=np.int64).reshape(-1, 3)
    return np.array(values, dtype=np.float64)


# --- pairs of a run that is under way


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
                    stored = json.loads(path.read_bytes())
                    known.append(cast(R, None if stored is None else _read_pair(stored)))
                except (OSError, *_DAMAGE):
                    yield path, item  # not there, or damaged

        for path, result in mapper(partial(_call_beside, function), unknown()):
            write_bytes(path, json.dumps(_spell(cast(Any, result))).encode())
            yield result
        yield from known

    return map_unknown


def _hash(method: str, item: Any) -> str:
    return hashlib.sha256(pickle.dumps((method, item))).hexdigest()


def _call_beside(function: Callable[[T], R], named: tuple[Path, T]) -> tuple[Path, R]:
    """Call the function of an item; return the item's path beside the result."""
    path, item = named
    return path, function(item)
