"""Look at the machine, the installation and the models, and calibrate a small recording with truth.

What can be compiled is compiled first, and kept: no run waits for it later.

Nothing is sent anywhere, and no network is needed. Paths begin with ~ where they lie in the home
directory.
"""

import importlib
import os
import platform
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_info

from mocap_calib.compute import BLAS_THREADS, identify_program
from mocap_calib.compute.parallel import thread_count
from mocap_calib.config import Config
from mocap_calib.errors import MocapCalibError
from mocap_calib.front import from_keypoints
from mocap_calib.kernels.jit import compile_ahead
from mocap_calib.lift.lifter import digest, load_lifter
from mocap_calib.pipeline import calibrate
from mocap_calib.recording.joints import SHIPPED
from mocap_calib.synthetic import simulate
from mocap_calib.synthetic.config import SimulateConfig
from mocap_calib.training import describe_devices
from mocap_calib.verdict.evaluation import evaluate


@dataclass(frozen=True)
class DoctorConfig:
    """The self-test: a simulated recording, and how far the result may be from the truth.

    least_disk_gb: free on the disk, below which that is said.
    """

    cameras: int = 3
    people: int = 2
    frames: int = 40
    most_error_deg: float = 0.5  # measured 0.23
    least_disk_gb: float = 1.0


# name of a package -> of what is imported
NEEDED = {
    "numpy": "numpy",
    "numba": "numba",
    "scipy": "scipy",
    "torch": "torch",
    "opencv-python-headless": "cv2",
    "pycolmap": "pycolmap",
    "h5py": "h5py",
    "h5netcdf": "h5netcdf",
    "c3d": "c3d",
    "safetensors": "safetensors",
    "PyYAML": "yaml",
    "tomli-w": "tomli_w",
    "threadpoolctl": "threadpoolctl",
    "click": "click",
    "rich": "rich",
}
OPTIONAL = {
    "distributed": "distributed",
    "pynwb": "pynwb",
    "ndx-pose": "ndx_pose",
    "rerun-sdk": "rerun",
    "xarray": "xarray",
}
_THREADS = (*BLAS_THREADS, "OMP_NUM_THREADS")  # variables that say how many are wanted
_GIGABYTE = 1e9


def examine(*, self_test: bool = True, config: DoctorConfig = DoctorConfig()) -> dict[str, Any]:
    """Return what was found, for JSON; `findings` has a line for each thing that is wrong.

    self_test: also calibrate a small recording, which takes some seconds.
    """
    compile_ahead()
    packages = {name: _look_at(name, module) for name, module in NEEDED.items()}
    extras = {name: _look_at(name, module) for name, module in OPTIONAL.items()}
    found: dict[str, Any] = {
        "program": {
            "mocap-calib": identify_program(),
            "python": platform.python_version(),
            "executable": _without_home(sys.executable),
            "package": _without_home(str(Path(__file__).parent)),
        },
        "computer": _describe_computer(),
        "packages": packages,
        "extras": {name: each for name, each in extras.items() if each["version"]},
        "libraries": _describe_libraries(),
        "environment": {name: os.environ[name] for name in _THREADS if name in os.environ},
        "devices": describe_devices(),
        "models": {name: _look_at_model(name) for name in SHIPPED},
        "self_test": _calibrate_known_scene(config) if self_test else None,
    }
    found["findings"] = list(_findings(found, config))
    return found


def _describe_computer() -> dict[str, Any]:
    """Return what the machine is: bytes in gigabytes, None where nobody says."""
    free = shutil.disk_usage(Path.cwd()).free
    return {
        "system": platform.platform(),
        "processor": platform.machine(),
        "processors": os.cpu_count(),
        "threads": thread_count(),
        "memory_gb": _memory("SC_PHYS_PAGES"),
        "memory_free_gb": _memory("SC_AVPHYS_PAGES"),
        "disk_free_gb": round(free / _GIGABYTE, 1),
    }


def _memory(pages: str) -> float | None:
    """Return the size of so many pages of memory in gigabytes, None where the system does not say.

    pages: a name of POSIX's sysconf, which Windows lacks.
    """
    try:
        return round(os.sysconf(pages) * os.sysconf("SC_PAGE_SIZE") / _GIGABYTE, 1)
    except (AttributeError, ValueError, OSError):
        return None


def _describe_libraries() -> list[dict[str, Any]]:
    """Return the libraries of linear algebra that are loaded, and their numbers of threads."""
    return [
        {
            "library": each["internal_api"],
            "version": each["version"],
            "threads": each["num_threads"],
            "file": Path(each["filepath"]).name,
        }
        for each in threadpool_info()
    ]


def _look_at(package: str, module: str) -> dict[str, Any]:
    """Return the version of a package, and the error where it cannot be imported."""
    try:
        version = metadata.version(package)
    except metadata.PackageNotFoundError:
        version = None
    return {"version": version, "error": _error_of(lambda: importlib.import_module(module))}


def _look_at_model(name: str) -> dict[str, Any]:
    """Return the SHA-256 of a shipped model's weights, and the error where they do not load."""
    hashes: list[str] = []
    error = _error_of(lambda: hashes.append(digest(name))) or _error_of(lambda: load_lifter(name))
    return {"sha256": hashes[0] if hashes else None, "error": error}


def _error_of(call: Callable[[], object]) -> str | None:
    """Return what a call raises in one line, None where it raises nothing."""
    try:
        call()
    except Exception as error:  # a broken library may raise anything
        return _without_home(" ".join(f"{type(error).__name__}: {error}".split()))
    return None


def _calibrate_known_scene(config: DoctorConfig) -> dict[str, Any]:
    """Calibrate a simulated recording, and return how far the result is from the truth."""
    start = time.monotonic()
    scene = simulate(
        SimulateConfig(cameras=config.cameras, people=config.people, frames=config.frames)
    )
    try:
        recording = from_keypoints(scene.files, scene.rig.cameras)
        group = calibrate(recording, config=Config(), seed=0).groups[0]
        error = evaluate(group.rig, scene.rig).rotation_error
    except MocapCalibError as refused:
        return {"error": str(refused), "seconds": round(time.monotonic() - start, 1)}
    return {
        "error": None,
        "verdict": group.verdict,
        "rotation_error_deg": float(np.degrees(np.max(error))),
        "individuals": group.matches.individuals,
        "seconds": round(time.monotonic() - start, 1),
    }


def _findings(found: dict[str, Any], config: DoctorConfig) -> Iterator[str]:
    """Yield what is wrong, with the remedy, a line each."""
    for name, package in (found["packages"] | found["extras"]).items():
        if package["error"]:
            yield f"{name} cannot be imported ({package['error']}); install it again"
    for name, model in found["models"].items():
        if model["error"]:
            yield f"the model {name} does not load ({model['error']}); install mocap-calib again"
    if found["computer"]["disk_free_gb"] < config.least_disk_gb:
        yield f"{found['computer']['disk_free_gb']} GB are free on this disk; make room"
    if found["self_test"] is not None:
        yield from _judge_self_test(found["self_test"], config)


def _judge_self_test(test: dict[str, Any], config: DoctorConfig) -> Iterator[str]:
    """Yield what is wrong with the result of the recording whose truth is known."""
    wrongly = "this installation calculates wrongly; report it"
    if test["error"]:
        yield f"the self-test was refused ({test['error']}); report it"
    elif not test["rotation_error_deg"] < config.most_error_deg:
        found, most = test["rotation_error_deg"], config.most_error_deg
        yield f"the self-test is off by {found:.2f} deg, expected less than {most}: {wrongly}"
    elif test["individuals"] != config.people:
        found = test["individuals"]
        yield f"the self-test found {found} people, expected {config.people}: {wrongly}"


def _without_home(text: str) -> str:
    """Return a text in which the home directory is ~."""
    home = str(Path.home())
    return text if home in ("/", "") else text.replace(home, "~")
