"""Variables of MATLAB files (up to version 7), read by scipy behind the crash guard."""

import io
from typing import Any, cast

import numpy as np

from mocap_calib.errors import FormatError, one_line
from mocap_calib.io.crash_guard import guard


def read_mat(
    content: bytes, wanted: tuple[str, ...], *, source: str, expected: str, remedy: str
) -> dict[str, Any]:
    """Return the variables of these names.

    They are arrays, text, lists for cells, and lists of dictionaries for structs (both in MATLAB's
    order); None for functions and objects.

    expected, remedy: of the FormatError that is raised where the file is cut or damaged.
    """
    return guard(
        _read,
        content,
        wanted,
        source,
        expected,
        remedy,
        what="MATLAB file",
        library="scipy",
        source=source,
        size=len(content),
        packed=False,
    )


def _read(
    content: bytes, wanted: tuple[str, ...], source: str, expected: str, remedy: str
) -> dict[str, Any]:
    """Read the variables in the process that is for it."""
    from scipy.io import loadmat  # noqa: PLC0415 - takes 0.2 s

    try:
        found = loadmat(cast(Any, io.BytesIO(content)), variable_names=wanted)
        return {name: _simplify(found[name]) for name in wanted if name in found}
    except MemoryError:
        raise
    except Exception as error:  # scipy raises whatever damage leads to
        reason = f"an error ({one_line(error) or type(error).__name__})"
        raise FormatError(source, expected, reason, remedy) from None


def _simplify(value: Any) -> Any:
    """Return lists, dictionaries and text for what scipy makes arrays of objects of."""
    if not isinstance(value, np.ndarray):
        return None
    if value.dtype.names:
        structs = value.ravel(order="F")
        return [{name: _simplify(each[name]) for name in value.dtype.names} for each in structs]
    if value.dtype.kind == "O":
        return [_simplify(each) for each in value.ravel(order="F")]
    return "".join(value.ravel().tolist()) if value.dtype.kind == "U" else value
