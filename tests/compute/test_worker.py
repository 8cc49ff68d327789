"""The process that computes for this one, on systems that hold it to less."""

import os
import random
import sys
from importlib import import_module

import pytest
from platforms import posix

from mocap_calib.compute import BLAS_THREADS, worker


@pytest.fixture
def on_macos(monkeypatch) -> list[int]:
    """Refuse limits of memory, as macOS does; the kinds of limits that were set."""
    import resource

    kinds = []

    def set_limit(kind, _):
        if kind == resource.RLIMIT_DATA:
            raise ValueError("current limit exceeds maximum limit")
        kinds.append(kind)

    monkeypatch.setattr(resource, "setrlimit", set_limit)
    return kinds


@posix
def test_a_system_without_limits_of_memory_computes_all_the_same(on_macos):
    import resource

    answer = worker._answer(cpu_seconds=2.0, memory_bytes=10**9, function=len, arguments=("four",))
    assert answer == 4
    assert on_macos == [resource.RLIMIT_CORE, resource.RLIMIT_CPU] * 2  # set, and set back


def test_a_system_without_limits_computes_all_the_same(monkeypatch):
    monkeypatch.setattr(worker.sys, "platform", "win32")
    monkeypatch.setitem(worker.sys.modules, "resource", None)
    assert worker._answer(2.0, 10**9, len, ("four",)) == 4


def test_its_libraries_compute_on_one_thread(monkeypatch):
    """Accelerate, which numpy has on macOS, is held by its own variable alone."""
    assert "VECLIB_MAXIMUM_THREADS" in BLAS_THREADS
    for variable in BLAS_THREADS:
        monkeypatch.setenv(variable, "7")
    other = worker.Worker()
    assert {other.call(os.getenv, name) for name in (*BLAS_THREADS, "OMP_NUM_THREADS")} == {"1"}
    other.end()


def test_a_process_that_was_killed_is_not_started_again():
    other = worker.Worker()
    other.kill()
    with pytest.raises(worker.WorkerEndedError):
        other.call(len, "four")
    assert other.end() == "it was not there"


def test_modules_of_python_come_before_those_beside_a_script(tmp_path, monkeypatch):
    """A file `random.py` beside a script ended the process: files that it read were "damaged"."""
    (tmp_path / "random.py").write_text("raise SystemExit(1)\n")
    (tmp_path / "beside.py").write_text("def answer():\n    return 42\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    other = worker.Worker()
    assert other.call(random.choice, [3]) == 3
    assert other.call(import_module("beside").answer) == 42
    other.end()


def test_packages_come_from_where_this_process_has_them(tmp_path, monkeypatch):
    """Those of a checkout come before those that are installed."""
    (tmp_path / "yaml.py").write_text("def answer():\n    return 42\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "yaml")
    other = worker.Worker()
    assert other.call(import_module("yaml").answer) == 42
    other.end()
