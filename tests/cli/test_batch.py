"""Many recordings, and what is left of a run that was killed."""

import json
import os
import re
import shutil
import signal
import subprocess
import time
from pathlib import Path

import psutil
import pytest
from conftest import TOOL
from platforms import posix
from report_pages import timeless_run

NAMES = ("jump", "small", "walk")


def contents(folder: Path) -> dict[str, bytes]:
    """The files of a folder of results; of run.json all but the date and the times."""
    found = {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }
    for name in [name for name in found if name.endswith("run.json")]:
        found[name] = json.dumps(timeless_run(json.loads(found[name]))).encode()
    return found


def wait_for(path: Path, pattern: str, count: int, process: subprocess.Popen) -> None:
    """Until there are so many files."""
    while len(list(path.glob(pattern))) < count:
        assert process.poll() is None, "it was too quick to be killed"
        time.sleep(0.01)


@pytest.fixture(scope="module")
def sessions(tmp_path_factory, small, tool) -> Path:
    """Three recordings: two with intrinsics of their own, one a bare folder of keypoints."""
    folder = tmp_path_factory.mktemp("sessions")
    scene = ("--cameras", 3, "--people", 1, "--frames", 30, "--seed")
    for seed, name in enumerate(("jump", "walk")):
        assert tool("simulate", "-o", folder / name, *scene, seed).returncode == 0
    shutil.copytree(small / "keypoints", folder / "small")
    shutil.copy(small / "intrinsics.toml", folder)
    return folder


@pytest.fixture(scope="module")
def once(sessions, tool, tmp_path_factory) -> Path:
    """The results of a batch that nothing disturbed."""
    out = tmp_path_factory.mktemp("once") / "out"
    said = batch(tool, sessions, out)
    assert said.returncode == 0, said.stderr
    return out


def batch(tool, sessions: Path, out: Path, *options: object, names=NAMES):
    words = ("batch", *names, "--cameras", "intrinsics.toml", "-o", out)
    return tool(*words, *options, cwd=sessions)


def test_what_is_finished_is_kept(sessions, once, tool):
    before = {path: path.stat().st_mtime_ns for path in once.rglob("*")}
    said = batch(tool, sessions, once, "--json")
    assert said.returncode == 0, said.stderr
    found = json.loads(said.stdout)["recordings"]
    assert [(each["name"], each["status"]) for each in found] == [(name, "kept") for name in NAMES]
    assert {path: path.stat().st_mtime_ns for path in once.rglob("*")} == before
    assert "3 of 3 recordings" in said.stderr
    assert re.search(r"^walk +kept +3 +1 +0\.\d\d +[a-z ]+$", said.stderr, re.M)


def test_a_recording_that_fails_does_not_stop_the_others(sessions, once, tool, tmp_path):
    shutil.copytree(sessions, tmp_path / "in")
    shutil.copytree(once, tmp_path / "out")
    (tmp_path / "in" / "jump" / "keypoints" / "cam2.json").write_text("this is no JSON at all")
    names = ("jump", "nobody", "small")
    said = batch(tool, tmp_path / "in", tmp_path / "out", "--json", "-q", names=names)
    assert said.returncode == 1
    summary = json.loads(said.stdout)
    assert summary["failed"] == 2
    assert [each["status"] for each in summary["recordings"]] == ["failed", "failed", "kept"]
    lines = said.stderr.splitlines()
    assert len(lines) == 2
    assert lines[0].startswith("mocap-calib: jump: jump/keypoints/cam2.json: expected")
    assert lines[1] == (
        "mocap-calib: nobody: nobody: expected the folder of a recording, found none; "
        "check the path"
    )


@pytest.mark.parametrize("arguments", [("a/walk", "b/walk"), ("walk", "walk/")])
def test_recordings_of_one_name_are_refused(arguments, tool, tmp_path):
    said = tool("batch", *arguments, "--cameras", "i.toml", "-o", tmp_path / "out", cwd=tmp_path)
    assert (said.returncode, said.stdout) == (1, "")
    assert "expected recordings of different names" in said.stderr
    assert not (tmp_path / "out").exists()


def test_batch_has_the_options_of_run(tool):
    """It reads files of options of each recording, and has none of its own."""
    run, many = (
        set(re.findall(r"^  (?:-\w, )?(--[a-z-]+)", tool(name, "--help").stdout, re.M))
        for name in ("run", "batch")
    )
    assert many - run == {"--jobs"}
    assert run - many == {"--config", "--save-config"}
    assert len(many) > 40


@posix
@pytest.mark.slow
# both moments, and signals with and without a farewell; all six pairs would take a minute
@pytest.mark.parametrize(
    ("way", "moment"),
    [("SIGKILL", "small/.unfinished/*.json"), ("SIGTERM", "jump/run.json")],
    ids=["between-SIGKILL", "writing-SIGTERM"],
)
def test_a_batch_goes_on_where_it_was_killed(way, moment, sessions, once, tool, tmp_path):
    """Killed amid the second recording, or while the first one's results appear.

    The second call leaves the same bytes as a batch that nothing disturbed.
    """
    out = tmp_path / "out"
    command = [TOOL, "batch", *NAMES, "--cameras", "intrinsics.toml", "-o", out]
    process = subprocess.Popen(command, cwd=sessions, stderr=subprocess.PIPE, text=True)
    wait_for(out, moment, 1, process)
    process.send_signal(signal.Signals[way])
    _, said = process.communicate()
    expected = {"SIGKILL": -signal.SIGKILL, "SIGTERM": 128 + signal.SIGTERM}
    assert process.returncode == expected[way]
    assert "Traceback" not in said
    said = batch(tool, sessions, out, "--json")
    assert said.returncode == 0, said.stderr
    status = {each["name"]: each["status"] for each in json.loads(said.stdout)["recordings"]}
    assert status["walk"] == "done"
    assert status["jump"] == "kept" or moment == "jump/run.json"
    for name in NAMES:
        assert contents(out / name) == contents(once / name)


@posix
@pytest.mark.slow
def test_processes_end_with_a_batch_that_is_interrupted(sessions, once, tool, tmp_path):
    """The second call goes on, with the same bytes as in one process."""
    out = tmp_path / "out"
    command = [TOOL, "batch", *NAMES, "--cameras", "intrinsics.toml", "-o", out, "--jobs", "2"]
    process = subprocess.Popen(command, cwd=sessions, stderr=subprocess.PIPE, text=True)
    wait_for(out, "*/.unfinished/*.json", 1, process)  # there is work left, also on a quick machine
    workers = psutil.Process(process.pid).children(recursive=True)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate()
    assert "Traceback" not in said
    assert process.returncode == 130
    assert len(workers) == 2
    assert psutil.wait_procs(workers, timeout=120)[1] == []
    done = batch(tool, sessions, out, "--jobs", "2", "--json")
    assert done.returncode == 0, done.stderr
    assert "2 at a time" in done.stderr
    assert "done" in [each["status"] for each in json.loads(done.stdout)["recordings"]]
    for name in NAMES:
        assert contents(out / name) == contents(once / name)


@posix
@pytest.mark.slow
@pytest.mark.parametrize(
    ("way", "status", "pairs"), [("SIGINT", 130, 3), ("SIGKILL", -signal.SIGKILL, 5)]
)
def test_a_run_goes_on_where_it_was_killed_or_interrupted(way, status, pairs, tool, tmp_path):
    """What was kept is said on Ctrl-C; nothing is left of the first attempt in the end."""
    words = ("--cameras", 5, "--people", 2, "--frames", 30)
    assert tool("simulate", "-o", tmp_path, *words).returncode == 0
    command = ["run", tmp_path / "keypoints", "--cameras", tmp_path / "intrinsics.toml", "-q", "-o"]
    out, whole = tmp_path / "out", tmp_path / "whole" / "out"  # the page is called by its folder
    process = subprocess.Popen([TOOL, *command, out], stderr=subprocess.PIPE, text=True)
    wait_for(out / ".unfinished", "*.json", pairs, process)
    process.send_signal(signal.Signals[way])
    _, said = process.communicate()
    assert process.returncode == status
    kept = f" pairs of cameras kept in {out / '.unfinished'}: the same command goes on from"
    assert (kept in said and said.endswith("mocap-calib: interrupted\n")) == (way == "SIGINT")
    assert not (out / "run.json").exists()
    for path in (out, whole):
        assert tool(*command, path).returncode == 0
    assert contents(out) == contents(whole)


@pytest.mark.slow
def test_the_number_of_threads_does_not_change_a_byte(small, tmp_path):
    words = ["run", small / "keypoints", "--cameras", small / "intrinsics.toml", "-q", "-o"]
    for threads in ("1", "2"):
        environment = os.environ | {"OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads}
        subprocess.run([TOOL, *words, tmp_path / threads / "out"], env=environment, check=True)
    assert contents(tmp_path / "1") == contents(tmp_path / "2")


def test_a_scheduler_needs_dask_and_that_is_one_line(small, tmp_path):
    """Processes of this machine do not: the packages are hidden."""
    code = """
import sys
sys.modules.update(dask=None, distributed=None)
from mocap_calib_cli.main import main
main()
"""
    words = [small / "keypoints", "--cameras", small / "intrinsics.toml", "-o", tmp_path / "out"]
    command = ["-c", code, "run", *words, "--scheduler", "tcp://127.0.0.1:1"]
    done = subprocess.run(
        [TOOL.with_name("python"), *command], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == (
        "mocap-calib: --scheduler: expected the package dask, found none; "
        "pip install 'mocap-calib[distributed]'\n"
    )
