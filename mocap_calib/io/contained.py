"""HDF5 is parsed in a process of its own, since one damaged file in some hundred ends libhdf5 2.0.0, or never lets it come back.

The process starts with the first such file (0.3 s) and serves until this one ends, or a large file's memory is to be given back. What
it does not survive becomes a FormatError. Measured in docs/formats.md, "Fuzzing".
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
from functools import cache
from typing import Any, BinaryIO, ParamSpec, TypeVar, cast

from mocap_calib.errors import MocapCalibError
from mocap_calib.io.reading import malformed

HDF5 = b"\x89HDF\r\n\x1a\n"
_LARGE = 10_000_000  # bytes
P = ParamSpec("P")
T = TypeVar("T")


class _DiedError(Exception):
    """The process did not survive; says how it ended."""


def contained(content: bytes, source: str, parse: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """`parse(*args, **kwargs)`, in the other process where `content` is HDF5.

    parse: a function of a module, whose arguments, result and errors can be pickled. Raises what it raises, and FormatError
    where the file ends the process, or takes more than 2 to 3 s of computing and 10 s per MB (20 times that by the clock), or
    more than 1 GB and 1100 times its size (deflate packs no more).
    """
    if not content.startswith(HDF5):
        return parse(*args, **kwargs)
    worker = _worker(os.getpid())
    try:
        answer = worker.ask(2 + len(content) / 1e5, 1_000_000_000 + 1100 * len(content), parse, args, kwargs)
    except _DiedError as end:
        raise malformed(source, "a whole HDF5 file", f"damage that HDF5 does not survive ({end})", "copy or export it again") from None
    if len(content) > _LARGE:
        worker.end()
    if isinstance(answer, Exception):
        raise answer
    return cast(T, answer)


class _Worker:
    """The other process; started when it is asked, and anew after it has ended."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._process: subprocess.Popen[bytes] | None = None
        atexit.register(self.end)

    def ask(self, seconds: float, memory: int, *call: Any) -> Any:
        """What the call (function, args, kwargs) returns or raises. Raises _DiedError."""
        with self._lock:
            process = self._process = self._process or _start()
            clock = threading.Timer(20 * seconds, process.kill)  # for what waits, and where the system counts no computing time
            clock.start()
            try:
                pickle.dump((seconds, memory, *call), cast(BinaryIO, process.stdin), protocol=5)
                cast(BinaryIO, process.stdin).flush()
                return pickle.load(cast(BinaryIO, process.stdout))  # of our own process: nobody else's pickle
            except (EOFError, OSError, pickle.UnpicklingError):
                raise _DiedError(self.end()) from None
            except BaseException:  # Ctrl-C: what it answers later would be taken for the next answer
                process.kill()
                self.end()
                raise
            finally:
                clock.cancel()

    def end(self) -> str:
        """Ends the process, and says how it ended."""
        with self._lock:
            process, self._process = self._process, None
            if process is None:
                return "it was not there"
            for pipe in (process.stdin, process.stdout):
                with contextlib.suppress(OSError):
                    cast(BinaryIO, pipe).close()
            code = process.wait()
            return signal.Signals(-code).name if code < 0 else f"status {code}"


@cache
def _worker(pid: int) -> _Worker:  # noqa: ARG001 - a process that was forked off has one of its own
    return _Worker()


def _start() -> "subprocess.Popen[bytes]":
    """`-P`: no module of the folder one stands in. One thread of BLAS: more take memory and time, and have nothing to do."""
    surroundings = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path), "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.Popen([sys.executable, "-P", "-m", __name__], env=surroundings, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)


def _serve(questions: BinaryIO, answers: BinaryIO) -> None:
    """Answers one question after the other, until nobody asks."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the one who asks
    while True:
        try:
            seconds, memory, parse, args, kwargs = pickle.load(questions)
        except EOFError:
            return
        answer: Any
        try:
            with _limited(seconds, memory):
                answer = parse(*args, **kwargs)
        except Exception as error:
            if not isinstance(error, MocapCalibError):
                error.add_note(traceback.format_exc())
            answer = error
        pickle.dump(answer, answers, protocol=5)
        answers.flush()


@contextlib.contextmanager
def _limited(seconds: float, memory: int) -> Iterator[None]:
    """Holds this process to so much more computing time, and to so much memory."""
    try:
        import resource  # noqa: PLC0415 - Windows has no such limits, and the clock must do
    except ImportError:
        yield
        return
    used = resource.getrusage(resource.RUSAGE_SELF)
    limits = {resource.RLIMIT_CORE: 0, resource.RLIMIT_CPU: int(used.ru_utime + used.ru_stime + seconds) + 1, resource.RLIMIT_DATA: memory}
    before = {kind: resource.getrlimit(kind) for kind in limits}
    for kind, most in limits.items():
        hard = before[kind][1]
        resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
    try:
        yield
    finally:
        for kind, limit in before.items():
            resource.setrlimit(kind, limit)


if __name__ == "__main__":
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no answer
    _serve(sys.stdin.buffer, output)
