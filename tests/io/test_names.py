"""Names with accents: macOS takes them apart in names of files, people type them composed."""

import os
import unicodedata
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from platforms import linux
from scenes import scene
from test_io_results import matches, recording

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.io.atomic import check_no_other_files
from mocap_calib.io.cameras.read import read_cameras
from mocap_calib.io.hashing import hash_inputs
from mocap_calib.io.keypoints.document import ReadOptions
from mocap_calib.io.keypoints.read import read_keypoints
from mocap_calib.io.results.matches_csv import matches_csv, read_matches_csv
from mocap_calib.io.results.scene import scene_files
from mocap_calib.recording.names import match_cameras
from mocap_calib.types import Keypoints2D

NAME = "łódź1"
APART = unicodedata.normalize("NFD", NAME)


@pytest.fixture(scope="module")
def files() -> dict[str, bytes]:
    """A recording of two cameras."""
    return scene_files(scene(cameras=2, people=1, frames=4), "made by a test")


@pytest.mark.parametrize("argument", [f"{APART}.json", f"{APART}=other.json"])
def test_the_camera_of_a_keypoint_file(argument, files, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path(argument.split("=")[-1]).write_bytes(files["keypoints/cam1.json"])
    for typed in (NAME, APART):
        options = ReadOptions(frame_offset={typed: 7}, crop_offset={typed: (1.0, 2.0)})
        view = read_keypoints([argument], options=options)[0]
        assert view.camera == NAME
        assert view.frames[0] == 7


def test_the_names_in_a_camera_file(files, tmp_path):
    path = tmp_path / "cameras.toml"
    path.write_bytes(files["reference.toml"].replace(b"cam1", APART.encode()))
    assert [each.name for each in read_cameras(path)] == [NAME, "cam2"]
    path.write_bytes(path.read_bytes().replace(b"cam2", NAME.encode()))
    with pytest.raises(FormatError, match=f"expected each camera name once, found {NAME} twice"):
        read_cameras(path)


def test_the_cameras_of_records_and_of_matches():
    view = Keypoints2D(
        camera=APART,
        keypoints=("nose",),
        frames=np.arange(1),
        positions=np.ones((1, 1, 1, 2)),
        confidence=np.ones((1, 1, 1)),
        tracked=False,
        image_size=(0, 0),
        source="x.json",
    )
    of = recording()
    first = replace(of.cameras[0], name=NAME)
    assert match_cameras([view], [first]) == (NAME,)
    of = replace(of, cameras=(first, *of.cameras[1:]))
    labels = matches(of)
    text = b"".join(matches_csv(of, labels)).decode().replace(NAME, APART)
    np.testing.assert_array_equal(read_matches_csv(text, of).labels, labels.labels)


def test_files_that_are_written_again_are_no_others(tmp_path):
    (tmp_path / f"{APART}.json").write_bytes(b"")
    check_no_other_files(tmp_path, [f"{NAME}.json"], [".json"])
    with pytest.raises(MismatchError, match="expected a new folder or one with the same files"):
        check_no_other_files(tmp_path, ["other.json"], [".json"])


@linux
def test_a_name_of_a_file_that_is_not_utf8_is_no_camera_but_can_be_given_one(files, tmp_path):
    """No file could hold such a name; the path is escaped where results say it."""
    path = tmp_path / os.fsdecode(b"c\xff4.json")
    path.write_bytes(files["keypoints/cam1.json"])
    with pytest.raises(FormatError, match=r"expected a camera name in UTF-8, found .*; rename the"):
        read_keypoints([path])
    assert read_keypoints([f"cam4={path}"])[0].camera == "cam4"
    assert list(hash_inputs([path])) == [f"{tmp_path}/c\\udcff4.json"]
