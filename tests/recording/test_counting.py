"""Counts in words."""

from dataclasses import replace

from mocap_calib.errors import count
from mocap_calib.job.load import RecordingSummary
from mocap_calib.recording.names import describe_unshared
from mocap_calib_cli.describe import describe_recording


def test_one_is_not_many():
    assert [count(k, "frame") for k in (0, 1, 2)] == ["0 frames", "1 frame", "2 frames"]
    assert [count(k, "person", "people") for k in (1, 3)] == ["1 person", "3 people"]


def test_a_recording_of_one_of_each():
    one = RecordingSummary(
        cameras=(),
        without_keypoints=(),
        left_out=(),
        lone_detections=1,
        frames=1,
        keypoints=("nose",),
        unknown=(),
        single_camera_joints={"tail": "cam1"},
        skeleton="people",
    )
    lines = describe_recording(one)
    assert "left out, in frames of a single camera: 1 detection" in lines
    assert "1 frame; 1 joint, the model of people knows 1" in lines
    assert "not used, named by a single camera: 1 keypoint: tail (cam1)" in lines
    many = describe_recording(replace(one, lone_detections=2, frames=2))
    assert "left out, in frames of a single camera: 2 detections" in many
    assert "2 frames; 1 joint, the model of people knows 1" in many
    assert describe_unshared({"a": "x", "b": "y"}).startswith(
        "not used, named by a single camera: 2 k"
    )
