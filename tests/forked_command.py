"""Run `mocap-calib` in processes that are forked from one that has imported the libraries.

Importing them takes more than a second, which most tests of the command would spend again. A
command runs as it does from a shell: in a process, folder and environment of its own, with pipes
for its streams. How a command starts from nothing is tested by other tests.
"""

import importlib
import json
import os
import pkgutil
import runpy
import socket
import subprocess
import sys
import traceback
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NoReturn

# what the commands import; the thread pools of these start when they are first used, not here
PROGRAM = ("mocap_calib", "mocap_calib_cli")
LIBRARIES = ("rich.progress", "scipy.optimize", "torch")
NOT_PRELOADED = (
    "mocap_calib.compute.cluster",  # imports Dask, which few need
    "mocap_calib.io.formats.blender_scene",  # is for Blender's own Python
)
# the sums of linear algebra depend on the number of threads, which is read when numpy is imported
ONE_THREAD = dict.fromkeys(
    ("MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)


class ForkedCommand:
    """A process that waits for commands, and forks itself for each of them."""

    def __init__(self) -> None:
        self.connection, theirs = socket.socketpair()
        with theirs:
            self.server = subprocess.Popen(
                [sys.executable, __file__, str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                env=os.environ | ONE_THREAD,
            )

    def run(
        self, arguments: list[str], *, stdin: str, cwd: Path | None
    ) -> subprocess.CompletedProcess[str]:
        """Run the command as `subprocess.run` does with `capture_output=True`."""
        request = {
            "arguments": arguments,
            "cwd": str(cwd or Path.cwd()),
            "environment": dict(os.environ),
        }
        (input_read, input_write), (stdout_read, stdout_write), (stderr_read, stderr_write) = (
            os.pipe() for _ in range(3)
        )
        theirs = [input_read, stdout_write, stderr_write]
        socket.send_fds(self.connection, [_framed(request)], theirs)
        for descriptor in theirs:
            os.close(descriptor)
        with ThreadPoolExecutor(3) as pool:
            pool.submit(_write, input_write, stdin)
            stdout = pool.submit(_read, stdout_read)
            stderr = pool.submit(_read, stderr_read)
        status = int.from_bytes(self.connection.recv(4), "big", signed=True)
        return subprocess.CompletedProcess(arguments, status, stdout.result(), stderr.result())

    def close(self) -> None:
        """End the process that waits."""
        self.connection.close()
        self.server.wait()


def _framed(request: dict) -> bytes:
    """Return the request with its length in front."""
    content = json.dumps(request).encode()
    return len(content).to_bytes(4, "big") + content


def _read(descriptor: int) -> str:
    with open(descriptor, encoding="utf-8") as stream:
        return stream.read()


def _write(descriptor: int, text: str) -> None:
    try:
        with open(descriptor, "w", encoding="utf-8") as stream:
            stream.write(text)
    except BrokenPipeError:  # the command has not read its input
        pass


def list_modules() -> Iterator[str]:
    """Yield the modules of the program, which are found by importing its packages."""
    for package in map(importlib.import_module, PROGRAM):
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if found.name not in NOT_PRELOADED and not found.name.endswith("__main__"):
                yield found.name


def serve(connection: socket.socket) -> None:
    """Fork a process for each command that comes through the connection."""
    for module in (*LIBRARIES, *list_modules()):
        importlib.import_module(module)
    while True:
        head, descriptors, _, _ = socket.recv_fds(connection, 4, 3)
        if not head:
            return
        request = json.loads(_receive(connection, int.from_bytes(head, "big")))
        child = os.fork()
        if child == 0:
            connection.close()
            _become_command(request, descriptors)
        for descriptor in descriptors:
            os.close(descriptor)
        _, status = os.waitpid(child, 0)
        code = os.waitstatus_to_exitcode(status)
        connection.sendall(code.to_bytes(4, "big", signed=True))


def _receive(connection: socket.socket, length: int) -> bytes:
    content = b""
    while len(content) < length:
        content += connection.recv(length - len(content))
    return content


def _become_command(request: dict, descriptors: list[int]) -> NoReturn:
    """Run the command in this process, and end it."""
    for stream, descriptor in enumerate(descriptors):
        os.dup2(descriptor, stream)
        os.close(descriptor)
    # those of the process that waits have seen another kind of file
    sys.stdin = open(0)  # noqa: SIM115 - open to the end
    sys.stdout = open(1, "w")  # noqa: SIM115
    sys.stderr = open(2, "w", buffering=1)  # noqa: SIM115
    os.environ.clear()
    os.environ.update(request["environment"])
    os.chdir(request["cwd"])
    sys.argv = ["mocap-calib", *request["arguments"]]
    try:
        runpy.run_module("mocap_calib_cli", run_name="__main__")  # ends the process
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
    os._exit(1)


if __name__ == "__main__":
    serve(socket.socket(fileno=int(sys.argv[1])))
