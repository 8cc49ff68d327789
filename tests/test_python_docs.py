"""The Python in README.md and docs/python.md, run as it stands on a small recording."""

import re
import textwrap
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mocap_calib as mc
from mocap_calib.io.results.scene import write_scene

ROOT = Path(__file__).parents[1]


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
