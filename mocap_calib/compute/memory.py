"""How the memory of this process is managed."""

import ctypes
import sys

# of malloc.h of glibc: the options, and bytes. What is larger than the first goes back to the
# system at once; of what is smaller, so much is kept, in one place for all threads.
_MMAP_THRESHOLD, _LARGE = -3, 1 << 25
_TRIM_THRESHOLD, _KEPT = -1, 1 << 28
_ARENA_MAX = -8


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
