"""Kernels are compiled once on a machine, also where nothing can be kept."""

import os
import subprocess
import sys

import numpy as np
import pytest

from mocap_calib.kernels import jit
from mocap_calib.kernels.jit import contiguous

KERNEL = """
from mocap_calib.kernels.jit import inlined, kernel

@inlined
def twice(x):
    return 2 * x

@kernel("f8[::1]")
def double(values):
    for k in range(len(values)):
        values[k] = twice(values[k])
"""
RUN = """
import numpy as np
import some_kernels
values = np.arange(3.0)
some_kernels.double(values)
print(*values, sum(some_kernels.double.stats.cache_hits.values()))
"""


@pytest.fixture(name="folder")
def folder_of_a_kernel(tmp_path):
    (tmp_path / "some_kernels.py").write_text(KERNEL, "utf-8")
    return tmp_path


def run(folder, **environment: str) -> str:
    path = os.pathsep.join([str(folder), *filter(None, sys.path)])
    environment = os.environ | {"PYTHONPATH": path} | environment
    return subprocess.check_output([sys.executable, "-c", RUN], text=True, env=environment).strip()


def test_machine_code_is_kept_beside_the_module(folder):
    assert [run(folder), run(folder)] == ["0.0 2.0 4.0 0", "0.0 2.0 4.0 1"]
    assert list((folder / "__pycache__").glob("*.nbi"))


def test_a_kernel_runs_where_no_folder_can_be_written(folder):
    """As root may write anywhere, there is a file in place of each folder."""
    (folder / "__pycache__").write_text("")
    (folder / "home").write_text("")
    home = str(folder / "home")
    kept = {"HOME": home, "XDG_CACHE_HOME": home, "PYTHONDONTWRITEBYTECODE": "1"}
    assert run(folder, **kept) == "0.0 2.0 4.0 0"


def test_machine_code_that_is_older_than_what_kernels_share_is_dropped(folder):
    run(folder)
    (index,) = (folder / "__pycache__").glob("*.nbi")
    for name in jit.SHARED:
        (folder / f"{name}.py").touch()
        os.utime(folder / f"{name}.py", (0, 0))
    jit.drop_stale_code(folder)
    assert index.exists()
    os.utime(folder / "lens.py")
    os.utime(index, (0, 0))
    jit.drop_stale_code(folder)
    assert not index.exists()


def test_arrays_for_kernels_are_in_c_order_and_can_be_written():
    kept = np.zeros((2, 3))
    frozen = np.broadcast_to(np.ones(3), (2, 3))
    same, turned, written = contiguous(kept, np.ones((3, 2)).T, frozen)
    assert same is kept
    assert turned.flags.c_contiguous
    assert written.flags.writeable
