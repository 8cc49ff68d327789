"""`inspect`: the numbers it gives of files whose content is known, as text and as JSON, and its exit status."""

import json
from dataclasses import replace

import numpy as np
import pytest
from keypoint_files import coco_bytes

from mocap_calib.config import InspectConfig
from mocap_calib.inspection import findings, inspect_views, with_sizes
from mocap_calib.types import Camera, Keypoints2D

NAMES = ("nose", "left_eye", "right_eye", "left_ear", "right_ear")
SIZE = (640, 480)


def view(camera="a", frames=range(40), instances=1, seed=0, names=NAMES, size=SIZE):
    positions = np.random.default_rng(seed).uniform(5, 470, (len(frames), instances, len(names), 2))
    return Keypoints2D(camera, names, np.array(frames), positions, np.full(positions.shape[:3], 0.8), False, size, f"{camera}.json")


def camera(name, size=SIZE):
    return Camera(name, size, np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]), np.zeros(5), False)


def test_the_numbers_are_those_of_the_files():
    first = view(frames=[3, 4, 10, 11], instances=2)
    first.positions[1, 1], first.positions[3] = np.nan, np.nan
    first.positions[:, :, 4] = np.nan
    report = inspect_views([first, view("b", frames=[4, 10, 12])], InspectConfig())
    found = report["cameras"][0]
    assert found["frames"] == {"count": 4, "first": 3, "last": 11, "gaps": [[5, 9]]}
    assert (found["detections"], found["most_at_once"], found["empty_frames"], found["points"]) == (5, 2, 1, 20)
    assert (found["never_seen"], found["followed"]) == (["right_ear"], False)
    assert found["confidence"] == {"least": 0.8, "median": 0.8, "most": 0.8}
    assert report["pairs"] == [{"a": "a", "b": "b", "frames": 2, "covisible": 2, "joints": 5}]
    assert report["model"] == {"name": "people", "knows": 5, "unknown": []}


def test_coverage_is_that_of_the_image():
    corner = view(frames=range(400), size=(1000, 1000))
    corner.positions[:] = corner.positions % 200  # a fifth each way
    assert inspect_views([corner], InspectConfig())["cameras"][0]["image"]["covered"] == pytest.approx(0.04)
    corner.positions[0] = 1500.0
    assert inspect_views([corner], InspectConfig())["cameras"][0]["image"]["outside"] == pytest.approx(1 / 400)


def test_the_cameras_say_the_size_of_images_that_the_files_do_not():
    views = with_sizes([view("a", size=(0, 0)), view("b", size=(0, 0)), view("Cam_1")], (camera("A"), camera("cam1", (8, 8))))
    assert [each.image_size for each in views] == [SIZE, (0, 0), SIZE]


@pytest.mark.parametrize("frames", [0, 1])
def test_views_without_anything_are_reported_and_not_divided_by(frames):
    empty = view(frames=range(frames))
    empty.positions[:] = np.nan
    report = inspect_views([empty, empty], InspectConfig())
    assert report["cameras"][0]["image"]["covered"] == 0
    assert any(each.critical for each in findings([empty, replace(empty, camera="b")], report, (camera("a"), camera("b")), {}, InspectConfig()))


def test_a_good_recording_has_nothing_in_its_way():
    views = [view("a"), view("b", seed=1)]
    assert findings(views, inspect_views(views, InspectConfig()), (camera("a"), camera("b")), {}, InspectConfig()) == ()


def test_what_a_run_would_refuse_is_critical():
    views = [view("a"), view("b", seed=1)]
    report = inspect_views(views, InspectConfig())
    for cameras in ((camera("a"), camera("c")), (camera("a"), camera("b", (480, 640)))):
        assert any(each.critical for each in findings(views, report, cameras, {}, InspectConfig()))


def test_a_camera_that_sees_nothing_with_others_is_named():
    views = [view("a"), view("b", seed=1), view("c", frames=range(100, 140), seed=2)]
    found = findings(views, inspect_views(views, InspectConfig()), (), {}, InspectConfig())
    assert any(each.message.startswith("c: sees nothing in a frame") for each in found)
    assert not any(each.critical for each in found)


def test_the_command_says_it_as_text_and_as_json(tmp_path, tool):
    for name in "ab":
        one = view(name, seed=ord(name))
        (tmp_path / f"{name}.json").write_bytes(coco_bytes(one.frames, NAMES, one.positions, one.confidence, SIZE))
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
