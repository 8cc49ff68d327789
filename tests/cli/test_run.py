"""`run` and its stages through real processes and pipes: files, messages, a user's mistakes."""

import csv
import json
import re
import shutil
import tomllib
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
    assert re.search(r"^world: .*; lengths are arbitrary: one that is known", said.stderr, re.M)
    assert re.search(r"^rotations are uncertain by 0\.\d\d deg|^camera unc", said.stderr, re.M)


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
    assert lines[4].startswith("median ")
    assert float(lines[5].split()[1]) == pytest.approx(worst, abs=0.006)
    assert len({len(line) for line in lines[:6]}) == 1  # numbers end where their heading does
    assert lines[-1].startswith("after alignment: rotation 0.")


def test_outputs_are_what_they_should_be(done):
    out, _ = done
    report = json.loads((out / "run.json").read_text("utf-8"))
    assert report["date"].endswith("Z")
    cameras = yaml.safe_load((out / "cameras.yaml").read_text())
    assert [c["name"] for c in cameras["cameras"]] == ["cam1", "cam2", "cam3"]
    for camera in cameras["cameras"]:
        assert {"size", "model", "K", "distortion", "R", "t", "centre"} <= set(camera)
        moved = np.array(camera["R"]) @ camera["centre"] + camera["t"]
        np.testing.assert_allclose(moved, 0, atol=1e-9)
    comment = f"# mocap-calib: this rig is {report['verdict']['rig']}"
    for name in ("cameras.yaml", "calibration.toml"):
        text = (out / name).read_text("utf-8")
        assert text.startswith(comment)
        assert not re.search(r"-0\.0\b", text)
    anipose = tomllib.loads((out / "calibration.toml").read_text("utf-8"))
    keys = {"name", "size", "matrix", "distortions", "rotation", "translation"}
    assert keys <= set(anipose["cam_0"])
    assert anipose["metadata"]["adjusted"]
    assert anipose["metadata"]["error"] == report["points"]["mean_error_px"]
    with h5py.File(out / "poses3d.h5") as file:
        assert file["position"].shape == (30, 2, 17, 3)
        assert file.attrs["unit"] == "arbitrary"
        names = [name.decode() for name in file["keypoint_names"]]
        edges = {frozenset((names[a], names[b])) for a, b in file["edges"]}
        assert all({"axes", "unit", "meaning"} <= set(item.attrs) for item in file.values())
    assert frozenset(("left_knee", "left_ankle")) in edges
    with (out / "matches.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["camera", "frame", "instance", "individual"]
    header = (out / "poses3d_0.csv").read_text().splitlines()[0].split(",")
    assert header[:6] == ["nose_x", "nose_y", "nose_z", "nose_error", "nose_ncams", "nose_score"]
    assert header[-1] == "fnum"
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
def test_adjust_takes_a_recording_with_an_overcrowded_frame(small, tool, tmp_path):
    """The frame is not in the sample, whose arrays hold fewer instances than the matches do."""
    keypoints = shutil.copytree(small / "keypoints", tmp_path / "keypoints")
    file = keypoints / "cam1.json"
    content = json.loads(file.read_text())
    one = content["annotations"][0]
    further = [one | {"id": 100_000 + k} for k in range(30)]
    file.write_text(json.dumps(content | {"annotations": content["annotations"] + further}))
    rig = small / "reference.toml"
    labels = tool("match", keypoints, "--rig", rig, "-q").stdout
    adjusted = tool("adjust", keypoints, "--rig", rig, "--matches", "-", "-q", stdin=labels)
    assert (adjusted.returncode, adjusted.stderr) == (0, "")


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
    out = tmp_path / "out"
    done = tool("run", small / "keypoints", "-o", out)
    assert done.returncode == 0, done.stderr
    assert "no intrinsics were given" in done.stderr
    report = json.loads((out / "run.json").read_text())
    assert report["config"]["intrinsics"]["refine"] == "focal+k1"
    written = yaml.safe_load((out / "cameras.yaml").read_text())["cameras"]
    for file, camera in zip(written, report["cameras"], strict=True):
        found = camera["intrinsics"]
        assert found["source"] == "estimated"
        assert 0.75 < found["focal_px"] / 1280 < 0.95
        assert file["estimated"]["focal_sigma"] == found["focal_sigma_px"]
        np.testing.assert_allclose(np.array(file["K"])[:2, 2], [639.5, 359.5])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("architecture", "errors"),
    [
        ("factorised", {"joint_3d", "steered_2d", "completed_2d"}),
        ("token", {"steered_2d", "identity_2d"}),
    ],
)
def test_training_reports_errors_as_data(architecture, errors, small, tool, tmp_path):
    truth = np.load(small / "truth.npz")
    poses = np.repeat(truth["poses3d"].reshape(-1, *truth["poses3d"].shape[-2:]), 2, axis=0)
    np.savez(tmp_path / "p.npz", poses=poses, joints=truth["joints"])
    weights = tmp_path / "w.safetensors"
    size = ("--steps", 3, "--batch", 8, "--width", 16, "--layers", 1)
    asked = ("train", tmp_path / "p.npz", "-o", weights, "--architecture", architecture)
    said = tool(*asked, *size, "--json", "-q")
    assert said.returncode == 0, said.stderr
    assert set(json.loads(said.stdout)) == errors
    assert weights.stat().st_size > 1000


# --- a user's mistake: one line on stderr, exit 1, nothing on stdout, nothing written


@pytest.fixture
def folder(small, tmp_path) -> Path:
    """A copy of the small recording to spoil."""
    return Path(shutil.copytree(small, tmp_path / "in"))


def edit(folder: Path, change, cameras=(1, 2, 3)) -> None:
    """Change the keypoint files of some cameras."""
    for k in cameras:
        path = folder / "keypoints" / f"cam{k}.json"
        content = json.loads(path.read_text())
        change(content, k)
        path.write_text(json.dumps(content))


def rename_joints(name: str):
    def change(content: dict, k: int) -> None:
        names = [name.format(joint=j, camera=k) for j in range(17)]
        content["categories"][0].update(keypoints=names)

    return lambda folder: edit(folder, change)


def no_overlap(content: dict, k: int) -> None:
    for image in content["images"]:
        image.update(file_name=f"frame_{1000 * k + image['id']:06d}.jpg")


def never_together(content: dict, k: int) -> None:
    seen = [each for each in content["annotations"] if each["image_id"] % 3 == k - 1]
    content.update(annotations=seen)


def other_image_size(content: dict, _: int) -> None:
    for image in content["images"]:
        image.update(width=1920, height=1080)


def write(name: str, text: str):
    return lambda folder: (folder / name).write_text(text)


def replace_in(name: str, old: str, new: str):
    def change(folder: Path) -> None:
        path = folder / name
        path.write_text(path.read_text().replace(old, new))

    return change


def cut(folder: Path) -> None:
    path = folder / "keypoints" / "cam1.json"
    path.write_text(path.read_text()[:5000])


def one_camera(folder: Path) -> None:
    for k in (2, 3):
        (folder / "keypoints" / f"cam{k}.json").unlink()


@pytest.mark.parametrize(
    ("spoil", "names"),
    [
        (lambda folder: shutil.rmtree(folder / "keypoints"), "keypoints"),
        (write("keypoints/cam1.json", "this is no JSON at all"), "cam1.json"),
        (cut, "cam1.json"),
        (rename_joints("joint{joint}of{camera}"), "joint"),
        (rename_joints("x{joint}"), "--skeleton"),
        (replace_in("intrinsics.toml", '"cam2"', '"other"'), "cam2"),
        (one_camera, "two"),
        (lambda folder: edit(folder, no_overlap), "1000"),
        (lambda folder: edit(folder, never_together), "co-visible"),
        (lambda folder: edit(folder, other_image_size, [1]), "1920"),
        (write("intrinsics.toml", "= = ="), "intrinsics.toml"),
        (write("out", "mine"), "out"),
    ],
)
def test_a_mistake_is_one_line_and_nothing_is_written(spoil, names, folder, tool):
    spoil(folder)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    cameras = ("--cameras", folder / "intrinsics.toml")
    said = tool("run", folder / "keypoints", *cameras, "-o", folder / "out", "--quiet")
    assert (said.returncode, said.stdout, said.stderr.count("\n")) == (1, "", 1)
    assert said.stderr.startswith("mocap-calib: ")
    assert names in said.stderr
    assert "expected" in said.stderr
    assert before == {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_failing_run_leaves_earlier_results_alone(folder, tool):
    (folder / "out").mkdir()
    (folder / "out" / "cameras.yaml").write_text("earlier")
    cut(folder)
    cameras = ("--cameras", folder / "intrinsics.toml")
    said = tool("run", folder / "keypoints", *cameras, "-o", folder / "out")
    assert said.returncode == 1
    assert [path.name for path in (folder / "out").iterdir()] == ["cameras.yaml"]
    assert (folder / "out" / "cameras.yaml").read_text() == "earlier"


@pytest.mark.parametrize(
    ("output", "said"),
    [
        ("p.txt", "expected a name that ends in .h5 or .csv, found .txt; rename it"),
        ("folder.h5", "expected a file to write, found a folder; give a name within it"),
        ("m.csv/p.h5", "expected a folder, found a file; choose another path"),
    ],
)
def test_a_place_that_cannot_be_written_is_refused_first(output, said, tool, tmp_path):
    (tmp_path / "folder.h5").mkdir()
    (tmp_path / "m.csv").touch()
    words = ("triangulate", "k", "--rig", "r", "--matches", "m.csv", "-o", output)
    done = tool(*words, cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert said in done.stderr


def test_matches_of_another_recording(folder, tool):
    (folder / "m.csv").write_text("camera,frame,instance,individual\ncam9,0,0,0\n")
    files = ("--rig", folder / "reference.toml", "--matches", folder / "m.csv")
    said = tool("triangulate", folder / "keypoints", *files, "-o", folder / "p.h5", "-q")
    assert said.returncode == 1
    assert "cam9" in said.stderr
    assert not (folder / "p.h5").exists()


def test_names_of_ones_own(folder, tool):
    """--skeleton maps joints that nobody has heard of; without it the model knows none."""
    content = json.loads((folder / "keypoints" / "cam1.json").read_text())
    names = content["categories"][0]["keypoints"]
    rename_joints("p{joint}")(folder)
    aliases = "".join(f"  p{j}: {name}\n" for j, name in enumerate(names))
    (folder / "mine.yaml").write_text("aliases:\n" + aliases)
    cameras = ("--cameras", folder / "intrinsics.toml")
    words = ("pairwise", folder / "keypoints", *cameras, "--skeleton", folder / "mine.yaml")
    said = tool(*words, "-o", folder / "pairs.json")
    assert said.returncode == 0, said.stderr
    assert "the model of people knows 17" in said.stderr
    (folder / "mine.yaml").write_text("aliases: {p0: proboscis}")
    said = tool(*words)
    assert (said.returncode, "proboscis" in said.stderr) == (1, True)


# --- which files are read, and what is said of them

POINTS = "frame,keypoint,x,y,score\n"


def write_points(
    path: Path, frames: range, names: str = "nose left_eye right_eye left_ear"
) -> None:
    """Write points of a few joints as a table."""
    rows = [f"{n},{name},{10 * k + n},{5 + n},1\n" for n in frames
            for k, name in enumerate(names.split())]  # fmt: skip
    path.write_text(POINTS + "".join(rows))


def test_what_is_left_out_of_a_recording_is_said(tool, tmp_path):
    write_points(tmp_path / "a.csv", range(4), "nose left_eye right_eye left_ear right_ankle")
    write_points(tmp_path / "b.csv", range(2, 5), "nose left_eye right_eye left_ear tail")
    cameras = mc.read_cameras(Path(__file__).parents[2] / "examples/three_people/intrinsics.toml")
    rig = tmp_path / "rig.toml"
    poses = mc.simulate(mc.SimulateConfig(cameras=3, frames=2)).rig
    mc.write(poses, rig)
    assert len(cameras) == 4
    named = [f"cam1={tmp_path / 'a.csv'}", f"cam2={tmp_path / 'b.csv'}"]
    said = tool("match", *named, "--rig", rig).stderr
    assert "left out, in frames of a single camera: 3 detections\n" in said
    only = "not used, named by a single camera: 2 keypoints: right_ankle (cam1), tail (cam2)\n"
    assert only in said
    assert re.search(r"^cam3 +\(no keypoint file\)|left out", said, re.M)


def test_a_run_without_sizes_says_what_to_do(tool, tmp_path):
    (tmp_path / "keypoints").mkdir()
    for camera in ("a", "b"):
        write_points(tmp_path / "keypoints" / f"{camera}.csv", range(1))
    done = tool("run", tmp_path / "keypoints", "-o", tmp_path / "out", "--quiet")
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (1, "", 1)
    assert "--image-size a:WIDTHxHEIGHT" in done.stderr
    assert not (tmp_path / "out").exists()


def test_cameras_are_matched_by_name_not_by_place(small, tool, tmp_path):
    files = [f"{name}={small / 'keypoints' / (name + '.json')}" for name in ("cam3", "cam1")]
    cameras = ("--cameras", small / "intrinsics.toml")
    said = tool("pairwise", *files, *cameras, "-o", tmp_path / "pairs.json")
    assert said.returncode == 0, said.stderr
    assert [line.split()[:2] for line in said.stderr.splitlines() if "keypoints/" in line] == [
        ["cam1", str(small / "keypoints" / "cam1.json")],
        ["cam3", str(small / "keypoints" / "cam3.json")],
    ]
