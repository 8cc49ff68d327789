"""Read run.json again: what `report` and `overlay` take from it is there, and of its kind."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from types import NoneType
from typing import Any, NoReturn

from mocap_calib.errors import FormatError
from mocap_calib.io.file import read_bytes

_NUMBER = (int, float)
# a mapping has these keys at least; the first entry of a list is the form of all of them
_FORM: Mapping[str, Any] = {
    "schema": int,
    "keypoints": [str],
    "cameras": [
        {
            "name": str,
            "centre_sigma_percent": (*_NUMBER, NoneType),
            "fault_evidence": Mapping,
            "clock": {"used": bool},
        }
    ],
    "groups": [{"folder": str, "cameras": [str]}],
    "epochs": [{"folder": str, "first": int, "last": int, "moved": [str]}],
    "pairs": [Mapping],
    "inputs": Mapping,
    "outputs": Mapping,
    "reading": Mapping,
}
_MAY_LACK = ("inputs", "outputs", "reading")  # further groups of cameras have no hashes
_EVIDENCE = {"mended": bool, "option": (str, NoneType)}


def read_run_json(path: Path, schema: int) -> dict[str, Any]:
    """Return what run.json holds.

    schema: of this version. Raises FormatError where the file is of another one, or was changed.
    """
    source, remedy = str(path), "run again, with this version"
    try:
        found = json.loads(read_bytes(path), parse_constant=_refuse, parse_float=_finite)
    except (ValueError, RecursionError) as error:
        raise FormatError(source, "what `run` writes", f"an error ({error})", remedy) from None
    if isinstance(found, Mapping) and found.get("schema", schema) != schema:
        raise FormatError(source, f"`schema` {schema}", found["schema"], remedy)
    wrong = _first_unlike(found, _FORM, "")
    if wrong is None:
        wrong = _first_unlike_evidence(found["cameras"])
    if wrong is not None:
        raise FormatError(source, "what `run` writes", f"something else at {wrong}", remedy)
    run: dict[str, Any] = found
    return run


def _first_unlike(value: Any, form: Any, place: str) -> str | None:
    """Return the place of the first value that is not of the form, None where all are."""
    if isinstance(form, dict):
        if not isinstance(value, Mapping):
            return place or "its beginning"
        needed = [key for key in form if key in value or key not in _MAY_LACK]
        parts = ((value.get(key), form[key], f"{place}.{key}") for key in needed)
    elif isinstance(form, list):
        if not isinstance(value, list):
            return place
        parts = ((each, form[0], f"{place}[{n}]") for n, each in enumerate(value))
    else:
        known = isinstance(value, form) and (form is bool or type(value) is not bool)
        return None if known else place
    wrong = (_first_unlike(*part) for part in parts)
    return next((each for each in wrong if each is not None), None)


def _first_unlike_evidence(cameras: list[dict[str, Any]]) -> str | None:
    """Return the place of the first fault whose evidence is none, None where all is."""
    for number, camera in enumerate(cameras):
        for fault in ("mirrored", "sides"):
            evidence = camera["fault_evidence"].get(fault)
            place = f".cameras[{number}].fault_evidence.{fault}"
            if evidence is not None and (wrong := _first_unlike(evidence, _EVIDENCE, place)):
                return wrong
    return None


def _refuse(name: str) -> NoReturn:
    raise ValueError(f"{name} is no number")


def _finite(text: str) -> float:
    value = float(text)
    return value if math.isfinite(value) else _refuse(text)
