"""Conversion as a Python user calls it: from paths or bytes to a path or bytes."""

import numpy as np
import pytest
from conversion_samples import DLC, poses, rig
from rigs import assert_same

from mocap_calib.errors import MismatchError
from mocap_calib.io.cameras.read import make_rig, parse_content
from mocap_calib.io.cameras.write import format_rig, write_cameras
from mocap_calib.io.conversion import convert_cameras, convert_keypoints, convert_poses
from mocap_calib.io.keypoints.read import read_keypoints
from mocap_calib.io.kinds import choose_format, choose_kind
from mocap_calib.io.poses.read import parse_poses
from mocap_calib.io.poses.write import write_poses


def test_cameras_go_from_a_path_to_bytes_and_back_to_a_path(tmp_path):
    write_cameras(tmp_path / "a.toml", rig(), "anipose")
    done = convert_cameras(tmp_path / "a.toml", None, "voxelpose")
    assert done.summary == "2 cameras, lengths in mm, as voxelpose"
    assert done.lost == ("image sizes",)
    (content,) = done.files.values()
    found = make_rig(parse_content(content, "bytes"), "bytes")
    assert_same(rig(), found, sizes=False, scale=1000)
    done = convert_cameras(content, tmp_path / "b.yaml", "mocap-calib", image_size=(1280, 720))
    assert (done.lost, done.files) == ((), {})
    found = make_rig(parse_content((tmp_path / "b.yaml").read_bytes(), "b"), "b")
    assert_same(rig(), found, scale=1000)


def test_poses_go_from_a_path_to_bytes(tmp_path):
    write_poses(tmp_path / "a.npz", poses(), "npz")
    done = convert_poses([tmp_path / "a.npz"], None, "poses-h5", up="z")
    (content,) = done.files.values()
    found = parse_poses(content, "bytes").poses
    np.testing.assert_array_equal(found.positions, poses().poses.positions[..., [1, 2, 0]])
    with pytest.raises(MismatchError, match="25 frames per second, as the file says"):
        convert_poses([tmp_path / "a.npz"], None, "trc", fps=30.0)


def test_keypoints_go_from_bytes_to_a_path(tmp_path):
    done = convert_keypoints(DLC.encode(), tmp_path / "a.json", "coco")
    assert done.summary == "1 camera, 2 frames as coco"
    assert done.lost == ()
    (view,) = read_keypoints([tmp_path / "a.json"])
    np.testing.assert_array_equal(view.positions[:, 0, 0], [[10, 20], [11, 21]])


def test_content_and_names_tell_the_kind_and_the_ending_the_format(tmp_path):
    (tmp_path / "a.csv").write_text(DLC)
    (content,) = format_rig(rig(), "anipose", {}).files.values()
    assert choose_kind([tmp_path / "a.csv"], "b.json") == "keypoints"
    assert choose_kind(content, "b.yaml") == "cameras"
    assert choose_kind(content, "b.h5", to="poses-h5") == "poses"
    assert choose_format("cameras", "b.yml") == "mocap-calib"
    with pytest.raises(MismatchError, match="say format='deeplabcut-h5' or format='sleap'"):
        choose_format("keypoints", "b.h5")
