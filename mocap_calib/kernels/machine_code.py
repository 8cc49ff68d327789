"""Machine code of kernels, kept on disk beside their modules.

numba keeps what it compiles, but takes 0.7 s of each run to be imported and to load its kernels.
The machine code alone is loaded in 0.1 s, by llvmlite and three extension modules of numba that
need none of its Python: what its arrays, its errors and its functions are.

Nothing here fails: where anything is missing or other than expected, nothing is found, and
`kernels.jit` asks numba.
"""

import ctypes
import hashlib
import os
import pickle
import sys
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import numpy as np

_ENGINES: list[Any] = []
_LINKED: Counter[str] = Counter()  # how many of the engines hold code of a name
_FITS = Path(__file__).parent / "__pycache__" / f"numba.{sys.implementation.cache_tag}.fits"


@dataclass(frozen=True)
class MachineCode:
    """What numba made of a function for arguments of given types.

    content: an object file. entry: the name in it of the function that takes Python's objects.
    environment, constants: the name in it of what holds Python's objects for it, and these.
    """

    content: bytes
    entry: str
    environment: str
    constants: tuple[Any, ...]


def is_kept_here() -> bool:
    """Return whether the numba that is installed has compiled kernels on this machine before."""
    return bool(_machine()) and _read(_FITS) == _machine().encode()


def load(function: FunctionType) -> Callable[..., Any] | None:
    """Return a function as it was compiled, None where that is not kept or no longer right."""
    found = _read(_place(function))
    digest = _digest(function).encode()
    if not found or not digest or not found.startswith(digest):
        return None
    try:
        return _link(function.__name__, pickle.loads(found[len(digest) :]))
    except Exception:  # a file that is cut off, another llvmlite: numba is asked
        return None


def keep(function: FunctionType, code: MachineCode) -> None:
    """Keep the machine code of a function, where its folder can be written."""
    if digest := _digest(function).encode():
        _write(_place(function), digest + pickle.dumps(code))
        if not is_kept_here():
            _write(_FITS, _machine().encode())


def _place(function: FunctionType) -> Path:
    """Return the file of a function."""
    source = Path(function.__code__.co_filename)
    name = f"{source.stem}.{function.__name__}.{sys.implementation.cache_tag}.machine"
    return source.parent / "__pycache__" / name


def _digest(function: FunctionType) -> str:
    """Return the SHA-256 of all that machine code follows from; empty where that is not known."""
    source = _read(Path(function.__code__.co_filename))
    if not source or not _machine():
        return ""
    return hashlib.sha256(_machine().encode() + source).hexdigest()


@cache
def _machine() -> str:
    """Return the SHA-256 of processor, versions and settings; empty where there is no numba."""
    try:
        binding = import_module("llvmlite.binding")
        parts = [
            sys.version,
            np.__version__,
            sys.modules["llvmlite"].__version__,
            binding.get_process_triple(),
            binding.get_host_cpu_name(),
            binding.get_host_cpu_features().flatten(),
            (_folder_of_numba() / "_version.py").read_text("utf-8"),
            (Path(__file__).with_name("jit.py")).read_text("utf-8"),
            *(f"{name}={value}" for name, value in sorted(os.environ.items()) if "NUMBA_" in name),
        ]
    except Exception:  # numba, llvmlite or a file of theirs is missing
        return ""
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def _folder_of_numba() -> Path:
    """Return the folder of numba without importing it. Raises ImportError."""
    found = find_spec("numba")
    if found is None or found.origin is None:
        raise ImportError("numba")
    return Path(found.origin).parent


def _extension(name: str) -> ModuleType:
    """Return an extension module of numba without the packages around it."""
    full = f"numba.{name}"
    if full in sys.modules:
        return sys.modules[full]
    place = _folder_of_numba().joinpath(*name.split("."))
    files = (place.with_name(place.name + suffix) for suffix in EXTENSION_SUFFIXES)
    spec = spec_from_file_location(full, next(file for file in files if file.is_file()))
    if spec is None or spec.loader is None:
        raise ImportError(full)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@cache
def _make_ready() -> ModuleType:
    """Tell LLVM where the functions are that machine code calls; return who makes functions."""
    binding = import_module("llvmlite.binding")
    for name, address in _extension("core.runtime._nrt_python").c_helpers.items():
        binding.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)
    for name, address in _extension("_helperlib").c_helpers.items():
        binding.add_symbol(f"numba_{name}", address)
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return _extension("_dynfunc")


def _engine_without(name: str) -> Any:
    """Return an engine of LLVM that holds no code of this name yet, and shall hold it from now on.

    One engine for each kernel would take a millisecond more. There are two where the file of a
    kernel was changed while the program runs.
    """
    if _LINKED[name] == len(_ENGINES):
        binding = import_module("llvmlite.binding")
        machine = binding.Target.from_default_triple().create_target_machine(
            codemodel="jitdefault", jit=True
        )
        _ENGINES.append(binding.create_mcjit_compiler(binding.parse_assembly(""), machine))
    _LINKED[name] += 1
    return _ENGINES[_LINKED[name] - 1]


def _link(name: str, code: MachineCode) -> Callable[..., Any]:
    """Make machine code a function of Python."""
    binding = import_module("llvmlite.binding")
    dynfunc = _make_ready()
    engine = _engine_without(code.entry)
    engine.add_object_file(binding.ObjectFileRef.from_data(code.content))
    engine.finalize_object()
    entry = engine.get_function_address(code.entry)
    holder = engine.get_global_value_address(code.environment)
    if not entry or not holder:
        raise LookupError(name)
    environment = dynfunc.Environment({})
    environment.consts.extend(code.constants)
    ctypes.c_void_p.from_address(holder).value = id(environment)
    function: Callable[..., Any] = dynfunc.make_function(
        sys.modules[__name__], name, "", entry, environment, (engine, environment)
    )
    return function


def _read(path: Path) -> bytes:
    """Return the content of a file, nothing where it cannot be read."""
    try:
        return path.read_bytes()
    except OSError:
        return b""


def _write(path: Path, content: bytes) -> None:
    """Put content into place in one step, where that can be."""
    work = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(exist_ok=True)
        work.write_bytes(content)
        work.replace(path)
    except OSError:
        with suppress(OSError):
            work.unlink()
