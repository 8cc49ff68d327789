"""`mocap-calib simulate`: complete, readable, the same every time; and the example that it made."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from mocap_calib.errors import MismatchError
from mocap_calib.io.cameras.read import read_cameras, read_rig
from mocap_calib.io.formats.coco_writer import format_coco
from mocap_calib.io.keypoints.read import read_keypoints
from mocap_calib.synthetic import LAYOUTS, simulate
from mocap_calib.synthetic.config import SimulateConfig
from mocap_calib.types import Keypoints2D
from mocap_calib_cli.commands.simulate import command, format_command

EXAMPLE = Path(__file__).parents[2] / "examples" / "three_people"
FEW = [
    "--frames",
    "12",
    "--people",
    "2",
    "--cameras",
    "3",
    "--distortion",
    "fisheye",
    "--seed",
    "7",
]
SCENE = SimulateConfig(frames=12, people=2, cameras=3, distortion="fisheye", seed=7)


def run(output, *options):
    return CliRunner().invoke(command, ["-o", str(output), *options])


def content(folder):
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("simulate") / "deep" / "scene"
    result = run(folder, *FEW)
    assert result.exit_code == 0, result.output
    assert result.stdout == ""
    assert "3 cameras, 12 frames, 2 people" in result.stderr
    return folder


def check_scene(folder, scene):
    """The files of a folder say what the scene does, to the digits that they have."""
    with np.load(folder / "truth.npz", allow_pickle=False) as file:
        truth = dict(file)
    np.testing.assert_array_equal(truth["ids"], scene.identity)
    np.testing.assert_allclose(truth["poses3d"], scene.poses, atol=1e-6)
    assert tuple(truth["joints"]) == scene.joints
    rig = read_rig(folder / "reference.toml")
    assert (rig.names, rig.unit) == (scene.rig.names, "m")
    np.testing.assert_allclose(rig.rotation, scene.rig.rotation, atol=1e-12)
    np.testing.assert_allclose(rig.translation, scene.rig.translation, atol=1e-12)
    for camera, known, file in zip(
        read_cameras(folder / "intrinsics.toml"), scene.rig.cameras, scene.files, strict=True
    ):
        assert (camera.name, camera.size, camera.fisheye) == (known.name, known.size, known.fisheye)
        np.testing.assert_allclose(camera.matrix, known.matrix, atol=1e-9)
        np.testing.assert_allclose(camera.distortion, known.distortion, atol=1e-12)
        read = read_keypoints([folder / "keypoints" / f"{camera.name}.json"])[0]
        assert (read.keypoints, read.image_size) == (file.keypoints, camera.size)
        np.testing.assert_array_equal(read.frames, file.frames)
        instances = read.positions.shape[1]
        assert not np.isfinite(file.positions[:, instances:]).any()
        np.testing.assert_allclose(read.positions, file.positions[:, :instances], atol=0.0501)
        np.testing.assert_allclose(read.confidence, file.confidence[:, :instances], atol=0.00501)


def test_the_files_are_the_scene(written):
    assert set(content(written)) == {
        "README.md",
        "intrinsics.toml",
        "reference.toml",
        "truth.npz",
        *(f"keypoints/cam{k}.json" for k in (1, 2, 3)),
    }
    check_scene(written, simulate(SCENE))
    assert "rotation" not in (written / "intrinsics.toml").read_text()


def test_readme_has_how_it_was_made(written):
    text = (written / "README.md").read_text()
    assert format_command(SCENE) in text


def test_same_command_same_bytes_and_it_may_be_repeated(written, tmp_path):
    for _ in range(2):
        assert run(tmp_path / "again", *FEW, "--quiet").stderr == ""
        assert content(tmp_path / "again") == content(written)
    assert [file.name for file in tmp_path.iterdir()] == ["again"]  # nothing temporary is left


def test_keypoints_of_other_cameras_are_not_mixed_in(tmp_path):
    assert run(tmp_path, *FEW).exit_code == 0
    before = content(tmp_path)
    result = run(tmp_path, *FEW, "--cameras", "2")
    assert isinstance(result.exception, MismatchError)
    assert "cam3.json" in str(result.exception)
    assert content(tmp_path) == before


@pytest.mark.parametrize(
    "wrong",
    [
        ["--cameras", "0"],
        ["--missing", "2"],
        ["--distortion", "thick"],
        ["--fps", "0"],
        ["--seed", "-1"],
        ["--kind", "fish"],
        ["--kind", "bird:0"],
        ["--kind", "people:2", "--people", "3"],
    ],
)
def test_wrong_usage(tmp_path, wrong):
    assert run(tmp_path / "new", *wrong).exit_code == 2
    assert not (tmp_path / "new").exists()


def test_a_kind_without_its_number_is_told_so(tmp_path):
    said = run(tmp_path / "new", "--kind", "rodent:").stderr
    assert "expected a number after the colon, as rodent:2, found none" in said


def test_repeat_gives_only_what_is_unusual():
    assert format_command(SimulateConfig()) == "mocap-calib simulate -o OUT --seed 0"
    assert (
        format_command(SimulateConfig(noise_px=1.0, arc_deg=90.0, shuffle=False))
        == "mocap-calib simulate -o OUT --arc 90.0 --noise 1.0 --no-shuffle --seed 0"
    )


@pytest.mark.parametrize(
    ("typed", "people", "animals"),
    [
        ([], 3, ()),
        (["--people", "2"], 2, ()),
        (["--kind", "people:2"], 2, ()),
        (["--kind", "rodent"], 0, (("rodent", 1),)),
        (["--kind", "bird", "--kind", "bird:2"], 0, (("bird", 3),)),
        (["--people", "2", "--kind", "quadruped"], 2, (("quadruped", 1),)),
        (["--kind", "quadruped:2", "--kind", "people"], 1, (("quadruped", 2),)),
    ],
)
def test_kinds_of_bodies_are_chosen_and_repeated(typed, people, animals, tmp_path, monkeypatch):
    """The command in the README makes the same scene."""
    asked = []
    monkeypatch.setattr("mocap_calib.synthetic.simulate", lambda config: asked.append(config) or 1)
    run(tmp_path / "out", *typed)  # there is no scene to write
    assert [(config.people, config.animals) for config in asked] == [(people, animals)]
    words = format_command(asked[0]).split()[4:]
    run(tmp_path / "out", *words)
    assert asked[0] == asked[1]


def test_a_mixed_scene_is_written_with_its_truth(tmp_path):
    done = run(tmp_path, *FEW, "--kind", "quadruped")
    assert done.exit_code == 0, done.output
    assert "3 cameras, 12 frames, 2 people, 1 quadruped, 1" in done.stderr
    assert "mocap-calib run --model people" in done.stderr
    check_scene(tmp_path, simulate(replace(SCENE, animals=(("quadruped", 1),))))
    with np.load(tmp_path / "truth.npz") as file:
        truth = dict(file)
    assert truth["kinds"].tolist() == ["people", "people", "quadruped"]
    has = dict(
        zip(truth["joints"], np.isfinite(truth["poses3d"][0, :, :, 0]).T.tolist(), strict=True)
    )
    assert has["nose"] == [True, True, True]
    assert has["left_hand"] == [True, True, False]
    assert has["tail_mid"] == [False, False, True]
    assert "2 people, 1 quadruped" in (tmp_path / "README.md").read_text()


def test_help_has_an_example():
    assert (
        "mocap-calib simulate -o scene --kind people:2 --kind quadruped"
        in CliRunner().invoke(command, ["--help"]).output
    )


def test_coco_keeps_the_place_of_empty_instances_before_others():
    positions = np.array([[[[1.26, 2.0]], [[np.nan, np.nan]], [[3.0, 4.04]], [[np.nan, np.nan]]]])
    view = Keypoints2D(
        camera="c",
        keypoints=("nose",),
        frames=np.array([5]),
        positions=positions,
        confidence=np.array([0.126, 0.0, 0.001, 0.0]).reshape(1, 4, 1),
        tracked=False,
        image_size=(64, 48),
        source="made",
    )
    data = json.loads(format_coco(view))
    assert data["images"] == [{"id": 5, "file_name": "frame_000005.jpg", "width": 64, "height": 48}]
    assert [entry["keypoints"] for entry in data["annotations"]] == [
        [1.3, 2, 0.13],
        [0, 0, 0],
        [3, 4, 0.01],
    ]
    assert [entry["id"] for entry in data["annotations"]] == [1, 2, 3]


def test_the_example_is_what_its_command_makes():
    check_scene(EXAMPLE, simulate(SimulateConfig(distortion="brown")))
    assert format_command(SimulateConfig(distortion="brown")) in (EXAMPLE / "README.md").read_text()
    assert read_keypoints([EXAMPLE / "keypoints" / "cam1.json"])[0].keypoints == LAYOUTS["coco17"]
    assert sum(map(len, content(EXAMPLE).values())) < 2e6
