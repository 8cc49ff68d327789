"""Many recordings, and what is left of a run that was killed."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import psutil
import pytest
from conftest import TOOL
from platforms import posix
from report_pages import timeless_run
from scenes import lifted, recording, scene

from mocap_calib import __version__
from mocap_calib.config import Config, PairwiseConfig
from mocap_calib.errors import ClusterError
from mocap_calib.io.results.pair_store import remember_pairs
from mocap_calib.io.results.pairs_json import pairs_to_json
from mocap_calib.io.results.scene import write_scene
from mocap_calib.job import steps
from mocap_calib.job.load import KeypointSource
from mocap_calib.job.steps import CalibrationRequest, find_finished
from mocap_calib.pairs.solve import calibrate_pairs
from mocap_calib.types import silent
from mocap_calib_cli.commands import batch as batch_module
from mocap_calib_cli.commands import run as run_module
from mocap_calib_cli.options import SharedOptions
from mocap_calib_cli.progress import Reporter
from mocap_calib_cli.recordings import make_requests
from mocap_calib_cli.workers import open_workers


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
def sessions(tmp_path_factory, small) -> Path:
    """Three recordings: two with intrinsics of their own, one a bare folder of keypoints."""
    folder = tmp_path_factory.mktemp("sessions")
    for seed, name in enumerate(("jump", "walk")):
        write_scene(
            folder / name, scene(cameras=3, people=1, frames=30, seed=seed), "made by a test"
        )
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


def batch(
    tool, sessions: Path, out: Path, *options: object, names=("jump", "small", "walk")
) -> subprocess.CompletedProcess[str]:
    return tool("batch", *names, "--cameras", "intrinsics.toml", "-o", out, *options, cwd=sessions)


@pytest.mark.slow
def test_batch_is_a_run_of_each(sessions, once, tool, tmp_path):
    for name, keypoints, cameras in (
        ("small", "small", "intrinsics.toml"),
        ("walk", "walk/keypoints", "walk/intrinsics.toml"),
    ):
        assert (
            tool(
                "run", keypoints, "--cameras", cameras, "-o", tmp_path / name, "-q", cwd=sessions
            ).returncode
            == 0
        )
        assert contents(once / name) == contents(tmp_path / name)


def test_what_is_finished_is_kept(sessions, once, tool):
    before = {path: path.stat().st_mtime_ns for path in once.rglob("*")}
    said = batch(tool, sessions, once, "--json")
    assert said.returncode == 0, said.stderr
    assert [(r["name"], r["status"]) for r in json.loads(said.stdout)["recordings"]] == [
        ("jump", "kept"),
        ("small", "kept"),
        ("walk", "kept"),
    ]
    assert {path: path.stat().st_mtime_ns for path in once.rglob("*")} == before
    assert "3 of 3 recordings" in said.stderr


def test_a_recording_that_fails_does_not_stop_the_others(sessions, once, tool, tmp_path):
    shutil.copytree(sessions, tmp_path / "in")
    shutil.copytree(once, tmp_path / "out")
    (tmp_path / "in" / "jump" / "keypoints" / "cam2.json").write_text("this is no JSON at all")
    said = batch(
        tool, tmp_path / "in", tmp_path / "out", "--json", "-q", names=("jump", "nobody", "small")
    )
    assert said.returncode == 1
    summary = json.loads(said.stdout)
    assert summary["failed"] == 2
    assert [r["status"] for r in summary["recordings"]] == ["failed", "failed", "kept"]
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


# what is asked for


def option_flags(command) -> set[str]:
    return {flag for each in command.params for flag in each.opts if flag.startswith("-")}


def test_batch_has_the_options_of_run():
    run, many = (option_flags(module.command) for module in (run_module, batch_module))
    assert many - run == {"--jobs"}
    assert run - many == {"--config", "--save-config"}  # batch reads those of each recording
    assert {"--layout", "--format", "--image-size", "--views", "--frame-offset"} < many
    assert {"--camera-regex", "--write", "--fps"} < many


def test_each_recording_is_read_and_written_as_was_asked(tmp_path):
    options = SharedOptions(
        cameras="i.toml",
        layout="a,b,c,d",
        format="openpose",
        image_size=("640x480",),
        views="A,B",
        frame_offset=("cam1:-1",),
        camera_regex="cam(.)",
        write=("colmap",),
        fps=("25",),
    )
    (tmp_path / "one" / "keypoints").mkdir(parents=True)
    context = click.Context(batch_module.command)
    (asked,) = make_requests(context, options, [str(tmp_path / "one")], tmp_path / "out")
    found = asked.keypoints.options
    assert asked.keypoints.paths == (str(tmp_path / "one" / "keypoints"),)
    assert (asked.keypoints.format, found.layout) == ("openpose", tuple("abcd"))
    assert (found.image_size, found.views) == ((640, 480), ("A", "B"))
    assert (found.frame_offset, found.camera_pattern) == ({"cam1": -1}, "cam(.)")
    assert (asked.formats, asked.fps, asked.output) == (("colmap",), 25.0, tmp_path / "out" / "one")


@pytest.fixture
def without_dask(monkeypatch) -> Iterator[None]:
    """As if Dask were not installed; the commands' answer to SIGTERM is taken back."""
    before = signal.getsignal(signal.SIGTERM)
    for package in ("dask", "distributed"):
        monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delitem(sys.modules, "mocap_calib.compute.cluster", raising=False)
    monkeypatch.delattr("mocap_calib.compute.cluster", raising=False)
    yield
    signal.signal(signal.SIGTERM, before)


@pytest.mark.usefixtures("without_dask")
def test_processes_of_this_machine_need_no_dask():
    with open_workers(Reporter(quiet=True), processes=2) as workers:
        found = [result() for _, result in workers.completed(abs, [-1, -2, -3])]
        assert sorted(found) == [1, 2, 3]


@pytest.mark.usefixtures("without_dask")
def test_a_scheduler_needs_dask_and_that_is_one_line():
    workers = open_workers(Reporter(quiet=True), scheduler="tcp://127.0.0.1:1")
    with (
        pytest.raises(ClusterError, match=r"^--scheduler: expected the package dask, found none"),
        workers,
    ):
        pass


# what counts as finished


@pytest.fixture
def asked(done, small, tmp_path) -> CalibrationRequest:
    """What the run `done` was asked for, with copies of its files and results to spoil."""
    shutil.copytree(done[0], tmp_path / "out")
    return CalibrationRequest(
        keypoints=KeypointSource((str(small / "keypoints"),)),
        cameras=small / "intrinsics.toml",
        output=tmp_path / "out",
    )


def damage(name: str):
    def change(asked: CalibrationRequest, _) -> CalibrationRequest:
        path = asked.output / name
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
        return asked

    return change


def remove(name: str):
    def change(asked: CalibrationRequest, _) -> CalibrationRequest:
        (asked.output / name).unlink()
        return asked

    return change


def other_input(asked: CalibrationRequest, _) -> CalibrationRequest:
    """Files of the same names that hold the same but for a line's end."""
    report = asked.output / "run.json"
    folder = asked.output.parent / "in"
    shutil.copytree(Path(asked.keypoints.paths[0]).parent, folder)
    moved = replace(
        asked,
        keypoints=KeypointSource((str(folder / "keypoints"),)),
        cameras=folder / "intrinsics.toml",
    )
    found = json.loads(report.read_text())
    fingerprint = moved.fingerprint(moved.hash_inputs(), "people")
    report.write_text(json.dumps(found | {"fingerprint": fingerprint}))
    assert find_finished(moved)
    with (folder / "keypoints" / "cam1.json").open("a") as file:
        file.write("\n")
    return moved


def other_config(asked: CalibrationRequest, _) -> CalibrationRequest:
    return replace(asked, config=Config(pairwise=PairwiseConfig(candidates_searched=401)))


def other_weights(asked: CalibrationRequest, monkeypatch) -> CalibrationRequest:
    monkeypatch.setattr(steps, "identify_model", lambda _: "0" * 64)
    return asked


def other_code(asked: CalibrationRequest, monkeypatch) -> CalibrationRequest:
    """The same version, as after a change of the checkout."""
    same_version = f"{__version__} (code {'0' * 12})"
    monkeypatch.setattr(steps, "identify_program", lambda: same_version)
    return asked


def other_model(asked: CalibrationRequest, _) -> CalibrationRequest:
    return replace(asked, keypoints=replace(asked.keypoints, model="none"))


def other_reading(**changes):
    def change(asked: CalibrationRequest, _) -> CalibrationRequest:
        options = replace(asked.keypoints.options, **changes)
        return replace(asked, keypoints=replace(asked.keypoints, options=options))

    return change


CHANGES = [
    *(damage(name) for name in ("cameras.yaml", "poses3d.h5", "poses3d_1.csv")),
    *(remove(name) for name in ("matches.csv", "run.json")),
    lambda asked, _: replace(asked, seed=1),
    lambda asked, _: replace(asked, pair_solver="paper"),
    other_model,
    other_reading(layout=("nose", "neck")),
    other_reading(image_size=(640, 480)),
    other_reading(views=("A", "B")),
    other_reading(frame_offset={"cam1": 1}),
    other_reading(camera_pattern="cam."),
    lambda asked, _: replace(asked, keypoints=replace(asked.keypoints, format="coco")),
    lambda asked, _: replace(asked, formats=("colmap",)),
    lambda asked, _: replace(asked, fps=30.0),
    other_input,
    other_config,
    other_weights,
    other_code,
]


@pytest.mark.parametrize("change", CHANGES)
def test_finished_is_told_by_content(change, asked, monkeypatch):
    fingerprint = asked.fingerprint(asked.hash_inputs(), "people")
    assert find_finished(asked)["fingerprint"] == fingerprint
    assert find_finished(change(asked, monkeypatch)) is None


# killed


@posix
@pytest.mark.slow
# both moments, and signals with and without a farewell; all six pairs would take a minute
@pytest.mark.parametrize(
    ("way", "moment"),
    [
        ("SIGKILL", "small/.unfinished/*.json"),
        ("SIGTERM", "jump/run.json"),
    ],
    ids=["between-SIGKILL", "writing-SIGTERM"],
)
def test_a_batch_goes_on_where_it_was_killed(way, moment, sessions, once, tool, tmp_path):
    """Killed amid the second recording, or while the first one's results appear.

    The second call leaves the same bytes as a batch that nothing disturbed.
    """
    out = tmp_path / "out"
    names = ("jump", "small", "walk")
    process = subprocess.Popen(
        [TOOL, "batch", *names, "--cameras", "intrinsics.toml", "-o", out],
        cwd=sessions,
        stderr=subprocess.PIPE,
        text=True,
    )
    wait_for(out, moment, 1, process)
    process.send_signal(signal.Signals[way])
    _, said = process.communicate()
    expected = {"SIGKILL": -signal.SIGKILL, "SIGTERM": 128 + signal.SIGTERM, "SIGINT": 130}
    assert process.returncode == expected[way]
    assert "Traceback" not in said
    if way != "SIGKILL":
        assert [
            path.name for path in out.iterdir() if path.name.startswith(".")
        ] == [] or moment == "jump/run.json"  # amid taking it away
    said = batch(tool, sessions, out, "--json")
    assert said.returncode == 0, said.stderr
    status = {r["name"]: r["status"] for r in json.loads(said.stdout)["recordings"]}
    assert status["walk"] == "done"
    assert status["jump"] == "kept" or moment == "jump/run.json"
    for name in names:
        assert contents(out / name) == contents(once / name)


@posix
@pytest.mark.slow
def test_processes_end_with_a_batch_that_is_interrupted(sessions, once, tool, tmp_path):
    """The second call goes on, with the same bytes as in one process."""
    out = tmp_path / "out"
    command = ["batch", "jump", "small", "walk", "--cameras", "intrinsics.toml", "-o", out]
    process = subprocess.Popen(
        [TOOL, *command, "--jobs", "2"], cwd=sessions, stderr=subprocess.PIPE, text=True
    )
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
    status = [r["status"] for r in json.loads(done.stdout)["recordings"]]
    assert status.count("done") >= 1
    for name in ("jump", "small", "walk"):
        assert contents(out / name) == contents(once / name)


@pytest.mark.slow
def test_a_run_goes_on_where_it_was_killed(tool, tmp_path):
    write_scene(tmp_path, scene(cameras=5, people=2, frames=30), "made by a test")
    command = ["run", tmp_path / "keypoints", "--cameras", tmp_path / "intrinsics.toml", "-q", "-o"]
    process = subprocess.Popen([TOOL, *command, tmp_path / "out"])
    wait_for(tmp_path / "out" / ".unfinished", "*.json", 3, process)
    process.kill()
    process.wait()
    assert len(list((tmp_path / "out" / ".unfinished").glob("*.json"))) < 10
    assert not (tmp_path / "out" / "run.json").exists()
    for out in ("out", "whole/out"):  # the name of the folder is the title of report.html
        assert tool(*command, tmp_path / out).returncode == 0
    # and nothing is left of the first attempt
    assert contents(tmp_path / "out") == contents(tmp_path / "whole/out")


@pytest.mark.slow
def test_pairs_found_before_are_not_made_again(tmp_path):
    made = []

    def counting(function, items):
        for item in items:
            made.append(item)
            yield function(item)

    def pairs(seed: int = 0, method: str = "") -> str:
        made.clear()
        mapper = remember_pairs(counting, tmp_path, method)
        found = calibrate_pairs(
            recording(),
            lifted(),
            PairwiseConfig(),
            rng=np.random.default_rng(seed),
            progress=silent,
            mapper=mapper,
        )
        return pairs_to_json(found, recording().cameras)

    first = pairs()
    assert len(made) == 6
    assert pairs() == first
    assert len(made) == 0
    files = sorted(tmp_path.iterdir())
    files[0].unlink()
    files[1].write_bytes(files[1].read_bytes()[:-9])  # as a full disk may leave it
    assert pairs() == first
    assert len(made) == 2
    for change in ({"seed": 1}, {"method": "other weights"}):
        pairs(**change)
        assert len(made) == 6


@pytest.mark.slow
def test_the_number_of_threads_does_not_change_a_byte(small, tmp_path):
    for threads in ("1", "2"):
        said = subprocess.run(
            [
                TOOL,
                "run",
                small / "keypoints",
                "--cameras",
                small / "intrinsics.toml",
                "-o",
                tmp_path / threads / "out",
                "-q",
            ],
            env=os.environ | {"OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads},
            check=False,
        )
        assert said.returncode == 0
    assert contents(tmp_path / "1/out") == contents(tmp_path / "2/out")
