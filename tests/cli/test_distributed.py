"""Work sent to a real Dask scheduler and its workers, each a process of its own."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import TOOL
from platforms import posix
from test_batch import contents

import mocap_calib as mc

pytestmark = posix  # processes are stopped, killed and waited for

DASK = Path(sys.executable).with_name("dask")


@pytest.fixture
def scheduler(tmp_path) -> Iterator[subprocess.Popen]:
    """The process of a scheduler with two workers, whose address is in `scheduler.json`."""
    file, processes = tmp_path / "scheduler.json", []
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    for what in ("scheduler --host 127.0.0.1 --port 0", *["worker --nthreads 1 --no-nanny"] * 2):
        words = [DASK, *what.split(), "--no-dashboard", "--scheduler-file", file]
        processes.append(subprocess.Popen(words, **quiet))
        while not file.exists():
            assert processes[0].poll() is None
            time.sleep(0.05)
    yield processes[0]
    for process in processes:
        process.kill()
        process.wait()


@pytest.mark.slow
def test_pairs_of_a_rig_are_those_of_one_machine_and_the_end_of_the_scheduler_is_one_line(
    scheduler, tool, tmp_path
):
    """Fifteen pairs; the same bytes as on one machine."""
    made = tmp_path / "rig"
    tool("simulate", "-o", made, "--cameras", 6, "--people", 2, "--frames", 30)
    address = json.loads((tmp_path / "scheduler.json").read_text())["address"]
    command = ["run", made / "keypoints", "--cameras", made / "intrinsics.toml", "-o"]
    said = tool(*command, tmp_path / "there" / "out", "--scheduler", address)
    assert said.returncode == 0, said.stderr
    assert "at a time by the workers of tcp://127.0.0.1" in said.stderr
    assert "Traceback" not in said.stderr
    assert tool(*command, tmp_path / "here" / "out", "-q").returncode == 0
    assert contents(tmp_path / "there" / "out") == contents(tmp_path / "here" / "out")
    # another such run when the scheduler goes
    out = tmp_path / "out"
    process = subprocess.Popen(
        [TOOL, *command, out, "-q", "--scheduler", address],
        stderr=subprocess.PIPE,
        text=True,
    )
    while not list((out / ".unfinished").glob("*")):
        assert process.poll() is None
        time.sleep(0.01)
    scheduler.kill()
    _, said = process.communicate()
    assert process.returncode == 1
    assert said.splitlines() == [
        "mocap-calib: expected a scheduler that answers to the end, found it gone; "
        "start it again, and then this command: what is finished is kept"
    ], said
    assert list((out / ".unfinished").glob("*"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("node1", "(tcp://HOST:PORT), found node1"),
        ("tls://127.0.0.1:1", "expected a certificate for TLS"),
        ("tcp://127.0.0.1:1", "found none that answers"),
    ],
)
def test_an_address_of_no_scheduler_is_one_line(address, said, small, tool, tmp_path):
    words = ("run", small / "keypoints", "--cameras", small / "intrinsics.toml", "-q")
    done = tool(*words, "-o", tmp_path / "out", "--scheduler", address)
    assert done.returncode == 1
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert said in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_work_that_kills_its_workers_is_one_line():
    """As too little memory does; what else there is to do is done."""
    code = """
from posix import _exit
from distributed import LocalCluster
import mocap_calib.compute.cluster as module
from mocap_calib.compute.cluster import cluster
from mocap_calib.errors import ClusterError
def outcome(result):
    try:
        return result()
    except ClusterError as error:
        return str(error)
if __name__ == "__main__":
    here = LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=40)
    with here, cluster(here.scheduler_address) as workers:
        print(sorted((item, outcome(result)) for item, result in workers.completed(_exit, [1])))
        print(sorted((item, outcome(result)) for item, result in workers.completed(abs, [-2, -3])))
        module.identify_program = lambda: "of other code"  # workers do not unpack what it sends
        print([outcome(result) for _, result in workers.completed(abs, [-2])])
"""
    said = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.splitlines()
    found = said[-1].partition("found ")[2].partition(";")[0]
    assert found.startswith(mc.__version__)
    assert said == [
        "[(1, 'expected workers that survive the work, found 4 killed by the same piece; "
        "give them more memory')]",
        "[(-3, 3), (-2, 2)]",
        f"['expected mocap-calib of other code on every worker, found {found}; install the same "
        "there']",
    ]
