"""The README, its picture, `make demo` and the Python of all pages, run as it stands."""

import importlib.util
import re
import shutil
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import numpy as np
import pytest

import mocap_calib as mc
from mocap_calib.synthetic.scene_files import write_scene

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text("utf-8")


def load_script(path: Path) -> ModuleType:
    """Import a script that is in no package, and may import others beside it."""
    sys.path.insert(0, str(path.parent))
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(path.parent))
    return module


def test_the_table_shows_all_recordings_and_their_verdicts():
    script = load_script(ROOT / "benchmarks" / "recordings.py")
    header = "| " + " | ".join(script.HEADER) + " |\n"
    assert script.HEADER[1] == "verdict"
    assert header in README
    table = README.split(header)[1].split("\n\n")[0]
    rows = [line.strip("| ").split(" | ") for line in table.splitlines()[1:]]
    assert [row[0] for row in rows] == list(script.NAMES)
    for row in rows:
        assert re.match(r"well determined|usable|weak|not determined|refused", row[1])
        assert len(row) == len(script.HEADER)


def test_the_readme_has_one_picture_of_who_was_found():
    (picture,) = re.findall(r"!\[[^\]]*\]\(([^)]*)\)", README)
    path = ROOT / "docs" / picture.rpartition("/")[2]
    assert path.stat().st_size < 100_000
    words = {node.text for node in ElementTree.parse(path).iter() if node.tag.endswith("text")}
    assert {f"individual {k}" for k in range(3)} <= words
    assert {f"cam{k}" for k in range(1, 5)} <= words


def test_lines_of_the_readme_fit_a_page():
    """But for the rows of tables, which cannot be broken."""
    long = [line for line in README.splitlines() if len(line) > 100 and not line.startswith("|")]
    assert long == []


# --- the first thing a newcomer sees


@pytest.mark.slow
@pytest.mark.skipif(
    not (ROOT / ".venv" / "installed").exists() or not shutil.which("make"),
    reason="not the environment that make makes",
)
def test_demo():
    said = subprocess.run(["make", "demo"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stderr
    median, largest = (
        float(re.search(rf"^{name} +(\S+)", said.stdout, re.M).group(1))
        for name in ("median", "max")
    )
    assert median < 0.1  # measured 0.02 degrees
    assert largest < 0.2  # 0.04
    assert "3 individuals in 200 of 200 frames" in said.stderr
    assert "the results are in out/demo" in said.stdout
    listed = said.stdout.split("the results are in out/demo")[1]
    for name in (
        "cameras.yaml",
        "calibration.toml",
        "poses3d.h5",
        "poses3d_0.csv",
        "matches.csv",
        "run.json",
        "report.html",
    ):
        assert name in listed


def test_the_example_is_small():
    assert sum(p.stat().st_size for p in (ROOT / "examples").rglob("*") if p.is_file()) < 2e6


# --- Python in pages


def blocks(page: str) -> list[str]:
    """Return the blocks of Python in a page."""
    return re.findall(r"```python\n(.*?)```", (ROOT / page).read_text("utf-8"), flags=re.DOTALL)


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """A folder to work in, with the files that the pages name; two people who are followed."""
    made = mc.simulate(mc.SimulateConfig(cameras=3, people=2, frames=30, false_detections=0))
    write_scene(tmp_path, made, "made by a test")
    followed = mc.simulate(
        mc.SimulateConfig(cameras=3, people=2, frames=30, false_detections=0, shuffle=False)
    )
    for view in followed.files:
        path = tmp_path / "videos" / f"{view.camera}DLC_resnet50.csv"
        mc.write(replace(view, tracked=True), path, format="deeplabcut-csv")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_readme(folder):
    """Measured: what is projected comes back within 1e-11 of a body."""
    (block,) = blocks("README.md")
    assert len(re.findall(r"^(?:import|from) ", block, flags=re.MULTILINE)) == 1
    names = {}
    exec(block, names)
    poses, points = names["poses"], names["points"]
    assert names["pixels"].shape == (3, *poses.positions.shape[:-1], 2)
    np.testing.assert_allclose(points, poses.positions, rtol=0, atol=1e-9)
    rig = mc.read_rig(folder / "calibration.toml")
    np.testing.assert_allclose(rig.rotation, names["rig"].rotation, atol=1e-12)
    assert (folder / "out" / "run.json").is_file()


@pytest.mark.slow
def test_page(folder, capsys):
    """Every block works, after those before it; the rig is the true one (measured 0.1 degrees)."""
    pytest.importorskip("xarray")
    names = {}
    for block in blocks("docs/python.md"):
        exec(block, names)
    assert names["group"].verdict in capsys.readouterr().out
    assert np.degrees(names["evaluation"].rotation_error).max() < 0.5
    np.testing.assert_allclose(names["corner_point"], [0, 0, 6], atol=1e-9)
    centres = names["metric_rig"].centres
    assert np.linalg.norm(centres[0] - centres[1]) == pytest.approx(6.12)
    # the same rig and the same detections; the file has the rig with all digits
    assert names["matches"] == names["group"].matches
    staged = names["staged_rig"]  # in the world of the first camera
    assert np.degrees(mc.evaluate(staged, names["rig"]).rotation_error).max() < 0.05
    assert names["filtered"].positions.shape == names["staged_poses"].positions.shape
    written = {path.name for path in folder.iterdir()}
    assert {"Calib.toml", "model", "poses_0.trc", "poses_1.trc", "poses.nc", "openpose"} <= written


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_the_world():
    """The distance that the page states is that of the rig."""
    (block,) = blocks("docs/world.md")
    names = {}
    exec(block, names)
    rig = names["result"].groups[0].rig
    assert rig.unit == "m"
    distance = np.linalg.norm(rig["cam1"].centre - rig["cam2"].centre)
    assert distance == pytest.approx(3.1, abs=1e-9)


PAGES = sorted((ROOT / "docs").glob("*.md"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_python_of_all_pages_can_be_read(page):
    for block in blocks(page.relative_to(ROOT).as_posix()):
        compile(textwrap.dedent(block), page.name, "exec")


def test_the_page_says_all_names():
    """Each name of `__all__` is on the page that shows the library."""
    page = (ROOT / "docs" / "python.md").read_text("utf-8")
    assert [name for name in mc.__all__ if f"`{name}`" not in page] == []
