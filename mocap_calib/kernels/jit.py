"""How kernels are compiled: the only module that imports numba.

A kernel is a function of loops over numbers, in a module `..._kernels.py` beside the stage that it
serves. It is compiled when its module is imported for the first time, and kept on disk, by numba
and as machine code alone (`kernels.machine_code`), with which numba need not be imported. Either
looks at that file alone to tell whether what is kept is still right: a kernel calls no kernel of
another file. It returns nothing or a number, and sets arrays in place: numba would be imported to
return one. There is always a definition in numpy too, which a test holds it to, and which runs
where numba is missing (`kernels.loading`).
"""

import sys
from collections.abc import Callable
from importlib import import_module
from types import FunctionType
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np

from mocap_calib.kernels import machine_code

Function = TypeVar("Function", bound=Callable[..., Any])
Result = TypeVar("Result")


class Argument(NamedTuple):
    """The type of an argument: a number, or an array in C order that may be changed in place."""

    dtype: str
    dimensions: int = 0
    changed: bool = False


FLOAT = Argument("float64")
SINGLE = Argument("float32")
INT = Argument("int64")
BOOL = Argument("bool")
OCTET = Argument("uint8")

_INLINED: set[Any] = set()


def kernel(*arguments: Argument) -> Callable[[Callable[..., Result]], Callable[..., Result]]:
    """Compile a function for arguments of these types, without Python's lock.

    Sums stay in the order in which they are written, so that results do not depend on the machine.
    """

    def compile_it(function: Callable[..., Result]) -> Callable[..., Result]:
        plain = cast(FunctionType, function)
        if found := machine_code.load(plain):
            return _check_arguments(found, arguments)
        return _compile(plain, arguments)

    return compile_it


def inlined(function: Function) -> Function:
    """Compile a function that kernels of the same file call, with the first that calls it."""
    _INLINED.add(function)
    return function


def numba_fits() -> bool:
    """Return whether numba is installed and fits this numpy."""
    try:
        import_module("numba")
    except ImportError:
        return False
    return True


def floats(dimensions: int) -> Argument:
    """Return the type of an array of 64-bit floats in C order, which is only read."""
    return FLOAT._replace(dimensions=dimensions)


def singles(dimensions: int) -> Argument:
    """Return the type of an array of 32-bit floats in C order, which is only read."""
    return SINGLE._replace(dimensions=dimensions)


def ints(dimensions: int) -> Argument:
    """Return the type of an array of 64-bit integers in C order, which is only read."""
    return INT._replace(dimensions=dimensions)


def bools(dimensions: int) -> Argument:
    """Return the type of an array of booleans in C order, which is only read."""
    return BOOL._replace(dimensions=dimensions)


def octets(dimensions: int) -> Argument:
    """Return the type of an array of bytes in C order, which is only read."""
    return OCTET._replace(dimensions=dimensions)


def changed_floats(dimensions: int) -> Argument:
    """Return the type of an array of 64-bit floats in C order, which is changed in place."""
    return FLOAT._replace(dimensions=dimensions, changed=True)


def changed_singles(dimensions: int) -> Argument:
    """Return the type of an array of 32-bit floats in C order, which is changed in place."""
    return SINGLE._replace(dimensions=dimensions, changed=True)


def changed_ints(dimensions: int) -> Argument:
    """Return the type of an array of 64-bit integers in C order, which is changed in place."""
    return INT._replace(dimensions=dimensions, changed=True)


def changed_octets(dimensions: int) -> Argument:
    """Return the type of an array of bytes in C order, which is changed in place."""
    return OCTET._replace(dimensions=dimensions, changed=True)


def changed_bools(dimensions: int) -> Argument:
    """Return the type of an array of booleans in C order that is changed in place."""
    return BOOL._replace(dimensions=dimensions, changed=True)


def _check_arguments(
    function: Callable[..., Any], arguments: tuple[Argument, ...]
) -> Callable[..., Any]:
    """Hold arrays to what machine code takes them for, as numba does."""
    arrays = [
        (place, np.dtype(each.dtype), each)
        for place, each in enumerate(arguments)
        if each.dimensions
    ]

    def call(*given: Any) -> Any:
        for place, dtype, each in arrays:
            array = given[place]
            flags = array.flags
            if (
                array.dtype != dtype
                or array.ndim != each.dimensions
                or not flags.c_contiguous
                or (each.changed and not flags.writeable)
            ):
                raise TypeError(f"argument {place}: expected {each}, found {array.dtype} {flags}")
        return function(*given)

    return call


def _compile(function: FunctionType, arguments: tuple[Argument, ...]) -> Callable[..., Any]:
    """Have numba compile a function, and keep what it made."""
    numba = import_module("numba")
    _leave_blas_for_later()
    _compile_inlined(function.__globals__)
    signature = tuple(_type_of(each) for each in arguments)
    try:
        found = numba.njit(signature, cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:  # nowhere to keep it: neither beside the file nor in the home directory
        found = numba.njit(signature, nogil=True, error_model="numpy")(function)
    if code := _machine_code(found):
        machine_code.keep(function, code)
    return cast(Callable[..., Any], found)


def _type_of(argument: Argument) -> Any:
    """Return what numba calls a type."""
    types = import_module("numba").types
    number = types.boolean if argument.dtype == "bool" else getattr(types, argument.dtype)
    if not argument.dimensions:
        return number
    return types.Array(number, argument.dimensions, "C", readonly=not argument.changed)


def _compile_inlined(names: dict[str, Any]) -> None:
    """Let a file's inlined functions be compiled with the kernel that calls them."""
    numba = import_module("numba")
    for name, value in names.items():
        if isinstance(value, FunctionType) and value in _INLINED:
            names[name] = numba.njit(nogil=True, error_model="numpy")(value)


def _machine_code(found: Any) -> machine_code.MachineCode | None:
    """Return what numba keeps of a function, None where this numba keeps it in another way."""
    try:
        (compiled,) = found.overloads.values()
        key = found._cache._index_key(compiled.signature.args, compiled.library.codegen)
        library, described, environment, *_ = found._cache._cache_file.load(key)
        return machine_code.MachineCode(
            content=library[2][0],
            entry=described.llvm_cpython_wrapper_name,
            environment=described.env_name,
            constants=tuple(environment.consts),
        )
    except Exception:  # these are no names that numba promises
        return None


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
