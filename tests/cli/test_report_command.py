"""mocap-calib report: the page of results, made again from their folder."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from report_pages import page_data, unpack, unpack_text

from mocap_calib.geometry.rotation import rig_size
from mocap_calib.io.cameras.read import read_rig
from mocap_calib.io.hashing import hash_file, hash_files
from mocap_calib_cli.commands import report
from mocap_calib_cli.options import READING, SharedOptions
from mocap_calib_cli.reading import describe_reading, options_of_reading


@pytest.fixture
def results(done, tmp_path) -> Path:
    """A copy of the folder that `run` wrote."""
    return Path(shutil.copytree(done[0], tmp_path / "out"))


def call(*words: object):
    return CliRunner().invoke(report.command, [*map(str, words)])


def read_page(path: Path) -> dict:
    return page_data(path.read_text("utf-8"))


def test_it_is_that_of_the_run_but_for_the_directions_of_ellipsoids(results):
    before, files = read_page(results / "report.html"), hash_files(results)
    (results / "report.html").unlink()
    done = call(results)
    assert (done.exit_code, done.stdout) == (0, "")
    assert f"report in {results / 'report.html'}" in done.stderr
    after = read_page(results / "report.html")
    assert {key for key in before if before[key] != after[key]} <= {"rig", "series", "fits"}
    for part in ("by_joint", "p95"):
        ours, theirs = (unpack(page["fits"][part]) for page in (before, after))
        assert np.allclose(ours, theirs, rtol=0.01, equal_nan=True)
    assert (before["rig"]["covariance"], after["rig"]["covariance"]) == ("axes", "spheres")
    size = rig_size(read_rig(results / "cameras.yaml"))
    told = json.loads(unpack_text(after["run"]))["cameras"]
    for ours, theirs, camera in zip(
        before["rig"]["cameras"], after["rig"]["cameras"], told, strict=True
    ):
        assert np.allclose(ours["rotation"], theirs["rotation"], atol=1e-9)
        traces = [np.trace(np.reshape(each["covariance"], (3, 3))) for each in (ours, theirs)]
        assert traces[0] == pytest.approx(traces[1], rel=1e-4)  # cameras.yaml rounds
        percent = 100 * np.sqrt(traces[1]) / size
        assert percent == pytest.approx(camera["centre_sigma_percent"], rel=1e-4)
    # all files are those that run.json lists, and nothing else changed
    listed = json.loads((results / "run.json").read_text("utf-8"))["outputs"]
    assert listed["report.html"] == hash_file(results / "report.html")
    changed = {name for name, content in hash_files(results).items() if content != files[name]}
    assert changed == {"report.html", "run.json"}


def test_without_the_keypoints_of_the_run_it_says_so(results, small, tmp_path):
    run = json.loads((results / "run.json").read_text("utf-8"))
    assert run["reading"] == {"keypoints": [str(small / "keypoints")]}
    run["reading"]["keypoints"] = [str(tmp_path / "gone")]
    (results / "run.json").write_text(json.dumps(run), "utf-8")
    page = tmp_path / "page.html"
    done = call(results, "-o", page)
    assert done.exit_code == 0
    assert "the keypoints of the run could not be read" in done.stderr
    found = read_page(page)
    assert found["detections"] is None
    assert any("no keypoints were read" in note for note in found["notes"])
    again = call(results, small / "keypoints", "-o", page)
    assert again.exit_code == 0
    assert read_page(page)["detections"] is not None
    del run["reading"]  # as Python writes it
    (results / "run.json").write_text(json.dumps(run), "utf-8")
    assert call(results, "-o", page, "-q").stderr == ""


def test_another_rig_is_laid_over_it(results, small, tmp_path):
    page = tmp_path / "page.html"
    assert call(results, "--reference", small / "reference.toml", "-o", page).exit_code == 0
    errors = read_page(page)["reference"]["errors"]
    assert [each["name"] for each in errors] == ["cam1", "cam2", "cam3"]
    assert max(each["rotation_deg"] for each in errors) < 1  # measured 0.1


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "expected a folder with run.json in it, found none"),
        ("[", "expected what `run` writes"),
        ("{}", "expected what `run` writes"),
        ('{"schema": 99, "cameras": [{"name": "a"}], "groups": [{"folder": "."}]}', "`schema` 3"),
    ],
)
def test_what_is_no_folder_of_results_is_refused(tmp_path, tool, content, said):
    if content is not None:
        (tmp_path / "run.json").write_text(content)
    done = tool("report", tmp_path)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert said in done.stderr
    assert {path.name for path in tmp_path.iterdir()} <= {"run.json"}


def test_other_keypoints_and_other_cameras_are_refused(results, small, tool, tmp_path):
    before = hash_files(results)
    for words, said in (
        ((tmp_path / "nowhere",), "expected a file or folder, found none"),
        ((small / "keypoints", "--frame-offset", "cam1:100000"), "expected"),
        (("--reference", small / "intrinsics.toml"), "expected extrinsics"),
    ):
        done = tool("report", results, *words)
        assert done.returncode == 1, done.stderr
        assert said in done.stderr
        assert done.stderr.splitlines()[-1].startswith("mocap-calib: ")
        assert hash_files(results) == before


def test_how_keypoints_are_read_is_kept():
    typed = SharedOptions(
        keypoints=("a", "b"),
        layout="body_25",
        mirrored=("cam1",),
        rotated=("cam2:90",),
        skeleton=Path("s.yaml"),
        individuals=3,
        seed=4,
    )
    kept = json.loads(json.dumps(describe_reading(typed)))
    assert set(kept) == {"keypoints", "layout", "mirrored", "rotated", "skeleton"}
    again = options_of_reading(kept, SharedOptions(keypoints=("c",)))
    # the rig has what is known of intrinsics
    assert again == SharedOptions(
        keypoints=("c",), layout="body_25", mirrored=("cam1",), skeleton=Path("s.yaml")
    )
    assert options_of_reading({"layout": 3, "nonsense": "x"}, SharedOptions()) == SharedOptions()
    assert set(READING) < set(vars(typed))
