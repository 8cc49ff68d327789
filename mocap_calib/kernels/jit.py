"""How kernels are compiled: by numba, which keeps machine code on disk.

A kernel is a function of loops over numbers, and the only definition of what it computes; the tests
hold it to plain numpy (`tests/oracles`). It is compiled for the types of its signature alone, when
its module is imported for the first time on a machine, and kept in `__pycache__` beside the module,
or in the folder that NUMBA_CACHE_DIR names (empty it when a file in `SHARED` changes). Kernels
set arrays in place, without Python's lock. Kept code is loaded only where nobody but this user and
root can have written it (`is_trusted`); PYTHONDONTWRITEBYTECODE and PYTHONPYCACHEPREFIX are of
Python's own code alone. Sums stay in the order in which they are written, and
results do not depend on the machine.
"""

import os
import stat
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.extending import register_jitable
from numpy.typing import NDArray

Function = TypeVar("Function", bound=Callable[..., Any])
Result = TypeVar("Result")

SHARED = ("jit", "lens", "pose_energy")  # others take functions and sizes of these files
# no wrapper for callers in C, of which there are none: it takes time to compile
_compile: Any = partial(numba.njit, nogil=True, error_model="numpy", no_cfunc_wrapper=True)


@cache
def is_trusted(folder: Path) -> bool:
    """Return whether a folder of machine code, and its files, belong to this user or to root alone.

    Machine code runs as it is found: a kernel whose code others may write is compiled anew in each
    process.
    """
    if not hasattr(os, "geteuid"):  # Windows
        return True
    for path in (folder, *folder.glob("*.nb[ic]")):
        with suppress(FileNotFoundError):  # another process has written it anew
            found = path.stat()
            if found.st_uid not in (0, os.geteuid()) or found.st_mode & stat.S_IWOTH:
                return False
    return True


def drop_stale_code(folder: Path) -> None:
    """Delete the machine code of kernels in a folder that is older than what they share.

    numba looks at the file of a kernel alone, not at those of the functions that it calls.
    """
    newest = max((folder / f"{name}.py").stat().st_mtime for name in SHARED)
    for index in (folder / "__pycache__").glob("*.nbi"):
        with suppress(OSError):  # another process was first, or the folder is not ours
            if index.stat().st_mtime < newest:
                index.unlink()


def _load_numba_without_blas() -> None:
    """Import numba without scipy's BLAS, which no kernel calls: it takes 0.2 s.

    Functions of others that multiply matrices import it when they are compiled.
    """
    name = "scipy.linalg.cython_blas"
    if name in sys.modules:
        return
    sys.modules[name] = None  # type: ignore[assignment] # Python's way to say that it is missing
    try:
        arraymath: Any = import_module("numba.np.arraymath")
        arraymath._HAVE_BLAS = True
    finally:
        del sys.modules[name]


drop_stale_code(Path(__file__).parent)
_load_numba_without_blas()


def kernel(*types: str) -> Callable[[Callable[..., Result]], Callable[..., Result]]:
    """Compile a function for arguments of types of numba, "f8[:,::1], i8" for example."""
    signature = f"({', '.join(types)},)"

    def compile_it(function: Callable[..., Result]) -> Callable[..., Result]:
        try:
            found = _compile(cache=True)(function)
            kept = is_trusted(Path(found.stats.cache_path))
        except RuntimeError:  # no folder to keep it in: each process compiles
            kept = False
        return cast(Callable[..., Result], _compile(signature, cache=kept)(function))

    return compile_it


def inlined(function: Function) -> Function:
    """Let kernels call a function, which stays one of Python beside."""
    found: Function = register_jitable(no_cfunc_wrapper=True)(function)
    return found


def copied(function: Function) -> Function:
    """Let kernels call a function, each place a copy of it; for inmost loops with few places."""
    found: Function = register_jitable(no_cfunc_wrapper=True, forceinline=True)(function)
    return found


def contiguous(*arrays: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """Return arrays in C order that can be written; those that are so already as they are."""
    return tuple(
        array if array.flags.c_contiguous and array.flags.writeable else array.copy()
        for array in arrays
    )


def compile_ahead() -> list[str]:
    """Compile all kernels, so that no run waits for them, and return their modules."""
    names = sorted(file.stem for file in Path(__file__).parent.glob("[!_]*.py"))
    for name in names:
        import_module(f"{__package__}.{name}")
    return names
