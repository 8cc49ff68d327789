"""Memory that arrays give back is kept for the next ones."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest
from platforms import linux

FAULTS = """
import resource, sys
import numpy as np
from mocap_calib.compute import keep_freed_memory
if sys.argv[1] == "kept":
    keep_freed_memory()
for turn in range(12):
    if turn == 2:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    one = np.ones(500_000)
    other = 2 * one
    third = one + other  # more than twice the largest: glibc gives back no less
    del one, other, third
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


HUGE = Path("/sys/kernel/mm/transparent_hugepage/enabled")
PAGES = 10 * 12_000_000 // os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 0


@linux
@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="of glibc alone")
@pytest.mark.skipif(HUGE.exists() and "[always]" in HUGE.read_text("utf-8"), reason="huge pages")
def test_arrays_take_the_memory_of_those_before():
    """Of the pages of ten rounds with 12 MB each, all are asked for anew, or next to none."""
    usual = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("MALLOC_", "GLIBC_TUNABLES"))
    }
    # else glibc keeps what is smaller than the largest array that was given back so far
    usual["MALLOC_MMAP_THRESHOLD_"] = str(1 << 17)
    given_back, kept = (
        int(subprocess.check_output([sys.executable, "-c", FAULTS, name], env=usual))
        for name in ("given back", "kept")
    )
    assert given_back > 0.5 * PAGES
    assert kept < 0.025 * PAGES
