"""What was typed, and what is said of it: DeepLabCut's two files, lone detections."""

from dataclasses import replace

import numpy as np
import pytest
from keypoint_files import dlc_columns, dlc_csv, dlc_h5_fixed, dlc_values

from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.io.cameras.source import CameraFile
from mocap_calib.io.hashing import hash_inputs
from mocap_calib.io.keypoints.options import ReadOptions
from mocap_calib.io.keypoints.read import read_keypoints
from mocap_calib.io.keypoints.write import write_keypoints
from mocap_calib.types import Camera
from mocap_calib_cli.inputs import read_recording
from mocap_calib_cli.options import SharedOptions
from mocap_calib_cli.progress import Reporter

NAMES = ("nose", "left_eye", "right_eye", "left_ear")
FRAMES = {"a": [0, 1, 2, 3], "b": [2, 3, 4]}


@pytest.fixture
def twins(tmp_path):
    """A folder with an .h5 and a .csv file of each camera."""
    for name, frames in FRAMES.items():
        positions = np.random.default_rng(0).uniform(10, 400, (len(frames), 1, len(NAMES), 2))
        columns, values = dlc_columns(NAMES), dlc_values(positions, np.ones(positions.shape[:3]))
        dlc_h5_fixed(tmp_path / f"{name}.h5", frames, columns, values)
        (tmp_path / f"{name}.csv").write_text(dlc_csv(frames, columns, values))
    return tmp_path


def read(folder, *arguments):
    """Read the keypoints of two cameras, and say what is to be said of them."""
    matrix = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    camera = Camera("a", (640, 480), matrix, distortion=np.zeros(5), fisheye=False)
    cameras = CameraFile((camera, replace(camera, name="b")), extrinsics={})
    options = SharedOptions(keypoints=tuple(map(str, arguments)) or (str(folder),))
    return read_recording(options, cameras, Reporter(quiet=False)).recording


def test_an_h5_is_preferred_to_the_csv_beside_it_and_that_is_said(twins, capsys):
    assert [(view.camera, view.source) for view in read_keypoints([twins])] == [
        (name, str(twins / f"{name}.h5")) for name in "ab"
    ]
    assert read(twins).names == ("a", "b")
    said = capsys.readouterr()
    assert said.out == ""
    assert f"left out, the .h5 beside it is read: {twins / 'a.csv'}, {twins / 'b.csv'}" in said.err


def test_files_that_are_named_are_read(twins, capsys):
    read(twins, twins / "a.csv", twins / "b.h5")
    assert "beside" not in capsys.readouterr().err
    with pytest.raises(MismatchError, match="one keypoint file per camera"):
        read_keypoints([twins / "a.csv", twins / "a.h5"])


def test_a_third_file_of_one_name_is_refused(twins):
    (twins / "a.json").write_text("{}")
    with pytest.raises(MismatchError, match="one keypoint file per camera"):
        read_keypoints([twins])


def test_detections_of_a_single_camera_are_counted(twins, capsys):
    read(twins)
    assert "left out, in frames of a single camera: 3 detections\n" in capsys.readouterr().err


def test_joints_that_a_single_camera_names_are_said(tmp_path, capsys):
    positions = np.random.default_rng(0).uniform(10, 400, (4, 1, 5, 2))
    for name, own in (("a", "right_ankle"), ("b", "tail")):
        columns, values = (
            dlc_columns((*NAMES, own)),
            dlc_values(positions, np.ones(positions.shape[:3])),
        )
        (tmp_path / f"{name}.csv").write_text(dlc_csv(range(4), columns, values))
    read(tmp_path)
    assert (
        "not used, named by a single camera: 2 keypoints: right_ankle (a), tail (b)\n"
        in capsys.readouterr().err
    )


def test_nothing_is_said_where_all_frames_are_shared(twins, capsys):
    twins.joinpath("b.h5").write_bytes(twins.joinpath("a.h5").read_bytes())
    read(twins)
    assert "single camera" not in capsys.readouterr().err


def test_a_folder_of_frames_has_one_hash_for_its_files_and_names(tmp_path):
    for camera in ("a_json", "b_json"):
        (tmp_path / camera).mkdir()
        (tmp_path / camera / "0.json").write_text("{}")
    before = hash_inputs([tmp_path])
    assert sorted(before) == [str(tmp_path / "a_json"), str(tmp_path / "b_json")]
    (tmp_path / "a_json" / "0.json").rename(tmp_path / "a_json" / "1.json")
    after = hash_inputs([tmp_path])
    assert before[str(tmp_path / "a_json")] != after[str(tmp_path / "a_json")]
    assert before[str(tmp_path / "b_json")] == after[str(tmp_path / "b_json")]


# --- folders


def touch(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content)


PLAIN = "frame,individual,keypoint,x,y\n0,anna,nose,3,4\n"
FRAME = '{"version": 1.3, "people": []}'


def cameras(folder):
    return [view.camera for view in read_keypoints([folder], None, ReadOptions(layout=("a", "b")))]


def test_what_is_no_keypoints_beside_camera_folders_is_left_alone(tmp_path):
    for camera in ("left", "right"):
        touch(tmp_path / camera / "0.csv", PLAIN)
    for name in ("notes.txt", "params.json", "points.csv"):
        touch(tmp_path / name, "[1, 2]")
    (tmp_path / "videos").mkdir()
    assert cameras(tmp_path) == ["left", "right"]
    touch(tmp_path / "top.csv", PLAIN)
    with pytest.raises(FormatError, match=r"params\.json"):  # now files are meant
        cameras(tmp_path)
    for name in ("params.json", "points.csv"):
        (tmp_path / name).unlink()
    assert cameras(tmp_path) == ["top", "left", "right"]


def test_results_below_the_files_are_left_alone(tmp_path):
    for camera in ("left", "right"):
        touch(tmp_path / f"{camera}.csv", PLAIN)
    touch(tmp_path / "out" / "run.json", "{}")
    touch(tmp_path / "out" / "poses3d.csv", "nose_x,nose_y\n1,2\n")
    assert cameras(tmp_path) == ["left", "right"]


def test_texts_without_a_number_are_no_frames(tmp_path):
    for frame in range(2):
        touch(tmp_path / "left" / f"{frame}.txt", "0 0.5 0.5 0.1 0.1 0.4 0.4 0.6 0.6\n")
    touch(tmp_path / "left" / "classes.txt", "person\n")
    (view,) = read_keypoints(
        [tmp_path], None, ReadOptions(layout=("a", "b"), image_size=(100, 100))
    )
    assert (view.camera, view.frames.tolist()) == ("left", [0, 1])


# --- names that come from inside a file


@pytest.mark.parametrize("name", ["../evil", "/evil", "a/../../evil", "..", "a\\b", ""])
@pytest.mark.parametrize("format_", ["coco", "openpose", "sleap", "deeplabcut-csv"])
def test_a_camera_s_name_leads_nowhere(tmp_path, name, format_):
    (view,) = read_keypoints([_plain(tmp_path)])
    with pytest.raises(MismatchError, match="camera names"):
        write_keypoints(
            tmp_path / "a" / "b" / "out",
            (replace(view, camera=name), replace(view, camera="c")),
            format_,
        )
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["plain.csv"]


def _plain(folder):
    touch(folder / "plain.csv", PLAIN)
    return folder / "plain.csv"
