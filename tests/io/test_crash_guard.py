"""HDF5 is parsed in a process of its own: whatever becomes of it, the program goes on, and nothing
is mistaken for another answer.
"""

import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from platforms import linux, posix

from mocap_calib.errors import FormatError
from mocap_calib.io.crash_guard import end_calls, guard_hdf5
from mocap_calib.io.document import Document
from mocap_calib.io.hdf5 import HDF5


def process(_=None):
    return os.getpid()


def crash():
    os.kill(os.getpid(), signal.SIGSEGV)


def leave():
    os._exit(3)


def loop():
    while True:
        pass


def much(numbers):
    return np.ones(numbers).sum()


def bad(words):
    raise FormatError("", words, "none", "ask")


def mistake():
    return {}["there"]


def chatter():
    os.write(1, b"what a library prints")
    return 7


def echo(values):
    return values


def wait_for(path, begun=None):
    if begun:
        begun.touch()
    while not path.exists():
        time.sleep(0.05)


def computed_by_children():
    times = os.times()
    return times.children_user + times.children_system


def inside(call, *args, content=HDF5):
    return guard_hdf5(Document(Path("there/x.h5"), given=content), call, *args)


def test_only_hdf5_is_read_elsewhere():
    assert inside(process, content=b"{}") == os.getpid()
    assert inside(process) != os.getpid()
    assert inside(process) == inside(process)


@posix
@pytest.mark.parametrize(
    ("call", "verb", "how"),
    [
        (crash, "crashed", "SIGSEGV"),
        (leave, "crashed", "status 3"),
        (loop, "(took too long|crashed)", "(SIGXCPU|SIGKILL)"),  # the clock, on a busy machine
    ],
)
def test_a_crash_is_one_line(call, verb, how):
    computed = computed_by_children()
    with pytest.raises(
        FormatError,
        match=(
            rf"^there/x.h5: expected a whole HDF5 file, found that the HDF5 library {verb} on it "
            rf"\({how}\); copy or export it again$"
        ),
    ):
        inside(call)
    assert inside(process) != os.getpid()
    assert computed_by_children() - computed < 20, "2 seconds of computing are allowed"


@linux
def test_memory_is_held_to_the_file():
    """1.6 GB for a file of eight bytes, to which 1 GB is allowed; six for a megabyte."""
    with pytest.raises(
        FormatError,
        match=r"^there/x.h5: expected a file that fits into memory, found 8 bytes that claim",
    ):
        inside(much, 200_000_000)
    assert inside(much, 50_000_000) == 5e7
    assert inside(much, 200_000_000, content=HDF5 + bytes(1_000_000)) == 2e8


@posix
def test_a_large_files_memory_goes_with_the_process():
    first = inside(process, content=HDF5 + bytes(11_000_000))
    assert inside(process) != first
    with pytest.raises(ProcessLookupError):
        os.kill(first, 0)


@pytest.mark.parametrize("size", [100, 11_000_000], ids=["small", "large"])
def test_calls_of_other_threads_are_ended(size):
    """Ctrl-C reaches the main thread alone. Of six large files two wait for their turn."""
    with ThreadPoolExecutor(6) as threads:
        calls = [
            threads.submit(inside, time.sleep, 60, content=HDF5 + bytes(size)) for _ in "abcdef"
        ]
        time.sleep(1)
        end_calls()
        for call in calls:
            with pytest.raises(FormatError, match="crashed on it"):
                call.result(timeout=120)  # six, or four, of them would take longer
    assert inside(process) != os.getpid()


def test_errors_and_values_come_back():
    with pytest.raises(FormatError, match=r"^expected these words, found none; ask$"):
        inside(bad, "these words")
    with pytest.raises(KeyError) as found:
        inside(mistake)
    assert "in mistake" in found.value.__notes__[0]
    assert inside(chatter) == 7
    values = np.arange(3_000_000.0).reshape(-1, 3)
    np.testing.assert_array_equal(inside(echo, values), values)


def test_an_interrupted_question_has_no_late_answer(monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    inside(process)
    with monkeypatch.context() as patch:
        patch.setattr("mocap_calib.compute.worker.pickle.load", interrupt)
        with pytest.raises(KeyboardInterrupt):
            inside(echo, "late")
    assert inside(echo, "now") == "now"


def test_modules_of_the_folder_one_stands_in_are_left_alone(tmp_path, monkeypatch):
    (tmp_path / "signal.py").write_text("raise SystemExit")
    monkeypatch.chdir(tmp_path)
    inside(process, content=HDF5 + bytes(11_000_000))
    assert inside(process) != os.getpid()


@posix
def test_what_ended_while_nobody_asked_is_started_again():
    os.kill(inside(process), signal.SIGKILL)
    time.sleep(0.1)
    assert inside(echo, "now") == "now"


@posix
def test_a_fork_has_its_own():
    inside(process)
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        os.write(write, str(inside(process)).encode())
        os._exit(0)
    assert int(os.read(read, 20)) not in (os.getpid(), inside(process))
    os.waitpid(child, 0)
