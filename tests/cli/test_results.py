"""What is done with results in a folder: `report` shows them again, `scale` sets their scale."""

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from report_pages import page_data, unpack

import mocap_calib as mc


@pytest.fixture
def results(done, tmp_path) -> Path:
    """A copy of the folder that `run` wrote."""
    return Path(shutil.copytree(done[0], tmp_path / "out"))


def hashes(folder: Path) -> dict[str, str]:
    """The SHA-256 of each file."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
    }


def read_run(folder: Path) -> dict:
    return json.loads((folder / "run.json").read_text("utf-8"))


def change_run(folder: Path, **changes: object) -> None:
    """Change run.json; None takes a key away."""
    run = read_run(folder) | changes
    kept = {key: value for key, value in run.items() if value is not None}
    (folder / "run.json").write_text(json.dumps(kept), "utf-8")


def read_page(path: Path) -> dict:
    return page_data(path.read_text("utf-8"))


def test_a_page_is_that_of_the_run_but_for_the_directions_of_ellipsoids(results, tool):
    before, files = read_page(results / "report.html"), hashes(results)
    (results / "report.html").unlink()
    done = tool("report", results)
    assert (done.returncode, done.stdout) == (0, "")
    assert f"report in {results / 'report.html'}" in done.stderr
    after = read_page(results / "report.html")
    assert {key for key in before if before[key] != after[key]} <= {"rig", "series", "fits"}
    for part in ("by_joint", "p95"):
        ours, theirs = (unpack(page["fits"][part]) for page in (before, after))
        assert np.allclose(ours, theirs, rtol=0.01, equal_nan=True)
    assert (before["rig"]["covariance"], after["rig"]["covariance"]) == ("axes", "spheres")
    for ours, theirs in zip(before["rig"]["cameras"], after["rig"]["cameras"], strict=True):
        assert np.allclose(ours["rotation"], theirs["rotation"], atol=1e-9)
        traces = [np.trace(np.reshape(each["covariance"], (3, 3))) for each in (ours, theirs)]
        assert traces[0] == pytest.approx(traces[1], rel=1e-4)  # cameras.yaml rounds
    # all files are those that run.json lists, and nothing else changed
    assert read_run(results)["outputs"]["report.html"] == hashes(results)["report.html"]
    changed = {name for name, content in hashes(results).items() if content != files[name]}
    assert changed <= {"report.html", "run.json"}


def test_a_page_without_the_keypoints_of_the_run_says_so(results, small, tool, tmp_path):
    kept = {"keypoints": [str(small / "keypoints")]}
    assert read_run(results)["reading"] == kept
    change_run(results, reading={"keypoints": [str(tmp_path / "gone")]})
    page = tmp_path / "page.html"
    done = tool("report", results, "-o", page)
    assert done.returncode == 0
    assert "the keypoints of the run could not be read" in done.stderr
    found = read_page(page)
    assert found["detections"] is None
    assert any("no keypoints were read" in note for note in found["notes"])
    assert tool("report", results, small / "keypoints", "-o", page).returncode == 0
    assert read_page(page)["detections"] is not None
    change_run(results, reading=None)  # as Python writes it
    assert tool("report", results, "-o", page, "-q").stderr == ""


def test_keypoints_are_read_as_the_run_read_them(results, small, tool, tmp_path):
    """But for what the cameras of results have already; what is typed now counts more."""
    page = tmp_path / "page.html"
    reading = {"keypoints": [str(small / "keypoints")], "frame_offset": ["cam1:5"]}
    seen = []
    for more, typed in (
        ({}, ()),
        ({}, ("--frame-offset", "cam1:0")),
        ({"rotated": ["cam1:90"]}, ()),
    ):
        change_run(results, reading=reading | more | {"layout": 3, "nonsense": "x"})
        assert tool("report", results, "-o", page, *typed).returncode == 0
        seen.append(read_page(page)["detections"])
    assert seen[0] == seen[2] != seen[1]
    change_run(results, reading=reading | {"frame_offset": ["cam1:x"]})
    done = tool("report", results, "-o", page)
    assert (done.returncode, "with a whole number" in done.stderr) == (2, True)


def test_another_rig_is_laid_over_it(results, small, tool, tmp_path):
    page = tmp_path / "page.html"
    words = ("report", results, "--reference", small / "reference.toml", "-o", page)
    assert tool(*words).returncode == 0
    errors = read_page(page)["reference"]["errors"]
    assert [each["name"] for each in errors] == ["cam1", "cam2", "cam3"]
    assert max(each["rotation_deg"] for each in errors) < 1  # measured 0.1


@pytest.mark.parametrize(
    ("line", "content", "said"),
    [
        ("report .", None, "expected a folder with run.json in it, found none"),
        ("report .", "[", "expected what `run` writes"),
        ("report .", '{"schema": 99, "cameras": [{"name": "a"}], "groups": [{}]}', "`schema` 3"),
        ("scale . --height 1.75", None, "expected the results of a run"),
        ("scale run.json --height 1.75", "{}", "run.json: expected the folder of a run, found a"),
    ],
)
def test_what_is_no_folder_of_results_is_refused(tmp_path, tool, line, content, said):
    if content is not None:
        (tmp_path / "run.json").write_text(content)
    done = tool(*line.split(), cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert said in done.stderr
    assert {path.name for path in tmp_path.iterdir()} <= {"run.json"}


def test_other_keypoints_and_other_cameras_are_refused(results, small, tool, tmp_path):
    before = hashes(results)
    for words, said in (
        ((tmp_path / "nowhere",), "expected a file or folder, found none"),
        ((small / "keypoints", "--frame-offset", "cam1:100000"), "expected"),
        (("--reference", small / "intrinsics.toml"), "expected extrinsics"),
    ):
        done = tool("report", results, *words)
        assert done.returncode == 1, done.stderr
        assert said in done.stderr.splitlines()[-1]
        assert hashes(results) == before


# --- scale


def test_scale_rewrites_cameras_poses_and_the_report_together(done, results, tool):
    before, poses = mc.read_rig(results / "cameras.yaml"), mc.read_poses(results / "poses3d.h5")
    assert before.unit == poses.unit == "arbitrary"
    said = tool("scale", results, "--camera-distance", "cam1-cam2=3.1")
    assert said.returncode == 0, said.stderr
    assert "lengths are in m, uncertain by " in said.stderr
    assert "\n  camera distance cam1-cam2: 3.1 m\n" in said.stderr
    assert f"report in {results / 'report.html'}\n" in said.stderr
    factor = 3.1 / np.linalg.norm(before.centres[1] - before.centres[0])
    for name in ("cameras.yaml", "calibration.toml"):
        rig = mc.read_rig(results / name)
        np.testing.assert_allclose(rig.centres, factor * before.centres, atol=1e-9)
        assert (rig.unit, rig.world.kind) == ("m", before.world.kind)
    verdicts = [
        yaml.safe_load((folder / "cameras.yaml").read_text())["provenance"]["verdict"]
        for folder in (results, done[0])
    ]
    assert verdicts[0] == verdicts[1]
    after = mc.read_poses(results / "poses3d.h5")
    np.testing.assert_allclose(after.positions, factor * poses.positions)
    one, other = (mc.read_poses(folder / "poses3d_0.csv") for folder in (results, done[0]))
    np.testing.assert_allclose(one.positions, factor * other.positions)
    run = read_run(results)
    assert (run["unit"], run["world"]["unit"], run["fingerprint"]) == ("m", "m", None)
    size = np.sqrt(((rig.centres - rig.centres.mean(0)) ** 2).sum(1).mean())
    for each in (*run["cameras"], *run["pairs"]):
        expected = each["centre_sigma_percent"] / 100 * size
        assert each["centre_sigma"] == pytest.approx(expected, rel=1e-6)
    assert [cue["metres"] for cue in run["world"]["cues"]] == [pytest.approx(3.1)]
    assert run["outputs"].items() <= hashes(results).items()


def test_scaled_results_are_scaled_again_and_known_units_are_left_alone(results, tool):
    names = "-".join(mc.read_rig(results / "cameras.yaml").names[:2])
    for length in (3.1, 3.0):
        said = tool("scale", results, "--camera-distance", f"{names}={length}")
        assert said.returncode == 0, said.stderr
    rig = mc.read_rig(results / "cameras.yaml")
    assert np.linalg.norm(rig.centres[1] - rig.centres[0]) == pytest.approx(3.0)
    assert [cue.metres for cue in rig.world.cues] == [3.0]
    before, run = hashes(results), (results / "run.json").read_text("utf-8")
    pairs = ("edited", {"pairs": ["a pair"]}, {"pairs": [{"centre_sigma": "small"}]})
    for content in pairs:
        text = content if content == "edited" else json.dumps({"cameras": []} | content)
        (results / "run.json").write_text(text, "utf-8")
        said = tool("scale", results, "--camera-distance", f"{names}=2")
        assert (said.returncode, said.stderr.count("\n")) == (1, 1)
        assert "expected what `run` writes" in said.stderr
    (results / "run.json").write_text(run, "utf-8")
    assert hashes(results) == before
    given = yaml.safe_load((results / "cameras.yaml").read_text("utf-8"))
    for change, refused in (
        ({"world": {**given["world"], "kind": "file", "cues": []}}, "by cameras whose places were"),
        ({"provenance": {**given["provenance"], "verdict": "not determined"}}, "is not determined"),
    ):
        (results / "cameras.yaml").write_text(yaml.safe_dump(given | change), "utf-8")
        said = tool("scale", results, "--height", "1.75")
        assert (said.returncode, said.stderr.count("\n")) == (1, 1)
        assert refused in said.stderr


@pytest.mark.parametrize("option", ["--unit", "--input-unit"])
def test_arbitrary_lengths_are_converted_to_no_unit(option, done, tool, tmp_path):
    said = tool("convert", done[0] / "poses3d.h5", tmp_path / "a.npz", option, "m")
    assert (said.returncode, said.stderr.count("\n")) == (1, 1)
    assert "mocap-calib scale" in said.stderr


# --- kinematics, and coordinates that are asked for


def test_kinematics_are_counted_and_written(done, tool, tmp_path):
    said = tool("kinematics", done[0], "--fps", 30, "-o", tmp_path / "k")
    assert said.returncode == 0, said.stderr
    line = said.stderr.splitlines()[-1]
    assert line.startswith("2 individuals in 30 frames: 1")
    assert line.endswith(f"; results in {tmp_path / 'k'}")
    assert {path.name for path in (tmp_path / "k").iterdir()} == {"kinematics.csv", "bones.csv"}


@pytest.mark.slow
def test_coordinates_are_those_of_landmarks_or_of_known_cameras(small, tool, tmp_path):
    """The world is said in a line, and its evidence below: landmarks, lengths."""
    cameras = ("--cameras", small / "intrinsics.toml", "--no-report", "--smooth", "off")
    words = ("run", small / "keypoints", *cameras, "-o")
    truth = mc.read_rig(small / "reference.toml")
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    rows = ["name,x,y,z,camera,u,v"]
    for camera, pixels in zip(truth.names, truth.project(corners), strict=True):
        for name, corner, (u, v) in zip("abcd", corners, pixels, strict=True):
            x, y, z = corner
            rows.append(f"{name},{x},{y},{z},{camera},{u:.2f},{v:.2f}")
    (tmp_path / "marks.csv").write_text("\n".join([*rows, "e,5,5,5,cam1,100,100"]))
    said = tool(*words, tmp_path / "a", "--align", tmp_path / "marks.csv")
    assert said.returncode == 0, said.stderr
    assert "; aligned to 4 landmarks, RMS distance " in said.stderr
    assert "; lengths are in m" in said.stderr
    assert " mm from its place\n" in said.stderr
    assert "  landmark e: not used, two cameras that agree on it are needed\n" in said.stderr
    found = mc.read_rig(tmp_path / "a" / "cameras.yaml")
    np.testing.assert_allclose(found.centres, truth.centres, atol=0.1)
    said = tool(*words, tmp_path / "b", "--world", small / "reference.toml")
    assert said.returncode == 0, said.stderr
    found = mc.read_rig(tmp_path / "b" / "cameras.yaml")
    np.testing.assert_allclose(found.centres, truth.centres, atol=0.1)
