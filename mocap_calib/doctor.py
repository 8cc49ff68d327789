"""Check the machine, the installation and the models, and calibrate a simulated recording.

Only the standard library is imported at the top: a broken package is a finding like any other.
Kernels are compiled first, and kept: no run waits for them later. Nothing is sent anywhere, and
no network is needed. The home directory is written as ~.
"""

import os
import platform
import re
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from functools import partial
from importlib import import_module, metadata
from pathlib import Path
from traceback import walk_tb
from typing import Any, TypeVar

Value = TypeVar("Value")

_PROGRAM = "mocap-calib"
_REQUIREMENT = re.compile(r"([\w.-]+)(?:.*\bextra == \"([\w.-]+)\")?")  # PEP 508: name, extra
_LEAST_DISK_GB = 1.0
_GIGABYTE = 1e9
# the self-test: a simulated recording, and how far the result may be from the truth
_CAMERAS, _PEOPLE, _FRAMES = 3, 2, 40
_MOST_ERROR_DEG = 0.5  # measured 0.23


def examine(*, self_test: bool = True) -> dict[str, Any]:
    """Return what was found, for JSON; `findings` has a line for each fault, with its remedy.

    What needs packages is checked where none of them is broken, and is missing otherwise.

    self_test: also calibrate a small recording, which takes some seconds.
    """
    findings: list[str] = []
    with redirect_stdout(sys.stderr):  # OpenCV prints where numpy is broken
        found: dict[str, Any] = {"computer": _describe_computer(), **_import_packages(findings)}
    checks: dict[str, Callable[[], Any]] = {
        "libraries": partial(_describe_libraries, findings),
        "devices": _describe_devices,
        "models": partial(_load_models, findings),
        "self_test": partial(_calibrate_known_scene, findings) if self_test else lambda: None,
    }
    for name, check in checks.items() if not findings else ():
        found[name] = _attempt(check, findings, f"{name.replace('_', '-')}: the check failed")
    if found["computer"]["disk_free_gb"] < _LEAST_DISK_GB:
        findings.append(f"{found['computer']['disk_free_gb']} GB are free on this disk; make room")
    return found | {"findings": findings}


def _attempt(call: Callable[[], Value], findings: list[str], fault: str) -> Value | None:
    """Return what a call returns; where it raises anything, add a finding and return None."""
    try:
        return call()
    except Exception as error:  # a broken library may raise anything
        findings.append(_describe_fault(fault, error))
        return None


def _describe_fault(fault: str, error: Exception) -> str:
    reason = " ".join(f"{type(error).__name__}: {error}".split())
    return f"{fault} ({_without_home(reason)}); install it again"


def _import_packages(findings: list[str]) -> dict[str, dict[str, str | None]]:
    """Import the required packages, and where they are sound the extras that are installed.

    Returns their versions: {"packages": {name: version}, "extras": {name: version}}.
    """
    required = _attempt(_requirements, findings, f"{_PROGRAM} is not installed") or {}
    package_of = {
        module: _normalise(packages[0])
        for module, packages in metadata.packages_distributions().items()
        if module.isidentifier() and not module.startswith("_")
    }
    versions: dict[str, dict[str, str | None]] = {"packages": {}, "extras": {}}
    faults: dict[str, str] = {}
    for name, extra in required.items():
        modules = [module for module, package in package_of.items() if package == name]
        if extra and (faults or not modules):
            continue
        version = _attempt(partial(metadata.version, name), findings, f"{name} is not installed")
        versions["extras" if extra else "packages"][name] = version
        for module in modules:
            try:
                import_module(module)
            except Exception as error:  # a broken package may raise anything
                origins = [
                    package_of[each] for each in _modules_behind(error) if each in package_of
                ]
                broken = next((each for each in reversed(origins) if each in required), name)
                faults.setdefault(broken, _describe_fault(f"{broken} cannot be imported", error))
    findings += faults.values()
    return versions


def _requirements() -> dict[str, str]:
    """Return {name: extra} of what users of this program may have, "" for what they must have."""
    found = (_REQUIREMENT.findall(each)[0] for each in metadata.requires(_PROGRAM) or ())
    return {_normalise(name): extra for name, extra in found if extra != "test"}


def _modules_behind(error: BaseException | None) -> Iterator[str]:
    """Yield the top-level modules that an error came through; the last one raised it."""
    while error is not None:
        for frame, _ in walk_tb(error.__traceback__):
            yield frame.f_globals.get("__name__", "").partition(".")[0]
        error = error.__context__


def _normalise(name: str) -> str:
    """Return the name of a package in the one spelling of PEP 503."""
    return re.sub(r"[-_.]+", "-", name).lower()


def _describe_computer() -> dict[str, Any]:
    """Return what the machine is: bytes in gigabytes, None where the system does not report it."""
    from mocap_calib.compute import BLAS_THREADS, identify_program

    threads = (*BLAS_THREADS, "OMP_NUM_THREADS")
    return {
        _PROGRAM: identify_program(),
        "python": platform.python_version(),
        "executable": _without_home(sys.executable),
        "package": _without_home(str(Path(__file__).parent)),
        "system": platform.platform(),
        "processor": platform.machine(),
        "processors": os.cpu_count(),
        "memory_gb": _memory("SC_PHYS_PAGES"),
        "memory_free_gb": _memory("SC_AVPHYS_PAGES"),
        "disk_free_gb": round(shutil.disk_usage(Path.cwd()).free / _GIGABYTE, 1),
        **{name: os.environ[name] for name in threads if name in os.environ},
    }


def _memory(pages: str) -> float | None:
    """Return the size of memory in gigabytes, of a number of pages that POSIX's sysconf knows."""
    try:
        return round(os.sysconf(pages) * os.sysconf("SC_PAGE_SIZE") / _GIGABYTE, 1)
    except (AttributeError, ValueError, OSError):  # Windows has no sysconf
        return None


def _describe_libraries(findings: list[str]) -> dict[str, str]:
    """Compile the kernels, and return the libraries of linear algebra that were loaded for them."""
    from threadpoolctl import threadpool_info

    from mocap_calib.kernels.jit import compile_ahead, is_trusted

    compile_ahead()
    folder = Path(__file__).parent / "kernels/__pycache__"
    if not is_trusted(folder):
        findings.append(
            f"{_without_home(str(folder))}: others can write to it, so that kernels are compiled "
            "in each run; run chmod -R o-w on it, or remove it"
        )
    return {
        Path(each["filepath"]).name: f"{each['internal_api']} {each['version'] or ''}, "
        f"{each['num_threads']} threads"
        for each in threadpool_info()
    }


def _describe_devices() -> dict[str, Any]:
    """Return the number of threads of a run, and the GPUs that torch can use."""
    from mocap_calib.compute.parallel import thread_count
    from mocap_calib.training import describe_devices

    return {"threads": thread_count(), **describe_devices()}


def _load_models(findings: list[str]) -> dict[str, str | None]:
    """Load the shipped models, and return the SHA-256 of their weights."""
    from mocap_calib.lift.lifter import digest, load_lifter
    from mocap_calib.recording.joints import SHIPPED

    hashes: dict[str, str | None] = {}
    for name in SHIPPED:
        fault = f"the model {name} does not load"
        loaded = _attempt(partial(load_lifter, name), findings, fault)
        hashes[name] = digest(name) if loaded else None
    return hashes


def _calibrate_known_scene(findings: list[str]) -> dict[str, Any]:
    """Calibrate a simulated recording, and compare the result with the truth."""
    import numpy as np

    import mocap_calib as mc

    start = time.monotonic()
    scene = mc.simulate(mc.SimulateConfig(cameras=_CAMERAS, people=_PEOPLE, frames=_FRAMES))
    recording = mc.Recording.from_keypoints(scene.files, scene.rig.cameras)
    group = mc.calibrate(recording, seed=0).groups[0]
    error_deg = float(np.degrees(np.max(mc.evaluate(group.rig, scene.rig).rotation_error)))
    people = group.matches.individuals
    if not (error_deg < _MOST_ERROR_DEG and people == _PEOPLE):
        findings.append(
            f"self-test: expected less than {_MOST_ERROR_DEG} deg from the truth and {_PEOPLE} "
            f"people, found {error_deg:.2f} deg and {people}: this installation calculates "
            "wrongly; report it"
        )
    return {
        "verdict": group.verdict,
        "rotation_error_deg": error_deg,
        "individuals": people,
        "seconds": round(time.monotonic() - start, 1),
    }


def _without_home(text: str) -> str:
    """Return a text in which the home directory is ~."""
    home = str(Path.home())
    return text if home in ("/", "") else text.replace(home, "~")
