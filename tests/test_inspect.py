"""`inspect`: its numbers of files whose content is known, as text and as JSON; its exit status."""

import json
from dataclasses import replace

import numpy as np
import pytest
from keypoint_files import coco_bytes

from mocap_calib.inspection import fill_image_sizes, find_problems, inspect_views
from mocap_calib.inspection.finding import InspectConfig
from mocap_calib.io.cameras.write import write_cameras
from mocap_calib.recording.joints import load_skeleton
from mocap_calib.types import Camera, CameraRig, Keypoints2D
from mocap_calib_cli.commands.inspect import _describe

NAMES = ("nose", "left_eye", "right_eye", "left_ear", "right_ear")
SIZE = (640, 480)
PEOPLE = load_skeleton("people")


def view(camera="a", frames=range(40), instances=1, seed=0, names=NAMES, size=SIZE):
    positions = np.random.default_rng(seed).uniform(5, 470, (len(frames), instances, len(names), 2))
    return Keypoints2D(
        camera,
        names,
        np.array(frames),
        positions,
        np.full(positions.shape[:3], 0.8),
        False,
        size,
        f"{camera}.json",
    )


def camera(name, size=SIZE):
    return Camera(
        name, size, np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]), np.zeros(5), False
    )


def report_of(*views, aliases=None):
    return inspect_views(views, PEOPLE, aliases or {}, InspectConfig())


def found_in(views, cameras=(), aliases=None):
    return find_problems(
        views,
        report_of(*views, aliases=aliases),
        cameras=cameras,
        skeleton=PEOPLE,
        aliases=aliases or {},
        config=InspectConfig(),
    )


def test_the_numbers_are_those_of_the_files():
    first = view(frames=[3, 4, 10, 11], instances=2)
    first.positions[1, 1], first.positions[3] = np.nan, np.nan
    first.positions[:, :, 4] = np.nan
    report = report_of(first, view("b", frames=[4, 10, 12]))
    found = report["cameras"][0]
    assert found["frames"] == {"count": 4, "first": 3, "last": 11, "gaps": [[5, 9]]}
    assert (found["detections"], found["most_at_once"], found["empty_frames"], found["points"]) == (
        5,
        2,
        1,
        20,
    )
    assert (found["never_seen"], found["followed"]) == (["right_ear"], False)
    assert found["confidence"] == {"least": 0.8, "median": 0.8, "most": 0.8}
    assert report["pairs"] == [{"a": "a", "b": "b", "frames": 2, "covisible": 2, "joints": 5}]
    assert report["model"] == {"name": "people", "knows": 5, "unknown": []}


def test_coverage_is_that_of_the_image():
    corner = view(frames=range(400), size=(1000, 1000))
    corner.positions[:] = corner.positions % 200  # a fifth each way
    assert report_of(corner)["cameras"][0]["image"]["covered"] == pytest.approx(0.04)
    corner.positions[0] = 1500.0
    assert report_of(corner)["cameras"][0]["image"]["outside"] == pytest.approx(1 / 400)


def test_the_cameras_say_the_size_of_images_that_the_files_do_not():
    views = fill_image_sizes(
        [view("a", size=(0, 0)), view("b", size=(0, 0)), view("Cam_1")],
        (camera("A"), camera("cam1", (8, 8))),
    )
    assert [each.image_size for each in views] == [SIZE, (0, 0), SIZE]


@pytest.mark.parametrize("frames", [0, 1])
def test_views_without_anything_are_reported_and_not_divided_by(frames):
    empty = view(frames=range(frames))
    empty.positions[:] = np.nan
    report = report_of(empty, empty)
    assert report["cameras"][0]["image"]["covered"] == 0
    assert any(
        each.critical
        for each in found_in([empty, replace(empty, camera="b")], (camera("a"), camera("b")))
    )


def test_a_good_recording_has_nothing_in_its_way():
    assert found_in([view("a"), view("b", seed=1)], (camera("a"), camera("b"))) == ()


def test_what_a_run_would_refuse_is_critical():
    views = [view("a"), view("b", seed=1)]
    for cameras in ((camera("a"), camera("c")), (camera("a"), camera("b", (480, 640)))):
        assert any(each.critical for each in found_in(views, cameras))


def test_a_camera_that_sees_nothing_with_others_is_named():
    views = [view("a"), view("b", seed=1), view("c", frames=range(100, 140), seed=2)]
    found = found_in(views)
    assert any(each.message.startswith("c: sees nothing in a frame") for each in found)
    assert not any(each.critical for each in found)


def test_names_count_by_what_they_mean_as_in_a_run():
    """The run takes other spellings and aliases for the joint.

    So do the pairs, the model and the findings.
    """
    own = [f"{side}{k}" for side in "qw" for k in range(5)]
    views = [view("a", names=tuple(own[:5])), view("b", names=tuple(own[5:]), seed=1)]
    assert [each.critical for each in found_in(views)] == [True]
    aliases = dict(zip(own, NAMES * 2, strict=True))
    report = report_of(*views, aliases=aliases)
    assert (report["model"], report["pairs"][0]["joints"]) == (
        {"name": "people", "knows": 5, "unknown": []},
        5,
    )
    assert found_in(views, (camera("a"), camera("b")), aliases) == ()
    spelled = replace(views[1], keypoints=("Nose", "LEye", "reye", "ear_l", "Right Ear"))
    assert report_of(view("a"), spelled)["model"]["knows"] == 5


def test_too_few_joints_in_common_are_critical_as_in_a_run():
    few = [view("a", names=NAMES[:4]), view("b", names=NAMES[1:], seed=1)]
    for views in (few, [replace(each, keypoints=("x", *each.keypoints[1:])) for each in few]):
        assert any(
            each.critical and "at least 4 joints" in each.message for each in found_in(views)
        )


def test_a_crowd_that_no_model_knows_is_critical_as_in_a_run():
    views = [
        view(name, instances=2, names=("q", "r", "s", "t", "u"), seed=k)
        for k, name in enumerate("ab")
    ]
    assert any(
        each.critical and "joint names that the model knows" in each.message
        for each in found_in(views, (camera("a"), camera("b")))
    )


def test_a_camera_without_a_point_is_named_once(tmp_path, tool):
    blind = view("c", seed=2)
    blind.positions[:] = np.nan
    messages = [
        each.message
        for each in found_in([view("a"), view("b", seed=1), blind], tuple(map(camera, "abc")))
        if each.message.startswith("c:")
    ]
    assert len(messages) == 1
    assert "it will be left out" in messages[0]
    (tmp_path / "c.csv").write_text("frame,keypoint,x,y\n0,nose,,\n")
    row = next(
        line for line in tool("inspect", tmp_path).stdout.splitlines() if line.startswith("c ")
    )
    assert "100%" in row


def test_inspect_takes_the_skeleton_and_the_cameras_as_a_run_does(tmp_path, tool):
    """Aliases of joints that the first model does not have are understood.

    Two cameras in one place are a finding, and stderr is empty.
    """
    (tmp_path / "keypoints").mkdir()
    for name in "ab":
        one = view(name, seed=ord(name), names=tuple(f"q{k}" for k in range(5)))
        (tmp_path / "keypoints" / f"{name}.json").write_bytes(
            coco_bytes(one.frames, one.keypoints, one.positions, one.confidence, SIZE)
        )
    (tmp_path / "own.yaml").write_text(
        "aliases: {q0: chin, q1: head, q2: neck_base, q3: croup, q4: nose}"
    )
    rig = CameraRig((camera("a"), camera("b")), np.stack([np.eye(3)] * 2), np.zeros((2, 3)), "m")
    write_cameras(tmp_path / "rig.toml", rig, "anipose")
    done = tool(
        "inspect",
        tmp_path / "keypoints",
        "--skeleton",
        tmp_path / "own.yaml",
        "--cameras",
        tmp_path / "rig.toml",
        "--json",
    )
    assert (done.returncode, done.stderr) == (0, "")
    report = json.loads(done.stdout)
    assert (report["model"]["name"], report["model"]["knows"]) == ("quadruped", 5)
    assert ["same place" in each["message"] for each in report["findings"]] == [True]


def test_the_command_says_it_as_text_and_as_json(tmp_path, tool):
    for name in "ab":
        one = view(name, seed=ord(name))
        (tmp_path / f"{name}.json").write_bytes(
            coco_bytes(one.frames, NAMES, one.positions, one.confidence, SIZE)
        )
    done = tool("inspect", tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "nothing stands in the way" in done.stdout
    assert "\x1b" not in done.stdout
    (tmp_path / "a.json").write_text('{"images": []')
    done = tool("inspect", tmp_path)
    assert done.returncode == 1
    lines = [line for line in done.stdout.splitlines() if line.startswith("CRITICAL: ")]
    assert len(lines) == 2  # the file, and that one camera is left
    assert str(tmp_path / "a.json") in lines[0]
    report = json.loads(tool("inspect", tmp_path, "--json").stdout)
    assert [each["level"] for each in report["findings"]] == ["CRITICAL", "CRITICAL"]
    assert report["cameras"][0]["name"] == "b"


def test_scores_a_little_above_1_are_said_to_be_above_1():
    """Rounded to two digits they would read `1.00`."""
    other = view("b", seed=1)
    other.confidence[0, 0, 0] = 1.00001
    assert [
        "(up to 1 + 1e-05)" in finding.message
        for finding in found_in((view(), other))
        if "scores" in finding.message
    ] == [True]


def test_every_column_is_explained():
    report = report_of(view(frames=[1, 2, 5]), view("b", frames=[1, 2, 5], seed=1))
    lines = _describe(report | {"findings": [{"level": "WARNING", "message": "m"}]})
    header = lines[0].split("  ")
    for name in ("range", "gaps", "at once", "followed", "missing", "score", "covered"):
        assert name in map(str.strip, header)
        assert sum(line.startswith(f"{name:<10}  ") for line in lines) == 1
    assert "gaps        places between them where frame numbers are not there" in lines
    assert lines[-1] == "1 finding"
