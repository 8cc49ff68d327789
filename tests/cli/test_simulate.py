"""`simulate` and `example`: complete, readable, the same every time; and what their pages say."""

import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mocap_calib as mc

SHIPPED = Path(__file__).parents[2] / "examples" / "three_people"
FEW = ["--frames", "12", "--people", "2", "--cameras", "3", "--distortion", "fisheye"]
FEW += ["--seed", "7"]
SCENE = mc.SimulateConfig(frames=12, people=2, cameras=3, distortion="fisheye", seed=7)


def content(folder: Path) -> dict[str, bytes]:
    files = (file for file in folder.rglob("*") if file.is_file())
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in files}


@pytest.fixture(scope="module")
def written(tool, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("simulate") / "deep" / "scene"
    done = tool("simulate", "-o", folder, *FEW)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
    assert "3 cameras, 12 frames, 2 people" in done.stderr
    return folder


def check_scene(folder: Path, scene: mc.Scene) -> None:
    """The files of a folder say what the scene does, to the digits that they have."""
    with np.load(folder / "truth.npz", allow_pickle=False) as file:
        truth = dict(file)
    np.testing.assert_array_equal(truth["ids"], scene.identity)
    np.testing.assert_allclose(truth["poses3d"], scene.poses, atol=1e-6)
    assert tuple(truth["joints"]) == scene.joints
    rig = mc.read_rig(folder / "reference.toml")
    assert (rig.names, rig.unit) == (scene.rig.names, "m")
    np.testing.assert_allclose(rig.rotation, scene.rig.rotation, atol=1e-12)
    np.testing.assert_allclose(rig.translation, scene.rig.translation, atol=1e-12)
    cameras = mc.read_cameras(folder / "intrinsics.toml")
    for camera, known, file in zip(cameras, scene.rig.cameras, scene.files, strict=True):
        assert (camera.name, camera.size, camera.fisheye) == (known.name, known.size, known.fisheye)
        np.testing.assert_allclose(camera.matrix, known.matrix, atol=1e-9)
        np.testing.assert_allclose(camera.distortion, known.distortion, atol=1e-12)
        (read,) = mc.read_keypoints(folder / "keypoints" / f"{camera.name}.json")
        assert (read.keypoints, read.image_size) == (file.keypoints, camera.size)
        np.testing.assert_array_equal(read.frames, file.frames)
        instances = read.positions.shape[1]
        assert not np.isfinite(file.positions[:, instances:]).any()
        np.testing.assert_allclose(read.positions, file.positions[:, :instances], atol=0.0501)
        np.testing.assert_allclose(read.confidence, file.confidence[:, :instances], atol=0.00501)


def test_the_files_are_the_scene(written):
    files = {"README.md", "intrinsics.toml", "reference.toml", "truth.npz"}
    assert set(content(written)) == {*files, *(f"keypoints/cam{k}.json" for k in (1, 2, 3))}
    check_scene(written, mc.simulate(SCENE))
    assert "rotation" not in (written / "intrinsics.toml").read_text()


def test_same_command_same_bytes_and_it_may_be_repeated(written, tool, tmp_path):
    for _ in range(2):
        assert tool("simulate", "-o", tmp_path / "again", *FEW, "--quiet").stderr == ""
        assert content(tmp_path / "again") == content(written)
    assert [file.name for file in tmp_path.iterdir()] == ["again"]  # nothing temporary is left


def test_keypoints_of_other_cameras_are_not_mixed_in(tool, tmp_path):
    assert tool("simulate", "-o", tmp_path, *FEW).returncode == 0
    before = content(tmp_path)
    done = tool("simulate", "-o", tmp_path, *FEW, "--cameras", "2")
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "cam3.json" in done.stderr
    assert content(tmp_path) == before


QUICK = "--frames 2 --cameras 2"


@pytest.mark.parametrize(
    ("typed", "repeated", "bodies"),
    [
        ("--kind people:2", "--people 2 --seed 0", "2 people"),
        ("--kind bird --kind bird:2", "--kind bird:3 --seed 0", "3 birds"),
        ("--people 1 --kind rodent", "--people 1 --kind rodent:1 --seed 0", "1 person, 1 rodent"),
        (
            "--noise 1 --arc 90 --no-shuffle --false-detections 0 --seed 3",
            "--arc 90.0 --noise 1.0 --false-detections 0.0 --no-shuffle --seed 3",
            "3 people",
        ),
    ],
)
def test_the_command_of_the_page_makes_the_same_scene(typed, repeated, bodies, tool, tmp_path):
    """It names what is unusual alone. Kinds of bodies are chosen, and may be repeated."""
    done = tool("simulate", "-o", tmp_path / "one", *QUICK.split(), *typed.split())
    assert done.returncode == 0, done.stderr
    assert f"2 cameras, 2 frames, {bodies}, " in done.stderr
    page = (tmp_path / "one" / "README.md").read_text()
    (command,) = re.findall(r"mocap-calib (simulate -o OUT [^`\n]*)", page)
    assert command == f"simulate -o OUT --cameras 2 --frames 2 {repeated}"
    words = command.replace("OUT", str(tmp_path / "two")).split()
    assert tool(*words).returncode == 0
    assert content(tmp_path / "one") == content(tmp_path / "two")


def test_a_mixed_scene_is_written_with_its_truth(tool, tmp_path):
    done = tool("simulate", "-o", tmp_path, *FEW, "--kind", "quadruped")
    assert done.returncode == 0, done.stderr
    assert "mocap-calib run --model people" in done.stderr
    check_scene(tmp_path, mc.simulate(replace(SCENE, animals=(("quadruped", 1),))))
    with np.load(tmp_path / "truth.npz") as file:
        assert file["kinds"].tolist() == ["people", "people", "quadruped"]


def test_the_example_that_is_shipped_is_what_its_command_makes():
    check_scene(SHIPPED, mc.simulate(mc.SimulateConfig(distortion="brown")))
    command = "mocap-calib simulate -o OUT --distortion brown --seed 0"
    assert command in (SHIPPED / "README.md").read_text()
    assert sum(map(len, content(SHIPPED).values())) < 2e6


# --- example


@pytest.mark.parametrize("name", ["people", "dog", "mouse"])
def test_each_example_is_small_complete_and_the_same_every_time(name, tool, tmp_path):
    """The second time it lies in a folder of its name; what is there already is no obstacle."""
    assert name in [line.split()[0] for line in tool("example").stdout.splitlines()]
    for words in (("-o", "one"), (), ("-o", "one")):
        assert tool("example", name, *words, cwd=tmp_path).returncode == 0
    files = content(tmp_path / "one")
    assert files == content(tmp_path / name)
    assert {"README.md", "intrinsics.toml", "reference.toml", "keypoints/cam1.json"} <= set(files)
    assert sum(map(len, files.values())) < 500_000  # measured 373,000 for two people


def test_files_of_others_are_left_alone(tool, tmp_path):
    (tmp_path / "README.md").write_text("mine", "utf-8")
    done = tool("example", "dog", "-o", tmp_path)
    assert (done.returncode, "expected a new folder" in done.stderr) == (1, True)
    assert content(tmp_path) == {"README.md": b"mine"}


@pytest.mark.slow
def test_the_commands_of_its_readme_work(tool, tmp_path):
    """Measured 0.06 degrees for the worst pair of cameras; 0.05 of people, 0.10 of the mouse."""
    tool("example", "dog", "-o", tmp_path)
    readme = (tmp_path / "README.md").read_text("utf-8")
    commands = re.findall(r"^    mocap-calib (.*)$", readme, re.MULTILINE)
    assert len(commands) == 3
    inspected, ran, evaluated = (tool(*shlex.split(words), cwd=tmp_path) for words in commands)
    assert inspected.returncode == ran.returncode == evaluated.returncode == 0
    assert "nothing stands in the way" in inspected.stdout
    assert "rig well determined" in ran.stderr
    worst = re.search(r"^max +(\S+)", evaluated.stdout, re.MULTILINE)
    assert float(worst[1]) < 0.25
