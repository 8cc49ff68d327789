"""Parse HDF5, MATLAB files and COLMAP's models in another process, against crashes.

One damaged file in some hundreds crashes libhdf5 2.0.0, or never lets it come back; a damaged count
makes COLMAP and scipy fill all memory. The process starts with the first such file (0.3 s) and
serves until this one ends; each large file has one of its own, whose memory is given back. A crash
becomes a FormatError. The process has all rights of the user: this is no protection against
hostile files.
"""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from threading import BoundedSemaphore, Lock
from typing import TypeVar, TypeVarTuple

from mocap_calib.compute.worker import Worker, WorkerEndedError
from mocap_calib.errors import FormatError
from mocap_calib.io.document import Document
from mocap_calib.io.hdf5 import DEFLATE

_LARGE = 10_000_000  # bytes; such files have processes of their own
_SECONDS = 2.0  # of computing that any file may take,
_BYTES_A_SECOND = 1e5  # and a second more for each so many bytes
_MEMORY = 1_000_000_000  # bytes that any file may take,
_MEMORY_A_BYTE = 100  # and so many for each byte of it,
_COPIES = 5  # and so many copies of what deflate may have packed into it,
_MOST_UNPACKED = 1_000_000_000  # up to this
_LARGE_AT_A_TIME = 4  # each takes the memory of a process
_OUT_OF_TIME = "SIGXCPU"
Ts = TypeVarTuple("Ts")
T = TypeVar("T")


def guard_hdf5(document: Document, parse: Callable[[*Ts], T], *args: *Ts) -> T:
    """Return `parse(*args)` as `guard` does where a document is HDF5, else from this process."""
    if not document.is_hdf5:
        return parse(*args)
    source, size = document.source, document.size
    return guard(parse, *args, what="HDF5 file", library="HDF5", source=source, size=size)


def guard(
    parse: Callable[[*Ts], T],
    *args: *Ts,
    what: str,
    library: str,
    source: str,
    size: int,
    packed: bool = True,
) -> T:
    """Return `parse(*args)` from the other process.

    parse: a function of a module, whose arguments, result and errors can be pickled.
    what: names what is parsed; library: what parses it. size: of it, in bytes.
    packed: whether deflate may have packed it.

    Raises what `parse` raises, and FormatError where the input ends the process, or takes more than
    2 to 3 s of computing and 10 s per MB (20 times that by the clock), or more memory than 1 GB,
    100 times its size, and five copies of what deflate may have packed into it, up to 1 GB each.
    """
    large = size > _LARGE
    unpacked = min(DEFLATE * size, _MOST_UNPACKED) if packed else 0
    before = _calls.endings
    try:
        with _calls.at_a_time if large else nullcontext(), _calls.worker(large, before) as worker:
            return worker.call(
                parse,
                *args,
                cpu_seconds=_SECONDS + size / _BYTES_A_SECOND,
                memory_bytes=_MEMORY + _MEMORY_A_BYTE * size + _COPIES * unpacked,
            )
    except MemoryError:
        expected = "a file that fits into memory"
        found = f"{size} bytes that claim to unpack to more"
        raise FormatError(source, expected, found, "check that it is whole, or split it") from None
    except WorkerEndedError as end:
        verb = "took too long" if str(end) == _OUT_OF_TIME else "crashed"
        found = f"that the {library} library {verb} on it ({end})"
        raise FormatError(source, f"a whole {what}", found, "copy or export it again") from None


def end_calls() -> None:
    """End the calls of all threads, which raise FormatError; later ones are served as ever."""
    _calls.end()


class _Calls:
    """The calls under way.

    endings: how often they were ended. at_a_time: held during the call of a large file, of which
        there are a few at a time.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Start without processes: in a child of this process, too, which they do not serve."""
        self.endings = 0
        self.at_a_time = BoundedSemaphore(_LARGE_AT_A_TIME)
        self._lock = Lock()
        self._workers: set[Worker] = set()
        self._for_small: Worker | None = None

    @contextmanager
    def worker(self, large: bool, before: int) -> Iterator[Worker]:
        """Give the process for a call; that of a large file ends after it.

        before: `endings` when the call began. It is not made where calls were ended while it waited
            for its turn.
        """
        with self._lock:
            if self.endings != before:
                raise WorkerEndedError("the program that called it")
            if large:
                worker = Worker()
            else:
                worker = self._for_small = self._for_small or Worker()
            self._workers.add(worker)
        try:
            yield worker
        finally:
            if large:
                with self._lock:
                    self._workers.discard(worker)
                worker.end()

    def end(self) -> None:
        """Kill the processes; others take their places when they are called for."""
        with self._lock:
            self.endings += 1
            workers, self._workers, self._for_small = self._workers, set(), None
        for worker in workers:
            worker.kill()
            worker.end()


_calls = _Calls()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_calls.forget)
