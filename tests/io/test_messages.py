"""A user's mistakes with files: what is expected, what came, and what to do are in the message."""

import json

import numpy as np
import pytest
from conversion_samples import DLC, rig
from samples2d import recording, write_sample

from mocap_calib.errors import FormatError, MismatchError, suggest
from mocap_calib.io.cameras.own import format_cameras_yaml, format_intrinsics_toml
from mocap_calib.io.cameras.read import load_cameras, read_rig
from mocap_calib.io.cameras.write import write_cameras
from mocap_calib.io.keypoints.layouts import parse_layout
from mocap_calib.io.keypoints.read import read_keypoints, read_what_can
from mocap_calib.io.kinds import check_sources, choose_kind
from mocap_calib.io.poses.formats import POSE_FORMATS
from mocap_calib.io.registry import find_format
from mocap_calib.lift.lifter import load_vocabulary

VIDEO = b"\x00\x00\x00\x20ftypisom\x00\x00\x02\x00" + bytes(range(256))


def message(error_type, function, *arguments) -> str:
    """Return the one line with which a function refuses its arguments."""
    with pytest.raises(error_type) as refused:
        function(*arguments)
    text = str(refused.value)
    assert len(text.splitlines()) == 1
    assert "expected" in text
    return text


# --- videos and images


@pytest.mark.parametrize(
    ("name", "found"),
    [("cam1.mp4", "a video"), ("a.AVI", "a video"), ("b.mov", "a video"), ("c.mkv", "a video")]
    + [("frame.png", "an image"), ("frame.JPG", "an image")],
)
def test_a_video_needs_a_pose_estimator_first(tmp_path, name, found):
    (tmp_path / name).write_bytes(VIDEO)
    for path in (str(tmp_path / name), f"left={tmp_path / name}"):
        for read in (read_keypoints, read_what_can, check_sources):
            text = message(FormatError, read, [path])
            assert f"{name}: expected files of 2D keypoints, found {found}; run a 2D pose" in text
            assert "DeepLabCut, SLEAP, Lightning Pose, OpenPose" in text
            assert ".json, .csv, .h5" in text
    assert f"found {found}" in message(FormatError, load_cameras, tmp_path / name)


def test_a_video_is_not_opened(tmp_path):
    """It may be larger than memory; this one cannot be read at all."""
    (tmp_path / "cam1.mp4").symlink_to("/proc/self/mem")
    assert "found a video" in message(FormatError, read_keypoints, [tmp_path / "cam1.mp4"])


@pytest.mark.parametrize("below", ["", "cam1"])
def test_a_folder_of_videos_says_so_unless_it_has_keypoints_too(tmp_path, below):
    folder = tmp_path / "recording" / below
    folder.mkdir(parents=True)
    (folder / "cam2.mp4").write_bytes(VIDEO)
    (folder / "cam1.mp4").write_bytes(VIDEO)
    text = message(FormatError, read_keypoints, [tmp_path / "recording"])
    assert "found videos (cam1.mp4, cam2.mp4); run a 2D pose estimator first" in text
    (folder / "cam1.csv").write_text(DLC)
    (view,) = read_keypoints([folder])
    assert view.camera == "cam1"


def test_a_folder_named_like_a_video_is_a_folder(tmp_path):
    (tmp_path / "cam1.mp4").mkdir()
    (tmp_path / "cam1.mp4" / "a.csv").write_text(DLC)
    assert read_keypoints([tmp_path / "cam1.mp4"])[0].camera == "a"


# --- files that are something else


def test_what_is_not_there_is_said_without_the_words_of_the_system(tmp_path):
    for read in (lambda path: read_keypoints([path]), load_cameras):
        text = message(FormatError, read, tmp_path / "nothing.csv")
        assert text.endswith("nothing.csv: expected a file or folder, found none; check the path")


def test_cameras_taken_for_keypoints_are_shown_as_text(tmp_path):
    """A section of TOML begins as JSON does."""
    (tmp_path / "a.toml").write_text(format_intrinsics_toml(rig().cameras))
    (tmp_path / "b.toml").write_text('[[cameras]]\nname = "a"\n')
    for name, start in (("a", "[cam_0] name = "), ("b", "[[cameras]] name = ")):
        text = message(FormatError, read_keypoints, [tmp_path / f"{name}.toml"])
        assert f"found text that begins with '{start}" in text
        assert "one of: coco, openpose" in text
        assert "docs/formats.md" in text


def test_keypoints_taken_for_cameras_are_shown_by_their_keys(tmp_path):
    write_sample("coco", tmp_path, *recording())
    (tmp_path / "cam.json").write_text(
        json.dumps({"info": {}, **json.loads((tmp_path / "cam.json").read_text())})
    )
    text = message(FormatError, load_cameras, tmp_path / "cam.json")
    assert "found a JSON object with info, " in text
    assert "not the keypoints" in text


def test_the_folder_of_a_run_is_its_cameras(tmp_path):
    wanted = rig()
    (tmp_path / "cameras.yaml").write_text(format_cameras_yaml(wanted, {}))
    (tmp_path / "calibration.toml").write_text(format_intrinsics_toml(wanted.cameras))
    (tmp_path / "run.json").write_text("{}")
    found = read_rig(tmp_path)
    assert found.names == wanted.names
    np.testing.assert_array_equal(found.rotation, wanted.rotation)


def test_intrinsics_alone_are_no_rig(tmp_path):
    (tmp_path / "i.toml").write_text(format_intrinsics_toml(rig().cameras))
    text = message(FormatError, read_rig, tmp_path / "i.toml")
    assert (
        "where it stands, found none of a, b; give a calibrated file, as the cameras.yaml" in text
    )


def test_a_model_that_is_none(tmp_path):
    text = message(FormatError, load_vocabulary, "peple")
    assert text.endswith("a file of weights, or none, found neither; did you mean people?")
    (tmp_path / "i.toml").write_text(format_intrinsics_toml(rig().cameras))
    text = message(FormatError, load_vocabulary, str(tmp_path / "i.toml"))
    assert "expected weights that `train` wrote, found another file" in text


# --- formats


def test_the_format_of_the_output_is_of_the_kind_of_the_input(tmp_path):
    (tmp_path / "a.csv").write_text(DLC)
    write_cameras(tmp_path / "c.toml", rig(), "anipose")
    for source, to, kind, offered in (
        ("a.csv", "colmap", "keypoints", "deeplabcut-csv"),
        ("c.toml", "coco", "cameras", "opencv"),
    ):
        with pytest.raises(MismatchError) as refused:
            choose_kind([tmp_path / source], "out", to=to)
        text = str(refused.value)
        assert f"format={to!r}: expected a format of {kind}, which INPUT holds" in text
        assert offered in text.partition("choose one of ")[2]
    assert choose_kind([tmp_path / "a.csv"], "out", to="coco") == "keypoints"


def test_a_misspelled_name_gets_the_one_it_is_meant_for():
    assert suggest("collmap", ["opencv", "colmap"]) == "did you mean colmap?"
    assert suggest("x", ["opencv", "colmap"]) == "choose one of these"
    assert message(MismatchError, find_format, POSE_FORMATS, "tcr").endswith("did you mean trc?")
    assert message(MismatchError, parse_layout, "body25").endswith("did you mean body_25?")
