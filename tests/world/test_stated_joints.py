"""Keypoints with names of a user's own are the joints that a file says, in results too."""

from dataclasses import replace

import pytest
from scenes import PEOPLE, recording, scene
from test_floor import poses_of

from mocap_calib.errors import FormatError
from mocap_calib.io.poses import trc
from mocap_calib.io.poses.common import PoseFile, known_edges
from mocap_calib.io.poses.read import join_individuals, parse_poses
from mocap_calib.io.results.poses_h5 import poses_to_h5
from mocap_calib.kinematics import define
from mocap_calib.recording.joints import fit_vocabulary
from mocap_calib.recording.synchronise import make_recording
from mocap_calib.types import Recording
from mocap_calib.world.floor import find_joints, joints_of_recording, stated_joints
from mocap_calib.world.lengths import joint_pair

SEEN = scene().files[0].keypoints
COLUMNS = [scene().joints.index(name) for name in SEEN]
POSES = scene().poses[:, :, COLUMNS]


def own_names() -> Recording:
    """A recording whose keypoints are called q_0, q_1, ..., all but the last of them joints."""
    made = scene()
    own = tuple(f"q_{k}" for k in range(len(SEEN)))
    files = [replace(file, keypoints=own) for file in made.files]
    aliases = dict(zip(own[:-1], SEEN, strict=False))
    return make_recording(files, made.rig.cameras, PEOPLE, aliases)


def test_joints_are_kept_where_names_do_not_say_them():
    assert stated_joints(recording()) == ()
    assert stated_joints(own_names()) == (*SEEN[:-1], "")


def test_a_file_of_poses_says_which_joint_each_keypoint_is():
    own = own_names()
    poses = poses_of(POSES, own.keypoints)
    content = poses_to_h5(poses, {}, joints=stated_joints(own))
    file = parse_poses(content, "a.h5")
    assert file.joints == stated_joints(own)
    assert file.spelt == (*SEEN[:-1], own.keypoints[-1])
    joints = find_joints(file.spelt)
    assert joints.columns == joints_of_recording(own).columns
    pair = joint_pair("left_hip-left_knee", own.keypoints, joints, "--length")
    assert [SEEN[k] for k in pair] == ["left_hip", "left_knee"]
    definitions = define(file.spelt, *fit_vocabulary(file.spelt, None))
    assert "left_knee" in definitions.angles
    assert not define(own.keypoints, *fit_vocabulary(own.keypoints, None)).angles
    assert join_individuals([file, file], "a").joints == file.joints
    assert known_edges(file)


def test_markers_are_called_by_their_joints():
    own = own_names()
    poses = poses_of(POSES[:, :1], own.keypoints)
    poses = replace(poses, unit="m")
    file = PoseFile(poses, 50.0, joints=stated_joints(own))
    header = trc.write(file, "").content.decode().splitlines()[3]
    assert "LKnee" in header
    assert own.keypoints[-1] in header  # whose joint nobody said


def test_joints_of_other_keypoints_are_refused():
    poses = poses_of(POSES, SEEN)
    with pytest.raises(FormatError, match=r"a joint for each of the .* keypoints, found 1"):
        parse_poses(poses_to_h5(poses, {}, joints=("nose",)), "a.h5")
