"""Parse HDF5 and COLMAP's models in a process of its own.

One damaged file in some hundreds ends libhdf5 2.0.0, or never lets it come back; a damaged count
in a binary model makes COLMAP fill all memory. The process starts with the first such file (0.3 s)
and serves until this one ends; large files have others, whose memory is given back. What a process
does not survive becomes a FormatError. Measured in docs/formats-checks.md.
"""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from threading import BoundedSemaphore, Lock
from typing import TypeVar, TypeVarTuple

from mocap_calib.compute.worker import Worker, WorkerEndedError
from mocap_calib.io.file import malformed
from mocap_calib.io.hdf5 import DEFLATE

HDF5 = b"\x89HDF\r\n\x1a\n"
_LARGE = 10_000_000  # bytes; a process ends after such a file, or after several: `keep_processes`
_SECONDS = 2.0  # of computing that any file may take,
_BYTES_A_SECOND = 1e5  # and a second more for each so many bytes
_MEMORY = 1_000_000_000  # bytes that any file may take,
_MEMORY_A_BYTE = 100  # and so many for each byte of it,
_COPIES = 5  # and so many copies of what deflate may have packed into it,
_MOST_UNPACKED = 1_000_000_000  # up to this
_LARGE_AT_A_TIME = 4  # each takes the memory of a process
Ts = TypeVarTuple("Ts")
T = TypeVar("T")


def call_contained(
    start: bytes, size: int, source: str, parse: Callable[[*Ts], T], *args: *Ts
) -> T:
    """Return `parse(*args)`, from the other process where what it parses is HDF5.

    start: the beginning of that. size: of it, in bytes.
    parse: a function of a module, whose arguments, result and errors can be pickled.

    Raises what it raises, and FormatError where the file ends the process, or takes more than 2 to
    3 s of computing and 10 s per MB (20 times that by the clock), or more memory than 1 GB, 100
    times its size, and five copies of what deflate may have packed into it, up to 1 GB each.
    """
    if not start.startswith(HDF5):
        return parse(*args)
    unpacked = min(DEFLATE * size, _MOST_UNPACKED)
    return call_elsewhere(
        parse,
        *args,
        what="an HDF5 file",
        source=source,
        size=size,
        cpu_seconds=_SECONDS + size / _BYTES_A_SECOND,
        memory_bytes=_MEMORY + _MEMORY_A_BYTE * size + _COPIES * unpacked,
    )


def call_elsewhere(
    parse: Callable[[*Ts], T],
    *args: *Ts,
    what: str,
    source: str,
    size: int,
    cpu_seconds: float,
    memory_bytes: int,
) -> T:
    """Return `parse(*args)` from the other process, within these limits.

    parse: a function of a module, whose arguments, result and errors can be pickled.
    what: names what is parsed, with its article. size: of it, in bytes.

    Raises what it raises, and FormatError where the input ends the process or exceeds a limit.
    """
    large = size > _LARGE
    before = _calls.endings
    try:
        with _calls.at_a_time if large else nullcontext(), _calls.worker(large, before) as worker:
            return worker.call(parse, *args, cpu_seconds=cpu_seconds, memory_bytes=memory_bytes)
    except MemoryError:
        expected = f"{what} of a size that memory holds"
        found = f"{size} bytes that unpack to more"
        raise malformed(source, expected, found, "check that it is whole, or split it") from None
    except WorkerEndedError as end:
        found = f"damage that its reader does not survive ({end})"
        raise malformed(source, f"{what} that is whole", found, "copy or export it again") from None


@contextmanager
def keep_processes() -> Iterator[None]:
    """Keep the processes of large files for further ones meanwhile: to start one takes 0.2 s."""
    _calls.keep(1)
    try:
        yield
    finally:
        _calls.keep(-1)


def end_calls() -> None:
    """End the calls of all threads, which raise FormatError; later ones are served as ever."""
    _calls.end()


class _Calls:
    """The calls under way.

    endings: how often they were ended. at_a_time: held during the call of a large file, of which
        there are a few at a time. for_small: the process for small files, None before the first.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Start without processes: in a child of this process, too, which they do not serve."""
        self.endings = 0
        self.at_a_time = BoundedSemaphore(_LARGE_AT_A_TIME)
        self._lock = Lock()
        self._workers: set[Worker] = set()
        self.for_small: Worker | None = None
        self._keepers = 0  # who keep the processes of large files for further ones,
        self._idle: list[Worker] = []  # and those of these that wait

    @contextmanager
    def worker(self, large: bool, before: int) -> Iterator[Worker]:
        """Give the process for a call; that of a large file ends with it, unless it is kept.

        before: `endings` when the call began. It is not made where calls were ended while it waited
            for its turn.
        """
        with self._lock:
            if self.endings != before:
                raise WorkerEndedError("the program that called it")
            if large:
                worker = self._idle.pop() if self._idle else Worker()
            else:
                worker = self.for_small = self.for_small or Worker()
            self._workers.add(worker)
        try:
            yield worker
        finally:
            if large:
                self._put_back(worker)

    def _put_back(self, worker: Worker) -> None:
        """Keep the process of a large file for another, or end it; what was killed is ended."""
        with self._lock:
            kept = self._keepers > 0 and worker in self._workers
            if kept:
                self._idle.append(worker)
            else:
                self._workers.discard(worker)
        if not kept:
            worker.end()

    def keep(self, more: int) -> None:
        """Add 1 to who keeps processes, or -1; when nobody does, those that wait are ended."""
        with self._lock:
            self._keepers = max(0, self._keepers + more)  # a forked child has none
            idle: list[Worker] = []
            if not self._keepers:
                idle, self._idle = self._idle, idle
            self._workers.difference_update(idle)
        for worker in idle:
            worker.end()

    def end(self) -> None:
        """Kill the processes; others take their places when they are called for."""
        with self._lock:
            self.endings += 1
            workers, self._workers, self.for_small = self._workers, set(), None
            idle, self._idle = self._idle, []
            for worker in workers:
                worker.kill()
        for worker in idle:
            worker.end()


_calls = _Calls()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_calls.forget)
