"""What `doctor` finds of this machine, and what it says where something is wrong."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from mocap_calib import doctor
from mocap_calib.doctor import DoctorConfig
from mocap_calib.lift.lifter import digest
from mocap_calib.recording.joints import SHIPPED
from mocap_calib_cli.commands.doctor import command


@pytest.fixture(scope="module")
def found() -> dict:
    return doctor.examine(self_test=False)


def test_a_sound_installation_has_no_findings(found):
    assert found["findings"] == []
    assert all(each["version"] for each in found["packages"].values())
    assert {name: each["sha256"] for name, each in found["models"].items()} == {
        name: digest(name) for name in SHIPPED
    }
    assert found["computer"]["threads"] >= 1
    assert found["libraries"]


@pytest.mark.slow
def test_the_self_test_knows_the_truth():
    """Measured 0.23 degrees, in 3 seconds of a processor."""
    test = doctor._calibrate_known_scene(DoctorConfig())
    assert list(doctor._judge_self_test(test, DoctorConfig())) == []
    assert 0 < test["rotation_error_deg"] < 0.3
    assert test["individuals"] == 2
    strict = replace(DoctorConfig(), most_error_deg=0.01)
    (line,) = doctor._judge_self_test(test, strict)
    assert "calculates wrongly" in line


@pytest.mark.parametrize(
    ("part", "name", "change", "says"),
    [
        ("packages", "pycolmap", {"error": "ImportError: x"}, "pycolmap cannot be imported"),
        ("extras", "pynwb", {"version": "1", "error": "ImportError: x"}, "pynwb cannot be"),
        ("models", "people", {"error": "FormatError: cut"}, "the model people does not load"),
        ("computer", "disk_free_gb", 0.1, "0.1 GB are free on this disk; make room"),
        ("self_test", "error", "no", "the self-test was refused (no)"),
        ("self_test", "rotation_error_deg", 3.0, "the self-test is off by 3.00 deg"),
        ("self_test", "rotation_error_deg", float("nan"), "the self-test is off by nan deg"),
        ("self_test", "individuals", 3, "found 3 people, expected 2"),
    ],
)
def test_what_is_wrong_is_said_in_a_line(found, part, name, change, says):
    sound = {"error": None, "rotation_error_deg": 0.1, "individuals": 2}
    broken = found | {"self_test": sound}
    assert list(doctor._findings(broken, DoctorConfig())) == []
    broken[part] = broken[part] | {name: change}
    (line,) = doctor._findings(broken, DoctorConfig())
    assert says in line


def test_the_command_says_it_as_text_and_as_json(found, monkeypatch):
    monkeypatch.setattr(doctor, "examine", lambda **_: found)
    said = CliRunner().invoke(command, ["--no-self-test"], catch_exceptions=False)
    assert said.exit_code == 0
    assert "\nnothing is wrong\n" in said.stdout
    assert json.loads(CliRunner().invoke(command, ["--json"]).stdout) == found
    monkeypatch.setattr(doctor, "examine", lambda **_: found | {"findings": ["x; mend it"]})
    broken = CliRunner().invoke(command, [], catch_exceptions=False)
    assert broken.exit_code == 1
    assert "\nwrong: x; mend it\n" in broken.stdout


def test_the_home_directory_is_not_told(monkeypatch):
    monkeypatch.setattr(Path, "home", lambda: Path("/home/zoe"))
    assert doctor._without_home("/home/zoe/.venv/bin/python") == "~/.venv/bin/python"
    error = doctor._error_of(lambda: Path("/home/zoe/none").read_text())
    assert "zoe" not in error
