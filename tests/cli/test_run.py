"""`run` and its stages through real processes and pipes: files, messages, a user's mistakes."""

import json
import re
import shutil
import tomllib
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml
from report_pages import timeless_run
from scenes import rotation_errors_deg

import mocap_calib as mc


def provenance(path: Path) -> dict:
    """What a file of cameras says of itself."""
    return yaml.safe_load(path.read_text("utf-8"))["provenance"]


def test_run_says_only_data_on_stdout(done):
    _, said = done
    assert said.returncode == 0, said.stderr
    report = json.loads(said.stdout)
    assert list(report)[:2] == ["schema", "verdict"]
    assert set(report) >= {"version", "seed", "config", "inputs", "seconds", "cameras", "pairs"}
    assert set(report) >= {"adjust", "individuals", "points"}
    assert all(len(digest) == 64 for digest in report["inputs"].values())
    assert len(report["pairs"]) == 3


def test_stages_and_results_are_said_in_lines(done):
    _, said = done
    assert re.search(r"^cam1 +\S+cam1\.json +30 +\d+$", said.stderr, re.M)
    assert "30 frames; 17 joints, the model of people knows 17\n" in said.stderr
    assert "camera  detections  matched  error px  sigma deg  sigma %  clock  faults" in said.stderr
    assert re.search(r"^adjust: done in \d+\.\d s \(needed \d of at most \d+ steps\)$",
                     said.stderr, re.M)  # fmt: skip
    assert re.search(r"^pairwise: done in \d+\.\d s$", said.stderr, re.M)
    assert re.search(r"^world: .*; no scale is set: give a known length", said.stderr, re.M)
    assert re.search(r"^camera uncertainty \(1 SD\): 0\.\d\d deg, worst ", said.stderr, re.M)


def test_run_calibrates_and_evaluate_says_so(done, small, tool):
    """Measured 0.1 degrees."""
    out, _ = done
    words = ("evaluate", out / "cameras.yaml", "--reference", small / "reference.toml")
    figures = json.loads(tool(*words, "--json").stdout)
    assert figures["rotation_error_deg"]["max"] < 0.5
    assert figures["centre_error"]["max"] < 0.05
    truth, found = mc.read_rig(small / "reference.toml"), mc.read_rig(out / "calibration.toml")
    worst = rotation_errors_deg(found, truth).max()
    assert figures["rotation_error_deg"]["max"] == pytest.approx(worst, abs=1e-6)
    lines = tool(*words).stdout.splitlines()
    assert lines[0].split() == ["pair", "E_R", "deg", "E_t", "deg"]
    assert float(lines[5].split()[1]) == pytest.approx(worst, abs=0.006)
    assert len({len(line) for line in lines[:6]}) == 1  # numbers end where their heading does


def test_outputs_are_what_they_should_be(done):
    """Files of formats that others read are held by tests/io and tests/golden."""
    out, _ = done
    report = json.loads((out / "run.json").read_text("utf-8"))
    assert report["date"].endswith("Z")
    for camera in yaml.safe_load((out / "cameras.yaml").read_text())["cameras"]:
        moved = np.array(camera["R"]) @ camera["centre"] + camera["t"]
        np.testing.assert_allclose(moved, 0, atol=1e-9)
    for name in ("cameras.yaml", "calibration.toml"):
        text = (out / name).read_text("utf-8")
        assert text.startswith(f"# mocap-calib: this rig is {report['verdict']['rig']}")
        assert not re.search(r"-0\.0\b", text)
    anipose = tomllib.loads((out / "calibration.toml").read_text("utf-8"))["metadata"]
    assert anipose == {"adjusted": True, "error": report["points"]["mean_error_px"]} | anipose
    with h5py.File(out / "poses3d.h5") as file:
        assert file["position"].shape == (30, 2, 17, 3)
        names = [name.decode() for name in file["keypoint_names"]]
        edges = {frozenset((names[a], names[b])) for a, b in file["edges"]}
        assert all({"axes", "unit", "meaning"} <= set(item.attrs) for item in file.values())
    assert frozenset(("left_knee", "left_ankle")) in edges
    tables = ["matches.csv", "poses3d_0.csv", "poses3d_1.csv"]
    assert sorted(file.name for file in out.glob("*.csv")) == tables
    assert not list(out.parent.glob(".*"))


@pytest.mark.slow
def test_the_stages_through_pipes_are_the_run(small, tool, tmp_path):
    """To the last digit: what passes between stages is written with all its digits."""
    keypoints, out = small / "keypoints", tmp_path / "out"
    cameras = ("--cameras", small / "intrinsics.toml")
    run = ("run", keypoints, *cameras, "-o", out, "-q", "--world", "first-camera")
    assert tool(*run).returncode == 0
    pairs = tool("pairwise", keypoints, *cameras, "-q").stdout
    rig = tmp_path / "rig.yaml"
    rig.write_text(tool("average", "-", stdin=pairs).stdout)
    labels = tool("match", keypoints, "--rig", rig, "-q").stdout
    matches = tmp_path / "a.csv"
    words = ("adjust", keypoints, "--rig", rig, "--matches", "-", "--matches-out", matches, "-q")
    adjusted = tool(*words, stdin=labels)
    assert adjusted.returncode == 0, adjusted.stderr
    (tmp_path / "cameras.yaml").write_text(adjusted.stdout)
    one, other = mc.read_rig(tmp_path / "cameras.yaml"), mc.read_rig(out / "cameras.yaml")
    assert one.rotation.tobytes() == other.rotation.tobytes()
    assert one.translation.tobytes() == other.translation.tobytes()
    assert matches.read_text() == (out / "matches.csv").read_text()
    for command, name in (("smooth", "p.h5"), ("smooth", "p.csv"), ("triangulate", "raw.h5")):
        words = (command, keypoints, "--rig", "-", "--matches", matches, "-o", tmp_path / name)
        said = tool(*words, "-q", stdin=adjusted.stdout)
        assert said.returncode == 0, said.stderr
    for individual in range(2):
        name = f"poses3d_{individual}.csv"
        assert (tmp_path / f"p_{individual}.csv").read_text() == (out / name).read_text()
    smooth, raw, whole = (
        mc.read_poses(path) for path in (tmp_path / "p.h5", tmp_path / "raw.h5", out / "poses3d.h5")
    )
    np.testing.assert_array_equal(smooth.positions, whole.positions)
    np.testing.assert_array_equal(smooth.source, whole.source)
    np.testing.assert_array_equal(raw.positions, whole.raw)


def test_stages_keep_to_the_frames_that_the_rig_of_a_moved_camera_holds_for(
    done, small, tool, tmp_path
):
    keypoints, matches = small / "keypoints", done[0] / "matches.csv"
    rig = tmp_path / "cameras.yaml"

    def hold_for(frames: str) -> None:
        text = (done[0] / "cameras.yaml").read_text()
        rig.write_text(text.replace("provenance:\n", f"provenance:\n  frames: {frames}\n"))

    hold_for("[7, 12]")
    for command in ("triangulate", "smooth"):
        poses = tmp_path / f"{command}.h5"
        said = tool(command, keypoints, "--rig", rig, "--matches", matches, "-o", poses)
        assert "frames 7 to 12: a camera was moved" in said.stderr
        assert mc.read_poses(poses).frames.tolist() == list(range(7, 13))
    new = tmp_path / "adjusted.yaml"
    # six frames determine a rig weakly, or not at all
    tool("adjust", keypoints, "--rig", rig, "--matches", matches, "-o", new, "-q")
    assert provenance(new)["frames"] == [7, 12]
    assert "holds for the frames 7 to 12" in provenance(new)["remarks"]
    hold_for("[1007, 1012]")
    said = tool("match", keypoints, "--rig", rig, "-q")
    assert (said.returncode, said.stdout) == (1, "")
    assert "--rig: expected frames 1007 to 1012" in said.stderr
    assert "found 0 to 29; give the rig of these frames" in said.stderr


@pytest.mark.slow
def test_same_seed_same_bytes_and_a_rerun_replaces(done, small, tool, tmp_path):
    """What an earlier run lists is taken away; what is somebody's own stays, whatever its name."""
    first, _ = done
    again = tmp_path / "out"
    cameras = ("--cameras", small / "intrinsics.toml")
    words = ("run", small / "keypoints", *cameras, "-o", again, "--quiet")
    assert tool(*words, "--write", "colmap").returncode == 0
    assert (again / "colmap").is_dir()
    own = ("calibration_reversed.toml", "poses3d_4.csv", "poses3d_2024.csv", "notes.txt")
    for name in own:
        (again / name).write_text("mine")
    said = tool(*words)
    assert (said.returncode, said.stdout, said.stderr) == (0, "", "")
    for file in first.iterdir():
        if file.name != "run.json":
            assert file.read_bytes() == (again / file.name).read_bytes(), file.name
    reports = [json.loads((folder / "run.json").read_text()) for folder in (first, again)]
    assert len({report["date"] for report in reports}) == 2
    assert timeless_run(reports[0]) == timeless_run(reports[1])
    written = {file.name for file in first.iterdir()}
    assert {file.name for file in again.iterdir()} == {*written, *own}
    assert {(again / name).read_text() for name in own} == {"mine"}


@pytest.mark.slow
def test_a_run_without_intrinsics_writes_what_it_estimated(tool, small, tmp_path):
    """Focal lengths of the scene are 0.79 to 0.91 image widths, here shared."""
    done = tool("run", small / "keypoints", "-o", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "no intrinsics were given" in done.stderr
    report = json.loads((tmp_path / "run.json").read_text())
    assert report["config"]["intrinsics"]["refine"] == "focal+k1"
    written = yaml.safe_load((tmp_path / "cameras.yaml").read_text())["cameras"]
    for file, camera in zip(written, report["cameras"], strict=True):
        found = camera["intrinsics"]
        assert found["source"] == "estimated"
        assert 0.75 < found["focal_px"] / 1280 < 0.95
        assert file["estimated"]["focal_sigma"] == found["focal_sigma_px"]


# --- a user's mistake: one line on stderr, exit 1, nothing on stdout, nothing written. More of them
# are in tests/golden/refusals.py


def edit(folder: Path, change) -> None:
    """Change what the keypoint file of each camera holds."""
    for path in (folder / "keypoints").iterdir():
        content = json.loads(path.read_text())
        change(content, path.stem)
        path.write_text(json.dumps(content))


def name_joints(content: dict, camera: str, *, name: str) -> None:
    content["categories"][0]["keypoints"] = [name.format(k, camera) for k in range(17)]


def take_turns(content: dict, camera: str) -> None:
    """Keep each third frame of a camera."""
    seen = [each for each in content["annotations"] if each["image_id"] % 3 == int(camera[-1]) - 1]
    content["annotations"] = seen


RUN = "run keypoints --cameras intrinsics.toml -o out -q"
MATCHES = "triangulate keypoints --rig reference.toml --matches m.csv -q -o p.h5"
UNREAD = "triangulate k --rig r --matches m.csv -o "  # the place of the output is looked at first


@pytest.mark.parametrize(
    ("line", "change", "reason"),
    [
        (RUN, partial(name_joints, name="joint{}of{}"), "joint"),
        (RUN, partial(name_joints, name="x{}"), "--skeleton"),
        (RUN, take_turns, "co-visible"),
        (f"{RUN} --skeleton mine.yaml", None, "proboscis"),
        (RUN.replace(" out", " m.csv"), None, "m.csv"),
        (MATCHES, None, "cam9"),
        (f"{UNREAD}p.txt", None, "expected a name that ends in .h5 or .csv, found .txt; rename it"),
        (f"{UNREAD}folder.h5", None, "expected a file to write, found a folder; give a name"),
        (f"{UNREAD}m.csv/p.h5", None, "expected a folder, found a file; choose another path"),
    ],
)
def test_a_mistake_is_one_line_and_earlier_results_stay(
    line, change, reason, small, tool, tmp_path
):
    folder = Path(shutil.copytree(small, tmp_path / "in"))
    for name in ("out", "folder.h5"):
        (folder / name).mkdir()
    (folder / "out" / "cameras.yaml").write_text("earlier")
    (folder / "mine.yaml").write_text("aliases: {nose: proboscis}")
    (folder / "m.csv").write_text("camera,frame,instance,individual\ncam9,0,0,0\n")
    if change:
        edit(folder, change)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    said = tool(*line.split(), cwd=folder)
    assert (said.returncode, said.stdout, said.stderr.count("\n")) == (1, "", 1)
    assert said.stderr.startswith("mocap-calib: ")
    assert reason in said.stderr
    assert "expected" in said.stderr
    assert before == {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_what_is_left_out_of_a_recording_is_said(tool, tmp_path):
    names = ["nose", "left_eye", "right_eye", "left_ear"]
    for camera, frames, own in (("cam1", range(4), "right_ankle"), ("cam2", range(2, 5), "tail")):
        rows = [
            f"{frame},{name},{10 * k + frame},{5 + frame},1"
            for frame in frames
            for k, name in enumerate([*names, own])
        ]
        text = "\n".join(["frame,keypoint,x,y,score", *rows])
        (tmp_path / f"{camera}.csv").write_text(text)
    mc.write(mc.simulate(mc.SimulateConfig(cameras=3, frames=2)).rig, tmp_path / "rig.toml")
    said = tool("match", "cam1.csv", "cam2.csv", "--rig", "rig.toml", cwd=tmp_path).stderr
    assert "left out, in frames of a single camera: 3 detections\n" in said
    only = "not used, named by a single camera: 2 keypoints: right_ankle (cam1), tail (cam2)\n"
    assert only in said
