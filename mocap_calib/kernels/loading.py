"""Compiled kernels, where numba is at hand."""

from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_calib.kernels import machine_code
from mocap_calib.kernels.jit import numba_fits


@cache
def kernels_at_hand() -> bool:
    """Return whether kernels can be compiled: numba is installed and fits this numpy."""
    return find_spec("numba") is not None and (machine_code.is_kept_here() or numba_fits())


@cache
def compiled(module: str) -> ModuleType | None:
    """Return a module of kernels by its full name; None where its numpy definitions are to run.

    The first import on a machine compiles, which takes some seconds.
    """
    return import_module(module) if kernels_at_hand() else None


def compile_ahead() -> list[str]:
    """Compile all kernels, so that no calibration waits for them, and return their modules."""
    own = {"__init__", "jit", "loading", "machine_code"}
    names = sorted({file.stem for file in Path(__file__).parent.glob("*.py")} - own)
    return [name for name in names if compiled(f"{__package__}.{name}")]


def contiguous(*arrays: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """Return arrays in C order, as kernels take them; those that are so already as they are."""
    return tuple(np.ascontiguousarray(array) for array in arrays)
