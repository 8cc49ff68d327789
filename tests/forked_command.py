"""Run `mocap-calib` in processes that are forked from one that has imported the libraries.

Importing them takes more than a second, which most tests of the command would spend again. A
command runs as it does from a shell: in a process, folder and environment of its own, with files
for its streams. How a command starts from nothing is tested by other tests.
"""

import importlib
import multiprocessing
import os
import pkgutil
import runpy
import subprocess
import sys
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest import mock

# what the commands import; the thread pools of these start when they are first used, not here
PROGRAM = ("mocap_calib", "mocap_calib_cli")
LIBRARIES = ("pytest", "rich.progress", "scipy.optimize", "torch")
NOT_PRELOADED = (
    "mocap_calib.compute.cluster",  # imports Dask, which few need
    "mocap_calib.io.formats.blender_scene",  # is for Blender's own Python
)
# the sums of linear algebra depend on the number of threads, which is read when numpy is imported
ONE_THREAD = dict.fromkeys(
    ("MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)
STREAMS = ("stdin", "stdout", "stderr")


def run_forked(
    arguments: list[str], *, stdin: str, cwd: Path | None
) -> subprocess.CompletedProcess[str]:
    """Run the command as `subprocess.run` does with `capture_output=True`."""
    with TemporaryDirectory() as name, mock.patch.dict(os.environ):
        streams = [Path(name) / stream for stream in STREAMS]
        streams[0].write_text(stdin, "utf-8")
        place, environment = str(cwd or Path.cwd()), dict(os.environ)
        given = (arguments, streams, place, environment)
        command = context().Process(target=_become_command, args=given)
        os.environ.update(ONE_THREAD)  # of the server, which the first command starts
        command.start()
        command.join()
        said = [stream.read_text("utf-8") if stream.exists() else "" for stream in streams[1:]]
    return subprocess.CompletedProcess(arguments, command.exitcode, *said)


@cache
def context() -> multiprocessing.context.ForkServerContext:
    """Return what starts processes, of a server that has the libraries and the program."""
    made = multiprocessing.get_context("forkserver")
    made.set_forkserver_preload([*LIBRARIES, *list_modules()])
    return made


def list_modules() -> list[str]:
    """Return the modules of the program, which are found by importing its packages."""
    found = [
        module.name
        for package in map(importlib.import_module, PROGRAM)
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
    ]
    return [each for each in found if each not in NOT_PRELOADED and not each.endswith("__main__")]


def _become_command(
    arguments: list[str], streams: list[Path], place: str, environment: dict[str, str]
) -> None:
    """Run the command in this process."""
    for number, path in enumerate(streams):
        flags = os.O_RDONLY if number == 0 else os.O_WRONLY | os.O_CREAT
        os.dup2(os.open(path, flags), number)
    sys.stdin = open(0)  # noqa: SIM115 - open to the end
    sys.stdout = open(1, "w")  # noqa: SIM115
    sys.stderr = open(2, "w", buffering=1)  # noqa: SIM115
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(place)
    sys.argv = ["mocap-calib", *arguments]
    runpy.run_module("mocap_calib_cli", run_name="__main__")  # ends the process
