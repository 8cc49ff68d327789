"""Processes of this machine: results and errors come back, and nothing outlives its command."""

import os
import signal
import subprocess
import sys
import time
from contextlib import closing

import psutil
import pytest
from platforms import posix

from mocap_calib.compute.parallel import Processes
from mocap_calib.errors import ClusterError

# a process that has given work to another, which says who it is and then works for a minute
AT_WORK = """
import sys
from contextlib import closing
from mocap_calib.compute.parallel import Processes
sys.path += sys.argv[2:]
from test_processes import say_and_sleep
with closing(Processes(1)) as workers:
    list(workers.completed(say_and_sleep, [sys.argv[1]]))
"""


def say_and_sleep(path):
    with open(f"{path}.new", "w") as file:
        file.write(str(os.getpid()))
    os.replace(f"{path}.new", path)
    time.sleep(60)


def inverse_or_end(number):
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return 1 / number


def outcome(result):
    try:
        return result()
    except (ClusterError, ZeroDivisionError) as error:
        return str(error)


@posix
def test_one_item_that_fails_or_kills_its_process_does_not_end_the_others():
    with closing(Processes(2)) as workers:
        assert workers.threads == 2
        found = {
            item: outcome(result)
            for item, result in workers.completed(inverse_or_end, [0, 1, 2, 3, 4, 5])
        }
    assert found == {
        0: "division by zero",
        1: 1.0,
        2: 0.5,
        3: "expected a process that survives the work, found it ended by SIGKILL; "
        "give it more memory, or do less at a time",
        4: 0.25,
        5: 0.2,
    }


def test_no_more_is_taken_than_keeps_the_processes_busy():
    taken = []
    with closing(Processes(2)) as workers:
        for _ in workers.completed(abs, (taken.append(k) or k for k in range(9))):
            break
    assert taken == [0, 1, 2, 3]


def start_and_interrupt(path):
    """Have a process work for a minute, and interrupt it after a second."""
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        with closing(Processes(1)) as workers:
            signal.setitimer(signal.ITIMER_REAL, 1.0)
            next(workers.completed(say_and_sleep, [path / "one", path / "two"]))
    finally:
        signal.signal(signal.SIGALRM, before)


@posix
def test_an_interruption_ends_work_that_is_under_way(tmp_path):
    start = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        start_and_interrupt(tmp_path)
    assert time.monotonic() - start < 50
    assert [path.name for path in tmp_path.iterdir()] in ([], ["one"])
    for path in tmp_path.iterdir():
        assert not psutil.pid_exists(int(path.read_text()))


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
