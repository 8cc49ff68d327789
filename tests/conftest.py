"""What several test files share: the command, and one run of it on a small recording."""

import importlib.util
import os
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest
import torch
from forked_command import run_forked
from threadpoolctl import threadpool_limits

import mocap_calib as mc
from mocap_calib.io.crash_guard import end_calls

# as the commands do: further threads of the libraries only spin when the machine has other work
torch.set_num_threads(1)
threadpool_limits(1)

# a shell starts a job in the background with SIGINT ignored, which the commands would inherit
signal.signal(signal.SIGINT, signal.default_int_handler)

assert mc.CameraRig.project  # the front door binds what rooms above `results` do to records
TOOL = Path(sys.executable).with_name("mocap-calib")
Run = Callable[..., subprocess.CompletedProcess[str]]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the files with the most slow tests first: workers end together if little is left last."""
    slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
    items.sort(key=lambda item: -slow[item.path])


def load_script(path: Path) -> ModuleType:
    """Import a script that is in no package, and may import others beside it."""
    sys.path.insert(0, str(path.parent))
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(path.parent))
    return module


@pytest.fixture(scope="module", autouse=True)
def _kept_coverage() -> Iterator[None]:
    """End the process that reads HDF5 with each file: what damage ends does not say what it ran."""
    yield
    if "COVERAGE_RUN" in os.environ:
        end_calls()


@pytest.fixture(scope="session")
def tool() -> Run:
    """Runs the command in a process of its own."""

    def run(
        *arguments: object, stdin: str = "", cwd: Path | None = None
    ) -> subprocess.CompletedProcess[str]:
        texts = [str(argument) for argument in arguments]
        if hasattr(os, "fork"):
            return run_forked(texts, stdin=stdin, cwd=cwd)
        return subprocess.run(
            [TOOL, *texts],
            input=stdin,
            capture_output=True,
            encoding="utf-8",
            check=False,
            cwd=cwd,
        )

    return run


@pytest.fixture(scope="session")
def small(tool, tmp_path_factory) -> Path:
    """A recording with truth: 3 cameras, 2 people, 30 frames."""
    folder = tmp_path_factory.mktemp("small") / "scene"
    size = ("--cameras", 3, "--people", 2, "--frames", 30)
    assert tool("simulate", *size, "-o", folder, "-q").returncode == 0
    return folder


@pytest.fixture(scope="session")
def done(small, tool, tmp_path_factory) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """The folder that `run --json` wrote, and what it said."""
    out = tmp_path_factory.mktemp("done") / "out"
    return out, tool(
        "run", small / "keypoints", "--cameras", small / "intrinsics.toml", "-o", out, "--json"
    )
