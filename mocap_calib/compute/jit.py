"""How kernels are compiled: the only module that imports numba.

A kernel is a function of loops over numbers, in a module `..._kernels.py` beside the stage that it
serves. It is compiled when its module is imported for the first time, and kept on disk. numba looks
at that file alone to tell whether what it kept is still right: a kernel calls no kernel of another
file. There is always a definition in numpy too, which a test holds it to, and which runs where
numba is missing (`compute.kernels`).
"""

import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any, TypeVar, cast

import numba
from numba import types

Function = TypeVar("Function", bound=Callable[..., Any])

FLOAT = types.float64
SINGLE = types.float32
INT = types.int64
BOOL = types.boolean
OCTET = types.uint8


def _leave_blas_for_later() -> None:
    """Import what numba needs without scipy's BLAS: 0.2 s, for products that no kernel here has.

    Whoever compiles such a product has it imported then.
    """
    blas = "scipy.linalg.cython_blas"
    if blas in sys.modules or "numba.np.arraymath" in sys.modules:
        return
    sys.modules[blas] = None  # type: ignore[assignment] # Python's way to say that it is missing
    try:
        arraymath: Any = import_module("numba.np.arraymath")
    finally:
        del sys.modules[blas]
    arraymath._HAVE_BLAS = True


def kernel(*arguments: Any) -> Callable[[Function], Function]:
    """Compile a function for arguments of these types, without Python's lock.

    Sums stay in the order in which they are written, so that results do not depend on the machine.
    """
    _leave_blas_for_later()

    def compile_it(function: Function) -> Function:
        try:
            found = numba.njit(arguments, cache=True, nogil=True, error_model="numpy")(function)
        except (
            RuntimeError
        ):  # nowhere to keep it: neither beside the file nor in the home directory
            found = numba.njit(arguments, nogil=True, error_model="numpy")(function)
        return cast(Function, found)

    return compile_it


def inlined(function: Function) -> Function:
    """Compile a function that kernels of the same file call, with the first that calls it."""
    return cast(Function, numba.njit(nogil=True, error_model="numpy")(function))


def floats(dimensions: int) -> Any:
    """Return the type of an array of 64-bit floats in C order, which is only read."""
    return types.Array(FLOAT, dimensions, "C", readonly=True)


def singles(dimensions: int) -> Any:
    """Return the type of an array of 32-bit floats in C order, which is only read."""
    return types.Array(SINGLE, dimensions, "C", readonly=True)


def ints(dimensions: int) -> Any:
    """Return the type of an array of 64-bit integers in C order, which is only read."""
    return types.Array(INT, dimensions, "C", readonly=True)


def bools(dimensions: int) -> Any:
    """Return the type of an array of booleans in C order, which is only read."""
    return types.Array(BOOL, dimensions, "C", readonly=True)


def octets(dimensions: int) -> Any:
    """Return the type of an array of bytes in C order, which is only read."""
    return types.Array(OCTET, dimensions, "C", readonly=True)


def changed_floats(dimensions: int) -> Any:
    """Return the type of an array of 64-bit floats in C order, which is changed in place."""
    return types.Array(FLOAT, dimensions, "C")


def changed_singles(dimensions: int) -> Any:
    """Return the type of an array of 32-bit floats in C order, which is changed in place."""
    return types.Array(SINGLE, dimensions, "C")


def changed_ints(dimensions: int) -> Any:
    """Return the type of an array of 64-bit integers in C order, which is changed in place."""
    return types.Array(INT, dimensions, "C")
