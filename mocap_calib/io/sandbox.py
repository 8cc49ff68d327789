"""Parse HDF5 and COLMAP's models in a process of its own.

One damaged file in some hundreds ends libhdf5 2.0.0, or never lets it come back; a damaged count
in a binary model makes COLMAP fill all memory. The process starts with the first such file (0.3 s)
and serves until this one ends; a large file has one of its own, whose memory is given back. What it
does not survive becomes a FormatError. Measured in docs/formats-checks.md.
"""

import os
from collections.abc import Callable
from functools import cache
from typing import TypeVar, TypeVarTuple

from mocap_calib.compute.worker import Worker, WorkerEndedError
from mocap_calib.io.file import malformed
from mocap_calib.io.hdf5 import DEFLATE

HDF5 = b"\x89HDF\r\n\x1a\n"
_LARGE = 10_000_000  # bytes; the process ends after such a file
_SECONDS = 2.0  # of computing that any file may take,
_BYTES_A_SECOND = 1e5  # and a second more for each so many bytes
_MEMORY = 1_000_000_000  # bytes that any file may take,
_MEMORY_A_BYTE = 100  # and so many for each byte of it,
_COPIES = 5  # and so many copies of what deflate may have packed into it,
_MOST_UNPACKED = 1_000_000_000  # up to this
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
    # a process that ends after the file can serve it beside others
    worker = Worker() if size > _LARGE else _worker(os.getpid())
    try:
        return worker.call(parse, *args, cpu_seconds=cpu_seconds, memory_bytes=memory_bytes)
    except MemoryError:
        expected = f"{what} of a size that memory holds"
        found = f"{size} bytes that unpack to more"
        raise malformed(source, expected, found, "check that it is whole, or split it") from None
    except WorkerEndedError as end:
        found = f"damage that its reader does not survive ({end})"
        raise malformed(source, f"{what} that is whole", found, "copy or export it again") from None
    finally:
        if size > _LARGE:
            worker.end()


@cache
def _worker(pid: int) -> Worker:  # a forked process has one of its own
    return Worker()
