"""Kernels, threads, memory and processes, on this machine and on others."""

import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import closing
from importlib import import_module
from pathlib import Path

import numpy as np
import psutil
import pytest
from platforms import posix
from scenes import calibrated, lifted, recording, scene, truth
from threadpoolctl import threadpool_info, threadpool_limits

import mocap_calib as mc
from mocap_calib import compute
from mocap_calib.adjust.refine import adjust_until_stable
from mocap_calib.compute.parallel import Processes, single_threaded_libraries
from mocap_calib.compute.worker import Worker, WorkerEndedError
from mocap_calib.config import Config, PairwiseConfig
from mocap_calib.kernels import jit
from mocap_calib.pairs.solve import calibrate_pairs
from mocap_calib.poses.stage import smooth_group

# kernels

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


def test_machine_code_is_kept_until_what_kernels_share_is_newer(folder):
    assert [run(folder), run(folder)] == ["0.0 2.0 4.0 0", "0.0 2.0 4.0 1"]
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


@posix
@pytest.mark.parametrize(("path", "mode"), [("", 0o777), ("*.nbc", 0o666)])
def test_machine_code_that_others_can_write_is_not_loaded(folder, path, mode):
    run(folder)
    cache = folder / "__pycache__"
    (changed,) = cache.glob(path) if path else [cache]
    changed.chmod(mode)
    assert run(folder) == "0.0 2.0 4.0 0"
    changed.chmod(mode & ~0o022)
    assert run(folder) == "0.0 2.0 4.0 1"


def test_a_kernel_runs_where_no_folder_can_be_written(folder):
    """As root may write anywhere, there is a file in place of each folder."""
    (folder / "__pycache__").write_text("")
    (folder / "home").write_text("")
    home = str(folder / "home")
    kept = {"HOME": home, "XDG_CACHE_HOME": home, "PYTHONDONTWRITEBYTECODE": "1"}
    assert run(folder, **kept) == "0.0 2.0 4.0 0"


def test_arrays_for_kernels_are_in_c_order_and_can_be_written():
    kept, frozen = np.zeros((2, 3)), np.broadcast_to(np.ones(3), (2, 3))
    same, turned, written = jit.contiguous(kept, np.ones((3, 2)).T, frozen)
    assert same is kept
    assert turned.flags.c_contiguous
    assert written.flags.writeable


# the program: other code is another program, another system is not


def test_only_a_change_of_code_name_or_skeleton_is_another_program(tmp_path):
    """Not line ends, another folder, or what Python leaves behind."""
    code = compute.hash_code(Path(mc.__file__).parent)[:12]
    assert compute.identify_program() == f"{mc.__version__} (code {code})"
    package, copy = tmp_path / "package", tmp_path / "copy"
    (package / "skeletons").mkdir(parents=True)
    (package / "__pycache__").mkdir()
    (package / "skeletons" / "b.yaml").write_bytes(b"name: b\n")
    found = []
    for text in (b"one = 1\ntwo = 2\n", b"one = 1\r\ntwo = 2\r\n", b"one = 1\ntwo = 3\n"):
        (package / "a.py").write_bytes(text)
        found.append(compute.hash_code(package))
        (package / "__pycache__" / "a.cpython-311.pyc").write_bytes(b"compiled")
    shutil.copytree(package, copy)
    assert compute.hash_code(copy) == found[2] != found[1] == found[0]
    (package / "a.py").rename(package / "c.py")
    found.append(compute.hash_code(package))
    (package / "skeletons" / "b.yaml").write_bytes(b"name: c\n")
    found.append(compute.hash_code(package))
    assert len(set(found)) == 4


# threads of libraries


def blas_threads() -> set[int]:
    return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}


@pytest.fixture
def two_threads():
    """As in a Python program of a user's; the tests themselves run on one."""
    with threadpool_limits(2, user_api="blas"):
        if blas_threads() != {2}:
            pytest.skip("no BLAS here whose threads can be told")
        yield


def pairs(progress):
    rng = np.random.default_rng(0)
    calibrate_pairs(recording(), lifted(), PairwiseConfig(), rng=rng, progress=progress)


def adjust(progress):
    given = recording(), scene().rig, truth(), Config()
    adjust_until_stable(*given, lifted=lifted(), progress=progress)


def smooth(progress):
    smooth_group(calibrated(), Config(), progress=progress)


@pytest.mark.usefixtures("two_threads")
@pytest.mark.parametrize("stage", [pairs, adjust, smooth])
def test_a_stage_called_from_python_holds_blas_to_one_thread(stage):
    """And gives it back."""
    seen = []
    stage(lambda *_: seen.append(blas_threads()))
    assert {1} in seen
    assert {2} not in seen
    assert blas_threads() == {2}


@pytest.mark.usefixtures("two_threads")
def test_the_first_to_begin_may_be_the_first_to_end():
    """Of two calls on two threads: the second still has one, and all get back what there was."""
    began, ended = threading.Event(), threading.Event()

    def first():
        with single_threaded_libraries():
            began.wait(60)
        ended.set()

    thread = threading.Thread(target=first)
    thread.start()
    with single_threaded_libraries():
        began.set()
        assert ended.wait(60)
        assert blas_threads() == {1}
    thread.join()
    assert blas_threads() == {2}


# processes of this machine

# a process that has given work to another, which says who it is and then works for minutes
AT_WORK = """
import sys
from contextlib import closing
from mocap_calib.compute.parallel import Processes
sys.path += sys.argv[2:]
from test_compute import say_and_sleep
with closing(Processes(1)) as workers:
    list(workers.completed(say_and_sleep, [sys.argv[1]]))
"""


def say_and_sleep(path):
    Path(f"{path}.new").write_text(str(os.getpid()))
    os.replace(f"{path}.new", path)
    time.sleep(300)
    Path(f"{path}.done").touch()


def inverse_or_end(number):
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return 1 / number


def outcome(result):
    try:
        return result()
    except (mc.ClusterError, ZeroDivisionError) as error:
        return type(error)


@posix
def test_one_item_that_fails_or_kills_its_process_does_not_end_the_others():
    """And no more is taken than keeps the processes busy."""
    taken = []
    with closing(Processes(2)) as workers:
        assert workers.threads == 2
        items = workers.completed(inverse_or_end, (taken.append(k) or k for k in range(6)))
        found = {item: outcome(result) for item, result in [next(items)]}
        assert taken == [0, 1, 2, 3]
        found |= {item: outcome(result) for item, result in items}
    failed = {0: ZeroDivisionError, 3: mc.ClusterError}
    assert found == failed | {1: 1.0, 2: 0.5, 4: 0.25, 5: 0.2}


@posix
def test_a_process_at_work_ends_with_the_one_that_was_killed(tmp_path):
    said = tmp_path / "pid"
    with subprocess.Popen([sys.executable, "-c", AT_WORK, said, *sys.path]) as parent:
        while not said.exists():
            assert parent.poll() is None
            time.sleep(0.01)
        worker = psutil.Process(int(said.read_text()))
        parent.kill()
    assert psutil.wait_procs([worker], timeout=120)[1] == []


# the process that computes for this one


@pytest.fixture
def worker():
    other = Worker()
    yield other
    other.end()


def test_its_libraries_compute_on_one_thread(monkeypatch, worker):
    """Accelerate, which numpy has on macOS, is held by its own variable alone."""
    assert "VECLIB_MAXIMUM_THREADS" in compute.BLAS_THREADS
    for variable in compute.BLAS_THREADS:
        monkeypatch.setenv(variable, "7")
    names = (*compute.BLAS_THREADS, "OMP_NUM_THREADS")
    assert {worker.call(os.getenv, name) for name in names} == {"1"}


def refuse_limits_of_memory():
    """Do in this process as macOS does."""
    resource = import_module("resource")
    usual = resource.setrlimit

    def set_limit(kind, limits):
        if kind == resource.RLIMIT_DATA:
            raise ValueError("current limit exceeds maximum limit")
        usual(kind, limits)

    resource.setrlimit = set_limit


def take_limits_away():
    """Do in this process as Windows does."""
    sys.platform, sys.modules["resource"] = "win32", None


@posix
@pytest.mark.parametrize("system", [refuse_limits_of_memory, take_limits_away])
def test_a_system_without_limits_computes_all_the_same(system, worker):
    worker.call(system)
    assert worker.call(len, "four", cpu_seconds=60.0, memory_bytes=10**9) == 4


def test_a_process_that_was_killed_is_not_started_again(worker):
    worker.kill()
    with pytest.raises(WorkerEndedError):
        worker.call(len, "four")
    assert worker.end() == "it was not there"


def test_modules_of_python_come_before_those_beside_a_script_and_packages_from_there(
    tmp_path, monkeypatch, worker
):
    """A file `random.py` beside a script ended the process: files that it read were "damaged".

    Packages of a checkout come before those that are installed.
    """
    (tmp_path / "random.py").write_text("raise SystemExit(1)\n")
    for name in ("beside", "yaml"):
        (tmp_path / f"{name}.py").write_text("def answer():\n    return 42\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.delitem(sys.modules, "yaml")
    assert worker.call(random.choice, [3]) == 3
    for name in ("beside", "yaml"):
        assert worker.call(import_module(name).answer) == 42
