"""The programs, the notebook and the workflow in `examples/` do what they say."""

import json
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import TOOL, load_script

import mocap_calib as mc

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
PROGRAMS = sorted(EXAMPLES.glob("*.py"))


@pytest.fixture
def call(monkeypatch, capsys):
    """Runs a program as from a shell, in this process; returns its names and what it printed."""

    def run(name: str, *words: object) -> tuple[dict, str]:
        monkeypatch.setattr(sys, "argv", [name, *map(str, words)])
        names = runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return names, capsys.readouterr().out

    return run


@pytest.fixture(scope="module")
def sessions(small, tmp_path_factory) -> Path:
    """A folder of recordings: one that is good, and one whose keypoints are damaged."""
    folder = tmp_path_factory.mktemp("sessions")
    for name in ("good", "damaged"):
        shutil.copytree(small, folder / name)
    (folder / "damaged" / "keypoints" / "cam1.json").write_text("{", "utf-8")
    return folder


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.name)
def test_programs_are_short_and_listed(path):
    assert len(path.read_text("utf-8").splitlines()) <= 60
    assert f"[{path.name}]({path.name})" in (EXAMPLES / "README.md").read_text("utf-8")
    assert f"def test_{path.stem}(" in Path(__file__).read_text("utf-8")


@pytest.mark.slow
def test_own_arrays(call):
    """Measured 0.53 degrees for the worst pair."""
    names, said = call("own_arrays.py")
    evaluation = mc.evaluate(names["rig"], names["scene"].rig)
    assert np.degrees(evaluation.rotation_error).max() < 1.5
    assert "cam3: centre" in said


@pytest.mark.slow
def test_several_animals(call):
    """Bodies keep more than their own length apart, as they were simulated."""
    names, said = call("several_animals.py")
    assert names["group"].recording.model == "rodent"
    assert names["positions"].shape[1] == 2
    assert "at their nearest" in said
    assert np.nanmin(names["apart"]) > names["back"]


@pytest.mark.slow
def test_to_pose2sim(call, small, tmp_path):
    """The distance of the first two cameras is the one that was said."""
    call("to_pose2sim.py", small / "keypoints", small / "intrinsics.toml", 60, 6.5, tmp_path)
    rig = mc.read_rig(tmp_path / "calibration" / "Calib.toml")
    assert rig.unit == "m"
    assert np.linalg.norm(rig.centres[1] - rig.centres[0]) == pytest.approx(6.5)
    written = {path.name for path in (tmp_path / "pose-3d").iterdir()}
    assert written == {"poses_0.trc", "poses_1.trc"}


@pytest.fixture(scope="module")
def calibrated(sessions, tmp_path_factory) -> Path:
    """What the program for many recordings writes."""
    out = tmp_path_factory.mktemp("many")
    runpy.run_path(str(EXAMPLES / "many_recordings.py"))["main"](sessions, out)
    return out


@pytest.mark.slow
def test_many_recordings(calibrated):
    """One that is refused does not stop the others."""
    rows = (calibrated / "verdicts.csv").read_text("utf-8").splitlines()
    assert rows[0] == "recording,verdict,why"
    assert rows[1].startswith("damaged,refused,")
    assert rows[2].startswith(("good,well determined", "good,usable"))
    assert (calibrated / "good" / "run.json").is_file()


@pytest.mark.slow
def test_against_a_board(call, calibrated, small):
    cameras = calibrated / "good" / "cameras.yaml"
    for limit, status in ((5, 0), (0.0001, 1)):
        with pytest.raises(SystemExit) as ended:
            call("against_a_board.py", cameras, small / "reference.toml", limit)
        assert ended.value.code == status


@pytest.mark.slow
def test_known_rig(call, small, tmp_path):
    _, said = call("known_rig.py", small / "reference.toml", small / "keypoints", tmp_path)
    assert "Verification: " in said
    assert np.load(tmp_path / "poses.npz")["positions"].shape[:2] == (30, 2)
    assert mc.read_poses(tmp_path / "poses.nc").unit == "m"


# --- the notebook


@pytest.mark.slow
def test_the_notebook_shows_what_it_showed():
    """Its cells run one after the other; figures may differ in digits."""
    pytest.importorskip("plotly")
    path = EXAMPLES / "notebook.ipynb"
    stored = json.loads(path.read_text("utf-8"))
    fresh = json.loads(path.read_text("utf-8"))
    names = load_script(ROOT / "docs" / "make_notebook.py").fill(fresh)
    assert [masked(cell) for cell in fresh["cells"]] == [masked(cell) for cell in stored["cells"]]
    assert names["result"].groups[0].verdict == "well determined"
    assert np.degrees(names["evaluation"].rotation_error).max() < 0.5  # measured 0.13


def test_the_notebook_is_small_and_has_no_paths():
    text = (EXAMPLES / "notebook.ipynb").read_text("utf-8")
    assert len(text) < 150_000  # measured 75,000
    assert not re.search(r"/(home|work|tmp|root|Users)/|[A-Z]:\\\\", text)


def masked(cell: dict) -> list:
    """What a cell shows, without its digits; of a figure, what is drawn in how many moments."""
    shown = []
    for output in cell.get("outputs", []):
        data = dict(output.get("data", {"text": output.get("text")}))
        figure = data.pop("application/vnd.plotly.v1+json", None)
        if figure:
            kinds = [(trace["name"], trace["mode"]) for trace in figure["data"] if "name" in trace]
            shown.append((kinds, len(figure["frames"]), figure["layout"]["title"]))
        shown.append(re.sub(r"[-0-9.]+", "0", json.dumps(data)))
    return shown


# --- the workflow


@pytest.mark.slow
def test_the_workflow(sessions, tool, tmp_path):
    """By snakemake where it is installed; else its rules, one after the other."""
    shutil.copytree(sessions / "good", tmp_path / "sessions" / "good")
    snakefile = EXAMPLES / "snakemake" / "Snakefile"
    if snakemake := shutil.which("snakemake"):
        words = [snakemake, "--cores", "1", "--snakefile", snakefile]
        path = f"{TOOL.parent}:{Path(snakemake).parent}:/usr/bin:/bin"
        subprocess.run(words, cwd=tmp_path, env={"PATH": path, "HOME": str(tmp_path)}, check=True)
    else:
        values = {"input": "out/good/cameras.yaml", "output": "export/good.toml"}
        values |= {"wildcards.session": "good", "input.keypoints": "sessions/good/keypoints"}
        values |= {"input.cameras": "sessions/good/intrinsics.toml"}
        rules = re.findall(r'shell:\s*"mocap-calib ([^"]*)"', snakefile.read_text("utf-8"))
        assert len(rules) == 2
        for rule in rules:
            words = re.sub(r"\{([\w.]+)\}", lambda name: values[name[1]], rule)
            done = tool(*shlex.split(words), cwd=tmp_path)
            assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "good" / "run.json").is_file()
    assert len(mc.read_rig(tmp_path / "export" / "good.toml")) == 3
