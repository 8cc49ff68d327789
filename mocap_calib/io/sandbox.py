"""HDF5 is parsed in a process of its own, since one damaged file in some hundreds ends libhdf5 2.0.0, or never lets it come back.

The process starts with the first such file (0.3 s) and serves until this one ends, or a large file's memory is to be given back. What
it does not survive becomes a FormatError. Measured in docs/formats.md, "Fuzzing".
"""

import os
from collections.abc import Callable
from functools import cache
from typing import TypeVar, TypeVarTuple

from mocap_calib.compute.worker import Worker, WorkerEndedError
from mocap_calib.io.file import malformed

HDF5 = b"\x89HDF\r\n\x1a\n"
_LARGE = 10_000_000  # bytes
Ts = TypeVarTuple("Ts")
T = TypeVar("T")


def contained(content: bytes, source: str, parse: Callable[[*Ts], T], *args: *Ts) -> T:
    """`parse(*args)`, in the other process where `content` is HDF5.

    parse: a function of a module, whose arguments, result and errors can be pickled. Raises what it raises, and FormatError
    where the file ends the process, or takes more than 2 to 3 s of computing and 10 s per MB (20 times that by the clock), or
    more memory than 1 GB, 100 times its size, and five copies of what deflate may have packed into it, up to 1 GB each.
    """
    if not content.startswith(HDF5):
        return parse(*args)
    worker = _worker(os.getpid())
    size = len(content)
    try:
        return worker.call(
            parse,
            *args,
            cpu_seconds=2 + size / 1e5,
            memory_bytes=1_000_000_000 + 100 * size + 5 * min(1032 * size, 1_000_000_000),
        )
    except MemoryError:
        raise malformed(
            source,
            "HDF5 of a size that memory holds",
            f"{size} bytes that unpack to more",
            "check that it is whole, or split it",
        ) from None
    except WorkerEndedError as end:
        raise malformed(
            source,
            "a whole HDF5 file",
            f"damage that HDF5 does not survive ({end})",
            "copy or export it again",
        ) from None
    finally:
        if size > _LARGE:
            worker.end()


@cache
def _worker(pid: int) -> Worker:  # noqa: ARG001 - a process that was forked off has one of its own
    return Worker()
