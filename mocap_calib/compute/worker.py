"""A process that computes for this one, and may end without ending it.

It is started with nothing of the program that calls it (multiprocessing would import the main
module again, which scripts and notebooks do not expect), serves one call after the other, and ends
with this process at the latest.
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
from queue import SimpleQueue
from typing import Any, BinaryIO, TypeVar, TypeVarTuple, cast

from mocap_calib.compute import BLAS_THREADS, keep_freed_memory
from mocap_calib.errors import MocapCalibError

Arguments = TypeVarTuple("Arguments")
Result = TypeVar("Result")

UNLIMITED = float("inf")
_CLOCK_PER_CPU_SECOND = 20  # other programs may hold the processors
# Modules come from where this process finds them, and in its order, but for those of Python itself,
# which come first: the folder of a script may have others of their names. Site-packages are added
# by `site` after that (-S), so that links of editable installs are followed.
_PROGRAM = (
    "import site, sys; sys.path += sys.argv[1:]; site.main(); "
    f"from {__name__} import serve; serve()"
)


class WorkerEndedError(Exception):
    """The process ended before it answered; the message says how."""


class Worker:
    """The other process; started at the first call, and anew after it has ended."""

    def __init__(self) -> None:
        self._lock = threading.RLock()  # held during a call
        self._start_lock = threading.Lock()  # so that nothing starts after the process was killed
        self._killed = False
        self._process: subprocess.Popen[bytes] | None = None

    def call(
        self,
        function: Callable[[*Arguments], Result],
        *arguments: *Arguments,
        cpu_seconds: float = UNLIMITED,
        memory_bytes: int = 0,
    ) -> Result:
        """Return what the function returns in the other process, or raise what it raises.

        function: of a module; it, its arguments and its result can be pickled.
        cpu_seconds: computing time allowed, and 20 times as much by the clock; memory_bytes:
        memory allowed. macOS does not hold the memory, Windows holds the clock alone.

        Raises WorkerEndedError where the process ends before it answers.
        """
        with self._lock:
            process = self._running()
            timer = _kill_later(process, cpu_seconds)
            try:
                call = cpu_seconds, memory_bytes, function, arguments
                calls, answers = cast(BinaryIO, process.stdin), cast(BinaryIO, process.stdout)
                pickle.dump(call, calls, protocol=5)
                calls.flush()
                answer = pickle.load(answers)  # of our own process: nobody else's pickle
            except (EOFError, OSError, pickle.UnpicklingError):
                raise WorkerEndedError(self.end()) from None
            except BaseException:
                # Ctrl-C: what it answers later would be taken for the answer to the next call
                process.kill()
                self.end()
                raise
            finally:
                timer.cancel()
        if isinstance(answer, Exception):
            raise answer
        return cast(Result, answer)

    def _running(self) -> "subprocess.Popen[bytes]":
        """Return the process, started if there is none. Raises WorkerEndedError after `kill`."""
        if self._process is not None and self._process.poll() is not None:
            self.end()  # it ended between two calls: no reason to refuse this one
        with self._start_lock:
            if self._killed:
                raise WorkerEndedError("the program that called it")
            if self._process is None:
                self._process = _start()
                atexit.register(self.end)
            return self._process

    def kill(self) -> None:
        """Kill the process for good: a call under way and all later ones raise WorkerEndedError."""
        with self._start_lock:
            self._killed = True
            process = self._process
        if process is not None:
            process.kill()

    def end(self) -> str:
        """End the process, and return how it ended."""
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
    """Start the process, with BLAS and OpenMP on one thread."""
    environment = os.environ | dict.fromkeys(("OMP_NUM_THREADS", *BLAS_THREADS), "1")
    environment.pop("PYTHONPATH", None)  # its folders are in `sys.path`, unless they are ignored
    return subprocess.Popen(
        # -P: not from the folder that one stands in
        [sys.executable, "-P", "-S", "-c", _PROGRAM, *filter(None, sys.path)],
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )


def _kill_later(process: "subprocess.Popen[bytes]", cpu_seconds: float) -> threading.Timer:
    """Start a timer that kills the process when its call takes too long by the clock."""
    longest = threading.TIMEOUT_MAX / _CLOCK_PER_CPU_SECOND
    timer = threading.Timer(_CLOCK_PER_CPU_SECOND * min(cpu_seconds, longest), process.kill)
    timer.daemon = True
    timer.start()
    return timer


def serve() -> None:
    """Answer the calls of the process that started this one, one after the other, until it ends."""
    keep_freed_memory()
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no answer
    _answer_all(sys.stdin.buffer, answers)


def _answer_all(calls: BinaryIO, answers: BinaryIO) -> None:
    """Answer one call after the other, until the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that calls
    waiting: SimpleQueue[Any] = SimpleQueue()
    threading.Thread(target=_read_calls, args=(calls, waiting), daemon=True).start()
    while True:
        pickle.dump(_answer(*waiting.get()), answers, protocol=5)
        answers.flush()


def _read_calls(calls: BinaryIO, waiting: "SimpleQueue[Any]") -> None:
    """Hand on the calls; end this process when the one that calls is gone, amid work too."""
    status = 1
    try:
        while True:
            waiting.put(pickle.load(calls))
    except EOFError:
        status = 0
    finally:
        os._exit(status)


def _answer(
    cpu_seconds: float, memory_bytes: int, function: Callable[..., Any], arguments: Any
) -> Any:
    """Return what the function returns, or the error that it raises."""
    try:
        with _limits(cpu_seconds, memory_bytes):
            return function(*arguments)
    except Exception as error:
        if not isinstance(error, MocapCalibError):
            error.add_note(traceback.format_exc())
        return error


@contextlib.contextmanager
def _limits(cpu_seconds: float, memory_bytes: int) -> Iterator[None]:
    """Hold this process to so much more computing time, and to so much memory.

    As far as the system lets it: macOS refuses any limit of memory.
    """
    if sys.platform == "win32" or cpu_seconds == UNLIMITED:
        yield
        return
    import resource  # noqa: PLC0415 - not on Windows

    used = resource.getrusage(resource.RUSAGE_SELF)
    limits = {
        resource.RLIMIT_CORE: 0,
        resource.RLIMIT_CPU: int(used.ru_utime + used.ru_stime + cpu_seconds) + 1,
        resource.RLIMIT_DATA: memory_bytes,
    }
    before = {kind: resource.getrlimit(kind) for kind in limits}
    for kind, most in limits.items():
        hard = before[kind][1]
        soft = most if hard == resource.RLIM_INFINITY else min(most, hard)
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(kind, (soft, hard))
    try:
        yield
    finally:
        for kind, limit in before.items():
            with contextlib.suppress(ValueError, OSError):
                resource.setrlimit(kind, limit)
