"""Where work is done: threads, processes, and the machines of a cluster; and how long it takes."""

import ctypes
import hashlib
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from mocap_calib import __version__

# environment variables that hold the libraries of linear algebra to so many threads; they are read
# when numpy is imported. Apple's, the last, knows no other way.
BLAS_THREADS = ("MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")

# of malloc.h of glibc: the options, and bytes. What is larger than the first goes back to the
# system at once; of what is smaller, so much is kept, in one place for all threads.
_MMAP_THRESHOLD, _LARGE = -3, 1 << 25
_TRIM_THRESHOLD, _KEPT = -1, 1 << 28
_ARENA_MAX = -8

_CODE = (".py", ".yaml")  # the weights are told apart by `lift.lifter.identify_model`


class Clock:
    """Wall time by stage: `with clock("lift"): ...` adds to an entry of `seconds`.

    before: the entries that it goes on from.
    """

    def __init__(self, before: Mapping[str, float] = {}) -> None:
        self.seconds = dict(before)

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Take the time of what is done inside the context."""
        start = time.perf_counter()
        yield
        spent = time.perf_counter() - start
        self.seconds[stage] = self.seconds.get(stage, 0.0) + spent


def keep_freed_memory() -> None:
    """Keep the memory of arrays for the next ones; for a program, which has the process to itself.

    Arrays of a few megabytes come and go. glibc would give each back to the system and ask for it
    anew, and the system clears it every time: 5 to 7 % of a calibration's seconds. Without glibc
    nothing happens.
    """
    if not sys.platform.startswith("linux"):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_ARENA_MAX, 1)
        mallopt(_MMAP_THRESHOLD, _LARGE)
        mallopt(_TRIM_THRESHOLD, _KEPT)


@cache
def identify_program() -> str:
    """Return the version and the beginning of a hash of the code: "0.1.0 (code 1a2b3c4d5e6f)".

    It is the same on every system, and however the program was installed.
    """
    return f"{__version__} (code {hash_code(Path(__file__).parents[1])[:12]})"


def hash_code(package: Path) -> str:
    """Return one SHA-256 for the names and contents of the code and the skeletons in a package.

    package: its folder. Line ends count as one, since git may change them.
    """
    files = {
        file.relative_to(package).as_posix(): file
        for file in package.rglob("*")
        if file.suffix in _CODE
    }
    digest = hashlib.sha256()
    for name, file in sorted(files.items()):
        content = file.read_bytes().replace(b"\r\n", b"\n")
        digest.update(f"{name} {len(content)}\n".encode() + content)
    return digest.hexdigest()
