"""pairs.json: calibrated pairs of cameras; and the pairs of a long run, kept one by one.

A run that was killed need not find its pairs again: each has a file, recognised by a hash of
all that the pair follows from (detections, their lifted bodies, random generator, and what
the caller says of how it is calibrated).
"""

import hashlib
import json
import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from mocap_calib.errors import FormatError, one_line
from mocap_calib.io.atomic import write_bytes
from mocap_calib.io.camera_checks import describe_keys, numbers
from mocap_calib.io.formats.own_cameras import camera_fields, camera_from_fields
from mocap_calib.io.zeros import unsigned_zeros
from mocap_calib.results import PairwiseCalibration
from mocap_calib.types import Camera, Mapper

T = TypeVar("T")
R = TypeVar("R")

VERSION = 1
_FORMAT = "mocap-calib pairs"
_REMEDY = "give the file that `pairwise` wrote"


def pair_fields(pair: PairwiseCalibration) -> dict[str, Any]:
    """Return a pair as JSON has it: every digit is kept in Python, and so are NaN and infinity."""
    alternatives = [_own_fields(alternative) for alternative in pair.alternatives]
    return _own_fields(pair) | {"alternatives": alternatives}


def pair_from_fields(stored: Mapping[str, Any], source: str) -> PairwiseCalibration:
    """Return the pair that `pair_fields` spelt; alternatives may be absent, null is NaN.

    source: what complaints call the pair.

    Raises FormatError, and LookupError, TypeError, ValueError, AttributeError or OverflowError for
    what is no pair.
    """
    alternatives = stored.get("alternatives", [])
    return PairwiseCalibration(
        a=int(stored["a"]),
        b=int(stored["b"]),
        rotation=numbers(stored["rotation"], "a 3 x 3 rotation", source).reshape(3, 3),
        translation=numbers(stored["translation"], "a translation", source).reshape(3),
        matches=np.array(stored["matches"], dtype=np.int64).reshape(-1, 3),
        frames=int(stored["frames"]),
        score=_figure(stored["score"]),
        residual=_figure(stored["residual"]),
        in_front=_figure(stored["in_front"]),
        source=str(stored["source"]),
        alternatives=tuple(pair_from_fields(each, source) for each in alternatives),
    )


def pairs_to_json(pairs: Sequence[PairwiseCalibration], cameras: Sequence[Camera]) -> str:
    """Return the calibrated pairs with their cameras, which is all that averaging needs.

    Cameras are named, and NaN is null. A camera and a pair take a line each.
    """
    head = {
        "format": _FORMAT,
        "version": VERSION,
        "transform": "b_from_a, baseline in body sizes",
    }
    names = [camera.name for camera in cameras]
    members = [f"{json.dumps(key)}: {json.dumps(value)}" for key, value in head.items()]
    members.append(_json_list("cameras", [camera_fields(camera) for camera in cameras]))
    members.append(
        _json_list("pairs", [_with_camera_names(pair_fields(pair), names) for pair in pairs])
    )
    return "{\n" + ",\n".join(members) + "\n}\n"


def pairs_from_json(
    text: str, source: str
) -> tuple[tuple[PairwiseCalibration, ...], tuple[Camera, ...]]:
    """Return the pairs and the cameras that `pairs_to_json` wrote.

    source: what complaints call the text.

    Raises FormatError.
    """
    data = _parse(text, source)
    cameras = tuple(camera_from_fields(each, source) for each in data["cameras"])
    index = {camera.name: view for view, camera in enumerate(cameras)}
    pairs = []
    try:
        for number, stored in enumerate(data["pairs"]):
            where = f"{source}: pair {number}"
            pair = pair_from_fields(_with_camera_indices(stored, index), where)
            _check_alternatives(pair, where)
            pairs.append(pair)
    except FormatError:
        raise
    except (LookupError, ValueError, TypeError, AttributeError, OverflowError) as error:
        found = f"an error ({one_line(error)})"
        raise FormatError(source, "pairs of the cameras named", found, _REMEDY) from None
    return tuple(pairs), cameras


def _own_fields(pair: PairwiseCalibration) -> dict[str, Any]:
    """Return all fields of a pair but its alternatives."""
    own = {}
    for field in fields(pair):
        if field.name != "alternatives":
            value = getattr(pair, field.name)
            own[field.name] = value.tolist() if isinstance(value, np.ndarray) else value
    return own


def _figure(value: Any) -> float:
    return np.nan if value is None else float(value)


def _with_camera_names(stored: Mapping[str, Any], names: Sequence[str]) -> dict[str, Any]:
    """Return the fields of a pair with the names of its cameras, and null for what is no number."""
    named = dict(stored)
    for key, value in stored.items():
        if isinstance(value, float) and not np.isfinite(value):
            named[key] = None
    named |= {"a": names[stored["a"]], "b": names[stored["b"]]}
    if "alternatives" in stored:
        named["alternatives"] = [_with_camera_names(each, names) for each in stored["alternatives"]]
    return named


def _with_camera_indices(stored: Mapping[str, Any], index: Mapping[str, int]) -> dict[str, Any]:
    """Return the fields of a pair with the indices of its cameras."""
    indexed = dict(stored)
    indexed |= {"a": index[stored["a"]], "b": index[stored["b"]]}
    indexed["alternatives"] = [
        _with_camera_indices(each, index) for each in stored.get("alternatives", [])
    ]
    return indexed


def _check_alternatives(pair: PairwiseCalibration, source: str) -> None:
    """Raise FormatError where an alternative is of other cameras."""
    cameras = {pair.a, pair.b}
    if any({alternative.a, alternative.b} != cameras for alternative in pair.alternatives):
        raise FormatError(source, "alternatives of the same two cameras", "others", _REMEDY)


def _json_list(name: str, entries: Sequence[Any]) -> str:
    """Return a member of a JSON object that is a list, with an entry a line."""
    lines = ",\n  ".join(json.dumps(each, ensure_ascii=False) for each in unsigned_zeros(entries))
    return f"{json.dumps(name)}: [\n  {lines}\n]"


def _parse(text: str, source: str) -> dict[str, Any]:
    """Return the parsed file, which has lists of cameras and pairs. Raises FormatError."""
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FormatError(source, "JSON", f"an error ({error})", _REMEDY) from None
    head = (data.get("format"), data.get("version")) if isinstance(data, dict) else None
    if head != (_FORMAT, VERSION):
        expected = f"{_FORMAT}, version {VERSION}"
        raise FormatError(source, expected, describe_keys(data), _REMEDY)
    if not isinstance(data.get("cameras"), list) or not isinstance(data.get("pairs"), list):
        raise FormatError(source, "lists of cameras and pairs", describe_keys(data), _REMEDY)
    return data


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
