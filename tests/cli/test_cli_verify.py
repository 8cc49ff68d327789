"""mocap-calib verify through real processes."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

import mocap_calib as mc


@pytest.fixture(scope="module")
def bumped(small, tmp_path_factory):
    """The calibration of the small recording in millimetres, one camera turned by 4 degrees."""
    rig = mc.read_rig(small / "reference.toml")
    rig = replace(rig, translation=1000 * rig.translation, unit="mm")
    rotation, translation = rig.rotation.copy(), rig.translation.copy()
    rotation[1] = Rotation.from_rotvec([4.0, 0.0, 0.0], degrees=True).as_matrix() @ rotation[1]
    translation[1] = -rotation[1] @ rig.centres[1]
    file = tmp_path_factory.mktemp("bumped") / "cameras.yaml"
    mc.write(replace(rig, rotation=rotation, translation=translation), file)
    return file


def test_a_sound_calibration_passes(tool, small):
    done = tool("verify", small / "reference.toml", small / "keypoints")
    assert done.returncode == 0, done.stderr
    header = re.split("  +", done.stdout.splitlines()[0].strip())
    assert header[:6] == ["camera", "turn deg", "+- deg", "shift %", "shift m", "+- m"]
    assert header[6:] == ["error px", "refitted px", "place"]
    said = r"calibration: well determined, expected error 0\.\d\d deg; no camera is named"
    assert re.search(said, done.stdout)


def test_a_bumped_camera_is_named_and_put_where_it_is(tool, small, bumped, tmp_path):
    mended = tmp_path / "mended.yaml"
    done = tool("verify", bumped, small / "keypoints", "-o", mended, "--quiet")
    true, given = mc.read_rig(small / "reference.toml"), mc.read_rig(bumped)
    assert done.returncode == 1
    assert not done.stderr
    assert f"named: {true.names[1]}" in done.stdout
    found = mc.read_rig(mended)
    assert found.unit == "mm"
    verdict = yaml.safe_load(mended.read_text("utf-8"))["provenance"]
    assert verdict["verdict"] == "well determined"
    for figure, least, most in (("rotation_sigma_deg", 0.01, 1), ("centre_sigma_percent", 0.01, 5)):
        assert list(verdict[figure]) == list(found.names)
        assert all(least < value < most for value in verdict[figure].values())
    assert found.select([0, 2]) == given.select([0, 2])
    assert np.linalg.norm(found.centres[1] - 1000 * true.centres[1]) < 30
    again = tool("verify", mended, small / "keypoints", "--quiet")
    assert again.returncode == 0, again.stdout


def test_figures_are_json(tool, small, bumped):
    """Numbers that are not known are null: `json.loads` would read NaN and Infinity too."""
    files = sorted((small / "keypoints").iterdir())[:2]
    done = tool("verify", bumped, *files, "--json", "--quiet")
    figures = json.loads(done.stdout, parse_constant=pytest.fail)
    names = mc.read_rig(bumped).names
    assert [camera["name"] for camera in figures["cameras"]] == [*names[:2]]
    assert figures["without_keypoints"] == [names[2]]
    assert [camera["shift"] for camera in figures["cameras"]] == [None, None]
    done = tool("verify", bumped, small / "keypoints", "--json", "--quiet")
    figures = json.loads(done.stdout)
    assert (figures["named"], figures["passes"]) == ([names[1]], False)
    camera = figures["cameras"][1]
    assert camera["place"] == "moved"
    assert camera["turn_deg"] == pytest.approx(4.0, abs=0.3)
    assert camera["turn_deg"] > 2 * camera["turn_sigma_deg"] > 0


def test_keypoints_of_other_cameras_are_said(tool, small, tmp_path):
    two = tmp_path / "two.yaml"
    mc.write(mc.read_rig(small / "reference.toml").select([0, 1]), two)
    done = tool("verify", two, small / "keypoints")
    assert done.returncode == 0, done.stdout
    assert "left out, not among the cameras:" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(("--to", "anipose"), "give -o FILE"), (("-o", "x.unknown"), "name the format")],
)
def test_mistakes_are_said_before_anything_is_computed(tool, small, arguments, said):
    done = tool("verify", small / "reference.toml", small / "keypoints", *arguments)
    assert done.returncode in (1, 2)
    assert said in done.stderr
