"""Memory that arrays give back is kept for the next ones."""

import platform
import subprocess
import sys

import pytest
from platforms import linux

FAULTS = """
import resource, sys
import numpy as np
from mocap_calib.compute.memory import keep_freed_memory
if sys.argv[1] == "kept":
    keep_freed_memory()
for turn in range(12):
    if turn == 2:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    one = np.ones(500_000)
    other = 2 * one
    del one, other
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@linux
@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="of glibc alone")
def test_arrays_take_the_memory_of_those_before():
    """A page is 4 kB: of ten rounds with 8 MB each, 20,000 are asked for, or next to none."""
    count = {
        name: int(subprocess.check_output([sys.executable, "-c", FAULTS, name]))
        for name in ("given back", "kept")
    }
    assert count["given back"] > 10_000
    assert count["kept"] < 500
