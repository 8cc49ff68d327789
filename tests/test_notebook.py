"""What rigs and results show in notebooks: tables, and the figure."""

import html
import re
import sys
from dataclasses import replace

import numpy as np
import pytest
from scenes import calibrate_all, recording, scene

from mocap_calib.errors import MismatchError
from mocap_calib.results import CalibrationResult, Cause, Fault, Verdict
from mocap_calib.types import CameraRig, EstimatedCamera, World

SCENE = {"cameras": 3, "people": 2, "frames": 30}
EVIL = "<script>alert(1)</script>&"


@pytest.fixture(scope="module")
def result() -> CalibrationResult:
    return calibrate_all(recording(**SCENE))


def cells_of(page: str) -> list[str]:
    """Return the texts of the cells of the tables of a page."""
    return [html.unescape(cell) for cell in re.findall(r"<t[dh][^>]*>([^<]*)", page)]


def rename(rig: CameraRig, name: str) -> CameraRig:
    first = replace(rig.cameras[0], name=name)
    return replace(rig, cameras=(first, *rig.cameras[1:]))


def test_the_table_of_a_rig_has_its_numbers():
    rig = scene(**SCENE).rig
    sure = EstimatedCamera.of(rig.cameras[1], focal_sigma=12.34, k1_sigma=0)
    rig = replace(rig, cameras=(rig.cameras[0], sure, rig.cameras[2]))
    page = rig._repr_html_()
    cells = cells_of(page)
    assert "lengths in m" in page
    assert f"{rig.cameras[1].focal:.1f} ± 12.3" in cells
    assert ", ".join(f"{each:.4g}" for each in rig.centres[2]) in cells


def test_names_are_escaped(result):
    """Of cameras, of faults, and of cameras that were left out; also in the figure."""
    rig = rename(result.groups[0].rig, EVIL)
    assert EVIL in cells_of(rig._repr_html_())
    fault = Fault(EVIL, "moved", EVIL)
    shown = replace(result, left_out=(EVIL,), faults=(fault,))._repr_html_()
    assert shown.count("&lt;script&gt;") == 3
    for page in (rig._repr_html_(), shown):
        assert "<script" not in page


def test_a_result_shows_the_verdict_and_its_reasons(result):
    causes = (Cause("bones", "", 5.0, "cam1 is loose", "fix it"),)
    group = replace(result.groups[0], assessment=Verdict(5.0, causes))
    page = replace(result, groups=(group,))._repr_html_()
    assert "The rig is weak." in page
    assert "<li>cam1 is loose. Next: fix it.</li>" in page
    assert {"cam1", "cam2", "cam3"} <= set(cells_of(page))
    assert group._repr_html_() in page


def test_the_figure_shows_cameras_floor_and_bodies(result):
    """What is drawn is what was found, to 32 bits; measured 90 kB."""
    pytest.importorskip("plotly")
    group = result.groups[0]
    figure = result.plot(moments=7)
    _, names, floor, *bodies = figure.data
    assert names.text == group.rig.names
    centres = np.array([names.x, names.y, names.z]).T
    np.testing.assert_allclose(centres, group.rig.centres, rtol=1e-6)
    assert len(bodies) == group.poses.positions.shape[1]
    shown = [int(frame.name) for frame in figure.frames]
    assert (shown[0], shown[-1], len(shown)) == (0, 29, 7)
    for frame, moment in zip(figure.frames, shown, strict=True):
        for individual, body in enumerate(frame.data):
            drawn = np.array([body.x, body.y, body.z]).T
            found = group.poses.positions[moment, individual]
            known = drawn[np.isfinite(drawn).all(-1)]
            apart = np.linalg.norm(known[:, None] - found, axis=-1)
            assert np.nanmin(apart, axis=1).max() < 1e-5
            assert len(np.unique(np.nanargmin(apart, axis=1))) == np.isfinite(found).all(-1).sum()
    assert len(figure.to_json()) < 150_000
    assert floor.name == "floor"
    up, below = group.rig.world.up, group.rig.world.floor
    points = np.array([floor.x, floor.y, floor.z]).T
    assert np.nanmax(np.abs((points - below) @ up)) < 1e-5


def test_the_figure_without_a_floor_and_with_an_odd_name(result):
    pytest.importorskip("plotly")
    group = result.groups[0]
    rig = replace(rename(group.rig, EVIL), world=World())
    figure = replace(group, adjusted=replace(group.adjusted, rig=rig)).plot(moments=1)
    assert [trace.name for trace in figure.data[:2]] == ["cameras", None]
    assert figure.data[1].text[0] == "&lt;script&gt;alert(1)&lt;/script&gt;&amp;"
    assert figure.data[2].name == "individual 0"
    with pytest.raises(ValueError, match="moments: expected 1 or more, got 0"):
        result.plot(moments=0)


def test_without_plotly_it_is_said_what_to_install(result, monkeypatch):
    monkeypatch.setitem(sys.modules, "plotly", None)
    with pytest.raises(MismatchError, match=r"pip install mocap-calib\[notebook\]"):
        result.plot()
