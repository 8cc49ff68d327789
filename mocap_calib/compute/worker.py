"""A process that computes for this one, and may end without it.

It is started with nothing of the program that asks (multiprocessing would import its main module again, which scripts and notebooks do not
expect), serves one question after the other, and ends with this process at the latest.
"""

import atexit
import contextlib
import os
import pickle
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from typing import Any, BinaryIO, ParamSpec, TypeVar, cast

from mocap_calib.errors import MocapCalibError

P = ParamSpec("P")
T = TypeVar("T")


class EndedError(Exception):
    """The process ended before it answered; says how."""


class Child:
    """The other process; started when it is first asked, and anew after it has ended."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._process: subprocess.Popen[bytes] | None = None

    def ask(self, call: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """What the call returns or raises. `call`: a function of a module; it, its arguments and its answer can be pickled. Raises EndedError."""
        return self.ask_within(float("inf"), 0, call, *args, **kwargs)

    def ask_within(
        self, seconds: float, memory: int, call: Callable[P, T], *args: P.args, **kwargs: P.kwargs
    ) -> T:
        """The same, held to so many seconds of computing (20 times as many by the clock) and bytes of memory; to the clock alone on Windows."""
        with self._lock:
            if self._process is not None and self._process.poll() is not None:
                self.end()  # while nobody asked: not for what is asked now
            if self._process is None:
                self._process = _start()
                atexit.register(self.end)
            process = self._process
            clock = threading.Timer(20 * min(seconds, threading.TIMEOUT_MAX / 20), process.kill)
            clock.daemon = True
            clock.start()
            try:
                pickle.dump(
                    (seconds, memory, call, args, kwargs), cast(BinaryIO, process.stdin), protocol=5
                )
                cast(BinaryIO, process.stdin).flush()
                answer = pickle.load(
                    cast(BinaryIO, process.stdout)
                )  # of our own process: nobody else's pickle
            except (EOFError, OSError, pickle.UnpicklingError):
                raise EndedError(self.end()) from None
            except (
                BaseException
            ):  # Ctrl-C: what it answers later would be taken for the next answer
                process.kill()
                self.end()
                raise
            finally:
                clock.cancel()
        if isinstance(answer, Exception):
            raise answer
        return cast(T, answer)

    def end(self) -> str:
        """Ends the process, and says how it ended."""
        with self._lock:
            process, self._process = self._process, None
            atexit.unregister(self.end)
            if process is None:
                return "it was not there"
            for pipe in (process.stdin, process.stdout):
                with contextlib.suppress(OSError):
                    cast(BinaryIO, pipe).close()
            code = process.wait()
            return signal.Signals(-code).name if code < 0 else f"status {code}"


def _start() -> "subprocess.Popen[bytes]":
    """`-P`: no module of the folder one stands in. One thread of BLAS and OpenMP, as everywhere here (parallel.py)."""
    surroundings = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
    }
    return subprocess.Popen(
        [sys.executable, "-P", "-m", __name__],
        env=surroundings,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )


def _serve(questions: BinaryIO, answers: BinaryIO) -> None:
    """Answers one question after the other, until nobody asks."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the one who asks
    while True:
        try:
            seconds, memory, call, args, kwargs = pickle.load(questions)
        except EOFError:
            return
        answer: Any
        try:
            with _limited(seconds, memory):
                answer = call(*args, **kwargs)
        except Exception as error:  # raised where it was asked
            if not isinstance(error, MocapCalibError):
                error.add_note(traceback.format_exc())
            answer = error
        pickle.dump(answer, answers, protocol=5)
        answers.flush()


@contextlib.contextmanager
def _limited(seconds: float, memory: int) -> Iterator[None]:
    """Holds this process to so much more computing time, and to so much memory."""
    if sys.platform == "win32" or seconds == float("inf"):
        yield
        return
    import resource  # noqa: PLC0415 - not on Windows

    used = resource.getrusage(resource.RUSAGE_SELF)
    limits = {
        resource.RLIMIT_CORE: 0,
        resource.RLIMIT_CPU: int(used.ru_utime + used.ru_stime + seconds) + 1,
        resource.RLIMIT_DATA: memory,
    }
    before = {kind: resource.getrlimit(kind) for kind in limits}
    for kind, most in limits.items():
        hard = before[kind][1]
        resource.setrlimit(
            kind, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard)
        )
    try:
        yield
    finally:
        for kind, limit in before.items():
            resource.setrlimit(kind, limit)


if __name__ == "__main__":
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no answer
    _serve(sys.stdin.buffer, output)
