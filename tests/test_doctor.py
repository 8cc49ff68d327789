"""`doctor` of sound and of broken installations."""

import json
import os
import re
import subprocess
import sys
from importlib import metadata

import pytest

from mocap_calib import doctor

# modules that are not named as the distributions that bring them
NAMES = {"opencv-python-headless": "cv2", "pyyaml": "yaml", "tomli-w": "tomli_w"}
REQUIRED = [each for each in metadata.requires("mocap-calib") if "extra" not in each]
MODULES = {
    name: NAMES.get(name, name)
    for name in (re.split("[<>=!~; ]", each.lower())[0] for each in REQUIRED)
}


def examine(*arguments: str, first: object = "") -> subprocess.CompletedProcess[str]:
    """Run the command, with modules of the folder `first` before all others."""
    path = os.pathsep.join(filter(None, [str(first), os.environ.get("PYTHONPATH")]))
    return subprocess.run(
        [sys.executable, "-m", "mocap_calib_cli", "doctor", *arguments],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": path},
        check=False,
    )


@pytest.mark.parametrize(("package", "module"), MODULES.items())
def test_a_broken_package_is_one_line(tmp_path, package, module):
    """The other packages are empty modules, but for click: nothing may need them to say it."""
    for name in {*MODULES.values(), "functorch", "torchgen"} - {"click"}:
        (tmp_path / f"{name}.py").write_text("")
    (tmp_path / f"{module}.py").write_text("raise ImportError('DLL load failed')")
    done = examine("--no-self-test", first=tmp_path)
    said = done.stdout + done.stderr
    assert done.returncode == 1
    assert [line for line in said.splitlines() if line.startswith("wrong:")] == [
        f"wrong: {package} cannot be imported (ImportError: DLL load failed); install it again"
    ]
    assert "Traceback" not in said


def test_one_broken_package_is_not_blamed_on_those_that_import_it(tmp_path):
    (tmp_path / "numpy.py").write_text("raise ImportError('DLL load failed')")
    (line,) = json.loads(examine("--json", first=tmp_path).stdout)["findings"]
    assert line.startswith("numpy cannot be imported")


@pytest.mark.slow
def test_a_sound_installation_has_no_findings():
    """Measured 0.10 degrees, in 4 seconds of a processor."""
    done = examine("--json")
    found = json.loads(done.stdout)
    assert done.returncode == 0
    assert found["findings"] == []
    assert found["packages"].keys() == MODULES.keys()
    assert all((found["packages"] | found["models"]).values())
    assert found["libraries"]
    assert 0 < found["self_test"]["rotation_error_deg"] < 0.3
    assert found["self_test"]["individuals"] == 2


@pytest.mark.slow
def test_limits_of_the_self_test_and_the_disk(monkeypatch):
    monkeypatch.setattr(doctor, "_MOST_ERROR_DEG", 0.01)
    monkeypatch.setattr(doctor, "_LEAST_DISK_GB", 1e9)
    findings = doctor.examine()["findings"]
    assert "calculates wrongly; report it" in findings[0]
    assert findings[1].endswith("GB are free on this disk; make room")


def test_a_failed_check_is_a_finding_without_the_home_directory(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(
        "mocap_calib.lift.lifter.load_lifter", lambda _: (tmp_path / "none").read_text()
    )
    lines = doctor.examine(self_test=False)["findings"]
    assert len(lines) == 4
    assert all(line.startswith("the model ") and str(tmp_path) not in line for line in lines)


def test_kept_machine_code_that_others_can_write_is_a_finding(monkeypatch):
    monkeypatch.setattr("mocap_calib.kernels.jit.is_trusted", lambda _: False)
    (line,) = doctor.examine(self_test=False)["findings"]
    assert line.endswith("in each run; run chmod -R o-w on it, or remove it")
