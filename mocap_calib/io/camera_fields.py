"""The names under which programs write the fields of a camera: one table for all formats.

OpenCV fixes none: those of public scripts, of MATLAB, ROS and Kalibr are known. Case, blanks, `_`
and `-` do not count: `Camera_Matrix` is `cameraMatrix`.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mocap_calib.errors import FormatError

_IMAGE = "(image|img|im|frame|video)?"
_MATRIX = "mat(rix)?|mtx"
_NUMBERS = "(coe?f+(icient)?s?|param(eter)?s?|vec(tor)?|val(ue)?s?)?"
_KEYS = {
    "matrix": f"k|m1|(cam(era)?|intrinsics?|calibration|k)?({_MATRIX})|(cam(era)?)?(intrinsics?|k)"
    f"({_MATRIX}|param(eter)?s?)?",
    "distortion": f"d1?|kc|(cam(era)?|lens)?dist(ort(ion)?s?)?{_NUMBERS}",
    "radial": f"r(adial)?dist(ort(ion)?)?{_NUMBERS}",
    "tangential": f"t(angential)?dist(ort(ion)?)?{_NUMBERS}",
    "rotation": f"r|rvecs?|rot(ation)?({_MATRIX}|vec(tor)?)?|r({_MATRIX})",
    "translation": "t|tvecs?|trans(lation)?(vec(tor)?)?",
    "size": f"{_IMAGE}(size|resolution)",
    "shape": f"{_IMAGE}shape",
    "width": f"{_IMAGE}(width|w)",
    "height": f"{_IMAGE}(height|h)",
}
_PATTERNS = {name: re.compile(pattern) for name, pattern in _KEYS.items()}
_LENS_TERMS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")  # each a field of its own
_FISHEYE_TERMS = ("k1", "k2", "k3", "k4")
_PINHOLE_TERMS = ("fx", "fy", "cx", "cy")
_COUNTS = (4, 5, 8)  # that distortions have
_TRUE = ("1", "1.0", "true", "yes")
_DISTORTION_MODELS = ("distortionmodel", "model")  # whose words are of lenses alone
_MODEL = re.compile("(distortion|camera|cam|lens|projection)?(model|type)|projection")
_FISHEYE_MODELS = ("equidistant", "fisheye", "opencvfisheye", "kannalabrandt", "kannalabrandt4")
_PINHOLE_MODELS = (
    *("", "plumbbob", "rationalpolynomial", "opencv", "pinhole", "radtan", "none", "fullopencv"),
    *("brown", "brownconrady", "radialtangential", "perspective", "simplepinhole"),
)
_OTHER_MODELS = ("omni", "omnidirectional", "mei", "unified", "fov", "doublesphere", "ds", "eucm")


def plain_key(key: Any) -> str:
    """Return the name of a field as the table spells it: in lower case, letters and digits."""
    return re.sub("[_ -]", "", str(key).lower())


def camera_fields(fields: dict[str, Any], source: str, end: str = "") -> dict[str, Any]:
    """Return the arguments of a `RawCamera` that the fields state; None where they do not.

    end: of the names of the fields, where those of several cameras are in one mapping.

    Raises FormatError for a distortion model that is neither OpenCV's nor its fisheye model.
    """
    own = [key for key in fields if str(key).endswith(end)]
    keys = {plain_key(str(key).removesuffix(end)): key for key in own}
    found = {name: _pick(fields, keys, pattern) for name, pattern in _PATTERNS.items()}
    fisheye = _is_fisheye(fields, keys, source)
    radial, tangential = found.pop("radial"), found.pop("tangential")
    if found["distortion"] is None and radial is not None:
        first, second, *third = np.ravel(radial)
        middle = [0.0, 0.0] if tangential is None else np.ravel(tangential)
        found["distortion"] = [first, second, *middle, *third]
    if found["distortion"] is None and "k1" in keys:
        found["distortion"] = _terms(fields, keys, _FISHEYE_TERMS if fisheye else _LENS_TERMS)
    if found["matrix"] is None and {*_PINHOLE_TERMS} <= {*keys}:
        found["matrix"] = [fields[keys[term]] for term in _PINHOLE_TERMS]
    shape, size = found.pop("shape"), [found.pop("width"), found.pop("height")]
    if found["size"] is None:
        found["size"] = shape[1::-1] if isinstance(shape, list) else size
    return found | {"fisheye": fisheye}


def has_matrix(fields: Any) -> bool:
    """Return whether a mapping has a camera matrix under any of its names, or its four numbers."""
    named = fields.items() if isinstance(fields, Mapping) else ()
    keys = {plain_key(key) for key, value in named if not _holds_records(value)}
    return {*_PINHOLE_TERMS} <= keys or any(map(_PATTERNS["matrix"].fullmatch, keys))


def _pick(fields: dict[str, Any], keys: dict[str, Any], pattern: re.Pattern[str]) -> Any:
    """Return the first field whose name the pattern matches, None where there is none.

    Many rotations or translations are those of the views of a board.
    """
    for name, key in keys.items():
        value = dict.get(fields, key)  # which is not asked for yet
        if pattern.fullmatch(name) and not _holds_records(value):
            data = value.get("data") if isinstance(value, dict) else value
            if not name.endswith("vecs") or np.size(np.array(data)) in (3, 9):
                return fields[key]
    return None


def _holds_records(value: Any) -> bool:
    """Return whether a value is a mapping, or a list of such, and no matrix as OpenCV writes it."""
    first = value[0] if isinstance(value, list) and value else value
    return isinstance(first, dict) and "data" not in first


def _terms(fields: dict[str, Any], keys: dict[str, Any], terms: Sequence[str]) -> list[Any]:
    """Return distortion coefficients that have a field each, 0 for those that are absent."""
    last = max(place for place, term in enumerate(terms) if term in keys)
    count = next(count for count in _COUNTS if last < count)
    return [fields[keys[term]] if term in keys else 0.0 for term in terms[:count]]


def _is_fisheye(fields: dict[str, Any], keys: dict[str, Any], source: str) -> bool:
    """Return whether a flag or the name of a model states a fisheye. Raises FormatError."""
    fisheye = False
    for name, key in keys.items():
        if "fisheye" in name:
            fisheye |= str(fields[key]).lower() in _TRUE
        elif _MODEL.fullmatch(name):
            model = plain_key(fields[key])
            is_known = model in (*_FISHEYE_MODELS, *_PINHOLE_MODELS)
            if model in _OTHER_MODELS or (name in _DISTORTION_MODELS and not is_known):
                expected = "the distortion model plumb_bob, rational_polynomial or equidistant"
                found = str(fields[key]).lower()
                raise FormatError(source, expected, found, "calibrate with one of them")
            fisheye |= model in _FISHEYE_MODELS
    return fisheye
