"""No zero of a text output has a sign, whatever the arrays hold."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conversion_samples import poses, rig

from mocap_calib.io.keypoints.filled_table import FILLED_TABLE, describe_filled, format_filled_table
from mocap_calib.io.keypoints.read import read_keypoints
from mocap_calib.io.keypoints.write import format_keypoints, write_keypoints
from mocap_calib.io.poses.write import format_poses
from mocap_calib.io.results.pairs_json import pairs_to_json
from mocap_calib.io.zeros import unsigned_zeros
from mocap_calib.results import PairwiseCalibration
from mocap_calib.types import Keypoints2D


def view() -> Keypoints2D:
    """Two frames of one animal, all at the corner of the image."""
    positions = np.full((2, 1, 2, 2), -0.0)
    names = ("nose", "tail")
    return Keypoints2D(
        "a", names, np.arange(2), positions, np.ones((2, 1, 2)), True, (64, 48), "made"
    )


def test_nested_values_keep_all_but_the_sign():
    value = {"a": [-0.0, 1, "-0.0", None, True], "b": {"c": (-1.5, -0.0)}}
    text = json.dumps(unsigned_zeros(value))
    assert text == '{"a": [0.0, 1, "-0.0", null, true], "b": {"c": [-1.5, 0.0]}}'


@pytest.mark.parametrize("name", ["coco", "openpose", "deeplabcut-csv", "csv"])
def test_keypoints_as_text(name):
    for content in format_keypoints((view(),), name).files.values():
        assert b"-0" not in content


@pytest.mark.parametrize("name", ["trc", "anipose-csv"])
def test_poses_as_text(name):
    file = poses(1)
    signed = replace(file.poses, positions=file.poses.positions * -0.0)
    (content,) = format_poses(replace(file, poses=signed), name, Path("x")).files.values()
    assert b"-0" not in content


def test_pairs():
    pair = PairwiseCalibration(
        a=0,
        b=1,
        rotation=np.eye(3) * -0.0,
        translation=np.full(3, -0.0),
        matches=np.zeros((0, 3), dtype=np.int64),
        frames=1,
        score=-0.0,
        residual=0.0,
        in_front=1.0,
        source="lifted",
    )
    assert not re.search(r"-0\.0\b", pairs_to_json((pair,), rig().cameras))


def test_what_was_filled_in_is_listed_beside_a_file_or_in_the_folder(tmp_path):
    filled = np.zeros((1, 2, 1, 2), dtype=bool)
    filled[0, 1, 0, 1] = True
    table = format_filled_table((view(),), filled)
    assert table == b"camera\tframe\tinstance\tkeypoint\na\t1\t0\ttail\n"
    write_keypoints(tmp_path / "all.csv", (view(),), "csv", beside={FILLED_TABLE: table})
    write_keypoints(tmp_path / "folder", (view(),), "coco", beside={FILLED_TABLE: table})
    files = [path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.suffix]
    assert sorted(files) == [
        "all.csv",
        "all.csv.filled_in.tsv",
        "folder/a.json",
        "folder/filled_in.tsv",
    ]
    said = "a: 1 keypoint filled in by `complete`, not measured"
    for place in ("all.csv", "folder"):
        assert describe_filled(read_keypoints([tmp_path / place])) == (said,)
    renamed = read_keypoints([f"left={tmp_path / 'folder' / 'a.json'}"])
    assert describe_filled(renamed) == (said.replace("a:", "left:"),)
    (tmp_path / "folder" / FILLED_TABLE).write_bytes(b'camera\na\n"\0\xff')
    assert describe_filled(renamed) == ()
