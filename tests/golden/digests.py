"""Digests of files that do not depend on the version of a library or on the last bits of a number.

`canonical(content)` is a text: of text files the text itself, in which numbers of more digits than
`TEXT_DIGITS` are rounded; of HDF5, .npz, .mat and .c3d files their names, shapes and numbers,
rounded to `BINARY_DIGITS`. `digest(content)` is the first half of its SHA-256.
"""

import hashlib
import io
import re
import warnings
from collections.abc import Iterator

import c3d
import h5py
import numpy as np
from scipy.io import loadmat

import mocap_calib

TEXT_DIGITS, BINARY_DIGITS = 9, 6
NEGLIGIBLE = 1e-9  # of 1 in texts, of the largest number of an array elsewhere
_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d*(?:[eE][-+]?\d+)?|[eE][-+]?\d+)(?![\w.])")
_VERSION = re.compile(rf"(?<![\w.]){re.escape(mocap_calib.__version__)}(?![\w.])")
# written by the netCDF libraries with their versions
_OF_LIBRARIES = {"_NCProperties", "DIMENSION_LIST", "REFERENCE_LIST"}


def digest(content: bytes) -> str:
    """Return the first 16 hexadecimal digits of the SHA-256 of the canonical text."""
    return hashlib.sha256(canonical(content).encode("utf-8", "surrogatepass")).hexdigest()[:16]


def canonical(content: bytes) -> str:
    """Return the text that stands for a file."""
    if content.startswith(b"\x89HDF"):
        return "\n".join(_lines_of_hdf5(content))
    if content.startswith(b"PK\x03\x04"):
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            return "\n".join(f"{name}: {describe(archive[name])}" for name in sorted(archive))
    if content.startswith(b"MATLAB"):
        fields = {k: v for k, v in loadmat(io.BytesIO(content)).items() if not k.startswith("__")}
        return "\n".join(f"{name}: {describe(fields[name])}" for name in sorted(fields))
    if content[1:2] == b"\x50" and b"POINT" in content:
        return "\n".join(_lines_of_c3d(content))
    try:
        return round_text(content.decode("utf-8"))
    except UnicodeDecodeError:
        return content.hex()


def round_text(text: str) -> str:
    """Return a text whose long numbers are rounded, and which does not name the version."""
    return _NUMBER.sub(_rounded, _VERSION.sub("VERSION", text))


def _rounded(found: re.Match[str]) -> str:
    word = found.group()
    value = float(word)
    if abs(value) < NEGLIGIBLE:
        return "0.0"
    mantissa = re.split("[eE]", word)[0]
    digits = mantissa.lstrip("-").replace(".", "").lstrip("0")
    return word if len(digits) <= TEXT_DIGITS else repr(float(f"{value:.{TEXT_DIGITS}g}"))


def describe(value: object) -> str:
    """Return type, shape and content of an array, a record of arrays or a plain value."""
    array = np.asarray(value)
    if array.dtype.names:
        fields = ((name, array[name]) for name in array.dtype.names)
        return f"{array.shape} {{" + ", ".join(f"{k}: {describe(v)}" for k, v in fields) + "}"
    if array.dtype.kind == "O":
        return f"objects {array.shape} [{', '.join(_describe_object(x) for x in array.ravel())}]"
    if array.dtype.kind in "SU":
        return f"text {array.shape} {[_as_text(each) for each in array.ravel().tolist()]}"
    if array.dtype.kind in "fc":
        return f"{array.dtype.str} {array.shape} [{', '.join(_round(array))}]"
    return f"{array.dtype.str} {array.shape} {array.ravel().tolist()}"


def _describe_object(value: object) -> str:
    if isinstance(value, bytes | str):
        return _as_text(value)
    return describe(value) if isinstance(value, np.ndarray | np.generic) else type(value).__name__


def _as_text(value: bytes | str) -> str:
    return round_text(value.decode("utf-8", "replace") if isinstance(value, bytes) else value)


def _round(array: np.ndarray) -> Iterator[str]:
    values = array.ravel().astype(float)
    finite = np.abs(values[np.isfinite(values)])
    least = NEGLIGIBLE * finite.max(initial=0.0)
    return (f"{0.0 if abs(x) <= least else x:.{BINARY_DIGITS}g}" for x in values.tolist())


def _lines_of_hdf5(content: bytes) -> list[str]:
    """Return a line for each group, dataset and attribute."""
    lines: list[str] = []

    def add(name: str, item: h5py.Group | h5py.Dataset) -> None:
        held = describe(item[()]) if isinstance(item, h5py.Dataset) else "group"
        lines.append(f"{name}: {held}")
        for key in sorted(set(item.attrs) - _OF_LIBRARIES):
            lines.append(f"{name} @{key}: {describe(item.attrs[key])}")

    with h5py.File(io.BytesIO(content)) as file:
        add("/", file)
        file.visititems(add)
    return lines


def _lines_of_c3d(content: bytes) -> Iterator[str]:
    """Return a line for each parameter and frame."""
    with warnings.catch_warnings(action="ignore"):  # it misses analog data
        reader = c3d.Reader(io.BytesIO(content))
    for name, group in sorted(reader.group_items()):
        for key, parameter in sorted(group.param_items()):
            yield f"{name}:{key} {list(parameter.dimensions)} {bytes(parameter.bytes)!r}"
    for number, points, _ in reader.read_frames(copy=True):
        yield f"{number}: {describe(points)}"
